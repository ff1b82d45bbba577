"""The environment of a coordinator: live processes and virtual fleets give it different ones."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import LatchStore
from orchestrator.bus.log import LogSink
from orchestrator.clock.base import Clock
from orchestrator.clock.executor import Executor
from orchestrator.coordinator.journal.journal import Journal
from orchestrator.model.fleet import Fleet


@dataclass(frozen=True, slots=True)
class CoordinatorEnvironment:
    """The environment of a coordinator: everything that differs between live and virtual fleets.

    save_fleet: stores a reloaded fleet for the next start. latches: stores the e-stop latch.
    """

    bus: Bus
    keys: FleetKeys
    clock: Clock
    journal: Journal
    execute: Executor
    new_id: Callable[[], str]
    sink: LogSink
    save_fleet: Callable[[Fleet], None]
    latches: LatchStore
