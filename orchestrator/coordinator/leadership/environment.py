"""The environment of a coordinator: live processes and virtual fleets give it different ones."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import LatchStore
from orchestrator.bus.log import LogSink
from orchestrator.clock.base import Clock
from orchestrator.clock.executor import Executor, run_inline
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.coordinator.leadership.copies import JournalHealth
from orchestrator.coordinator.leadership.lease import LeaderLease
from orchestrator.model.fleet import Fleet
from orchestrator.model.state import CertificateEnd


class CommandResult(NamedTuple):
    """How a command ended. exit_code: None if it could not be started, or was killed because it took too long.
    why: what it said, or why it was not started, in words."""

    exit_code: int | None
    why: str = ""


RunCommand = Callable[[Sequence[str], bytes, Mapping[str, str], int], Awaitable[CommandResult]]
"""Runs a command with its arguments, its standard input, additional variables of its environment, and a timeout in ns.
Raises nothing."""


async def run_no_command(words: Sequence[str], _: bytes, __: Mapping[str, str], ___: int) -> CommandResult:
    """Run no command, where there are none."""
    return CommandResult(None, f"{words[0]}: a virtual fleet runs no commands")


@dataclass(frozen=True, slots=True)
class JournalServer:
    """A journal in a database that other computers reach. run_lease: runs calls of the lease, in a thread of their own.
    read_health: a call of the journal."""

    lease: LeaderLease
    run_lease: Executor
    read_health: Callable[[], JournalHealth]


@dataclass(frozen=True, slots=True)
class CoordinatorEnvironment:
    """The environment of a coordinator: everything that differs between live and virtual fleets.

    save_fleet: stores a reloaded fleet for the next start. latches: stores the e-stop latch. run_command: runs the
    command of `notify`. find_free: returns the free bytes on the disk of the journal, None: not known. plan: plans
    paths, which may take seconds; heartbeats and stops go on meanwhile. plan_long: those of many pieces. decode: reads
    large requests and jobs, which would hold the interpreter's lock. check: checks jobs with long paths, for the same
    reason. certificate: of its session, if it has one. journal_server: of a journal that is no file of this computer.
    """

    bus: Bus
    keys: FleetKeys
    clock: Clock
    journal: JournalStore
    execute: Executor
    new_id: Callable[[], str]
    sink: LogSink
    save_fleet: Callable[[Fleet], None]
    latches: LatchStore
    run_command: RunCommand
    find_free: Callable[[], Awaitable[int | None]]
    plan: Executor = run_inline
    plan_long: Executor = run_inline
    decode: Executor = run_inline
    check: Executor = run_inline
    certificate: CertificateEnd | None = None
    journal_server: JournalServer | None = None

    @property
    def read_journal_health(self) -> Callable[[], JournalHealth] | None:
        """Asks the database of the journal; None: it is a file of this computer."""
        return None if self.journal_server is None else self.journal_server.read_health
