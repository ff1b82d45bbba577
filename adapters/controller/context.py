"""One controller's place in its adapter host: what all the parts of its unit need to know."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from adapters.contract import Driver, Make
from orchestrator.bus.base import Bus
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log
from orchestrator.clock.base import Clock
from orchestrator.clock.fleet import FleetScale
from orchestrator.link.base import OpenLink
from orchestrator.link.trace import TraceRing
from orchestrator.model.fleet import Controller


@dataclass(frozen=True, slots=True)
class Seat:
    """instance: of this start of the unit. scale: fleet time, or None before any coordinator was heard. reconfigure:
    asks the host to replace the unit of a controller by one with another configuration."""

    controller: str
    config: Controller
    make: Make
    driver: Driver
    bus: Bus
    keys: Keys
    clock: Clock
    open_link: OpenLink
    trace: TraceRing
    log: Log
    instance: str
    scale: Callable[[], FleetScale | None]
    reconfigure: Callable[[str, Controller], None]
    lowering: asyncio.Lock
