"""The context of one controller in its adapter host, shared by all components of its supervisor."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from adapters.contract import Driver, Make
from adapters.controller.state.outlet import StateOutlet
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.log import ProcessLog
from orchestrator.bus.session_signs import SessionSigns
from orchestrator.clock.base import Clock
from orchestrator.clock.fleet import FleetScale
from orchestrator.link.base import Link, OpenLink
from orchestrator.link.trace import TraceRing
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.state import CertificateEnd


@dataclass(frozen=True, slots=True)
class ControllerContext:
    """Everything that the components of one controller's supervisor share.

    instance: identifies this start of the supervisor.
    outlet: publishes states, events and what changes slowly.
    current_link: returns the link that was opened last, which may be closed by now; None: no link has been opened yet.
    scale: returns fleet time, or None before the first message of a coordinator.
    follow_leader: called with the coordinator that has adopted the controller.
    replace_supervisor: requests from the host that it replaces this supervisor by one with another configuration.
    sessions: when the commands that a person waits for were last seen.
    lowering_lock: lock that lets one controller of the host lower profiles at a time.
    certificate: of the host's session, if it has one.
    poll_grid_ns: polls at rest are made at its multiples."""

    controller: str
    config: Controller
    make: Make
    driver: Driver
    keys: FleetKeys
    clock: Clock
    outlet: StateOutlet
    open_link: OpenLink
    current_link: Callable[[], Link | None]
    trace: TraceRing
    log: ProcessLog
    instance: str
    scale: Callable[[], FleetScale | None]
    follow_leader: Callable[[str, LeaderHeartbeat], None]
    replace_supervisor: Callable[[str, Controller], None]
    sessions: SessionSigns
    lowering_lock: asyncio.Lock
    certificate: CertificateEnd | None
    poll_grid_ns: int

    def require_scale(self) -> FleetScale:
        """Fleet time. Raises `Refusal` while it is unknown."""
        scale = self.scale()
        if scale is None:
            raise Refusal("no-fleet-time", "no fleet time: no coordinator has been seen", "start a coordinator")
        return scale
