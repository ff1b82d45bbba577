"""On how many machines the journal is, as its database says: looked at again and again, and an alarm where it is not
what the fleet file asks for."""

from collections.abc import Callable, Sequence
from typing import Protocol

from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.clock.executor import Executor
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.model.operation.alarms import AlarmCause
from orchestrator.model.queue import CopyMode

LOOK_NS = 10 * NS_PER_S
LOOK_AGAIN_NS = NS_PER_S  # while a copy is missing
WAITS: CopyMode = "waits for a copy"
_LATE = "one copy: no commit waits for the standby of the database; after a fail-over accepted jobs may be missing"
_STANDBY = "look at the standby of the database; `tutti doctor --journal` names what is wrong"


class HealthProblem(Protocol):
    """Something that a site has to change at its database."""

    @property
    def text(self) -> str: ...

    @property
    def remedy(self) -> str: ...


class JournalHealth(Protocol):
    """What a database says of itself."""

    @property
    def mode(self) -> CopyMode: ...

    @property
    def problems(self) -> Sequence[HealthProblem]: ...

    @property
    def may_lose_jobs(self) -> bool: ...


class ReportCondition(Protocol):
    """Takes the condition of an alarm."""

    def __call__(self, cause: AlarmCause, *, holds: bool) -> None: ...


class CopyWatch:
    """Knows how many copies there are. read_health: asks the database, a call of the journal; None: the journal is a
    file of this computer."""

    def __init__(
        self, read_health: Callable[[], JournalHealth] | None, execute: Executor, clock: Clock, tasks: TaskOwner
    ) -> None:
        self._read_health = read_health
        self._execute = execute
        self._clock = clock
        self._tasks = tasks
        self.mode: CopyMode | None = None
        """None: not known, or the journal is no database."""
        self.note = ""
        """What is not promised of a job that is accepted."""
        self.on_change: Callable[[], None] = lambda: None
        """Called when the mode has changed."""

    async def start(self, report: ReportCondition) -> None:
        """Ask now, and from time to time. Raises `JournalError`."""
        if self._read_health is not None:
            await self._look(report)
            self._tasks.spawn(self._keep_looking(report), vital=True)

    def find_obstacle(self) -> tuple[str, str] | None:
        """Why no job may begin, and what to do about it; None: it may."""
        if self.mode != WAITS:
            return None
        return "the journal waits for its copy on a second machine, which the fleet file asks for", _STANDBY

    async def _keep_looking(self, report: ReportCondition) -> None:
        while True:
            await sleep_ns(self._clock, LOOK_AGAIN_NS if self.mode == WAITS else LOOK_NS)
            try:
                await self._look(report)
            except JournalError:
                continue  # it is an alarm of its own, as with every call

    async def _look(self, report: ReportCondition) -> None:
        assert self._read_health is not None
        health = await self._execute(self._read_health)
        problem = next(iter(health.problems), None)
        text = "" if problem is None else problem.text
        if health.mode == WAITS:
            text = f"{text or 'the copy on a second machine is missing'}; new jobs are refused, and none begins"
        remedy = _STANDBY if problem is None else problem.remedy
        self.note = _LATE if health.may_lose_jobs else ""
        report(AlarmCause("journal-copies", "journal", text, remedy), holds=bool(text))
        if health.mode != self.mode:
            self.mode = health.mode
            self.on_change()
