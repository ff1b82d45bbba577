"""Alarms of the service itself, and of other processes: journal, disk, other leaders, requests on the bus."""

from collections.abc import Awaitable, Callable

from pydantic import ValidationError

from orchestrator.bus.base import BusSample
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.coordinator.alarms.conditions import AlarmConditions
from orchestrator.coordinator.journal.records import DamagedRecord, JobHasEnded, JournalError
from orchestrator.model.alarm_rules import AlarmRules
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.operation.alarms import AlarmCause, AlarmRequest
from orchestrator.model.problems import describe_first_error

DISK_NS = 60 * NS_PER_S  # between two looks at the free space
REQUEST_NS = 120 * NS_PER_S  # an alarm that another process does not repeat for this long is over
VERSION_NS = 10 * NS_PER_S  # the alarm is over when no state of the refused adapter has come for this long
MAX_SOURCES, MAX_REQUESTED = 20, 20  # processes that raise alarms, and alarms of each that are not normal
MAX_SOURCE = 130  # characters of the name of a process
MAX_UNKNOWN = 1000  # names that are counted
MB = 1_000_000

FindFree = Callable[[], Awaitable[int | None]]
"""The free bytes on the disk of the journal; None: not known."""


class ServiceAlarms:
    """Reports the conditions of the service. rules: returns the rules of the fleet file."""

    def __init__(
        self, conditions: AlarmConditions, clock: Clock, log: ProcessLog, rules: Callable[[], AlarmRules]
    ) -> None:
        self._conditions = conditions
        self._clock = clock
        self._log = log
        self._rules = rules
        self._looked_ns: int | None = None
        self._unknown_names: set[str] = set()

    # Journal and disk

    def note_write(self, error: JournalError | None) -> None:
        """A write to the journal has failed; None: it is done."""
        if isinstance(error, JobHasEnded | DamagedRecord):
            return
        text = "" if error is None else str(error)
        cause = AlarmCause("disk", "journal", text, "free space on its disk; no job begins until it can be written")
        self._conditions.report(cause, holds=error is not None)

    async def check_disk(self, find_free: FindFree) -> None:
        """Look at the free space, once a minute."""
        now_ns = self._clock.now_ns()
        if self._looked_ns is not None and now_ns - self._looked_ns < DISK_NS:
            return
        self._looked_ns = now_ns
        free, limit_mb = await find_free(), self._rules().disk.limit_mb
        text = "" if free is None else f"the disk of the journal has {free // MB} MB left"
        cause = AlarmCause("disk", "space", text, "free space there; `tutti job prune` deletes old jobs")
        self._conditions.report(cause, holds=free is not None and free < limit_mb * MB)

    # Other leaders

    def note_contradiction(self, heartbeat: LeaderHeartbeat) -> None:
        """A heartbeat of another coordinator was received that does not answer that it leads."""
        name = heartbeat.coordinator[:8]
        text = f"heartbeats of coordinator {name} with epoch {heartbeat.epoch} are on the bus; it does not lead"
        self._report_moment("second-leader", text, "find the process that sends them, and end it")

    def note_version(self, controller: str, refusal: Refusal) -> None:
        """A controller is not adopted, because its adapter is of another version; called with each of its states."""
        cause = AlarmCause("version", controller, refusal.text, refusal.remedy)
        self._conditions.report(cause, holds=True, for_ns=VERSION_NS)

    def note_unknown(self, controller: str) -> None:
        """A controller that the fleet file does not have publishes states, which count for nothing: one alarm."""
        if len(self._unknown_names) < MAX_UNKNOWN:
            self._unknown_names.add(controller)
        count = len(self._unknown_names)
        names = "a controller publishes" if count == 1 else f"{count} controllers publish"
        text = f"{names} states that the fleet file does not have; the last one is {controller}"
        action = "end its adapter host, add it to the fleet file, or find the process that sends them"
        self._conditions.report(AlarmCause("unknown-controller", "fleet", text, action), holds=True, for_ns=VERSION_NS)

    def note_double_answer(self, key: str) -> None:
        """Two processes have answered on one key."""
        text = f"two processes answer on {key}; one of them should not"
        self._report_moment("double-answer", text, "find it before anything moves")

    def _report_moment(self, kind: str, text: str, action: str) -> None:
        self._conditions.report(AlarmCause(kind, "fleet", text, action), holds=True, for_ns=NS_PER_S)

    # Notices

    def note_command(self, failures: int, why: str) -> None:
        """The command of `notify` has failed so often in succession; 0: it has succeeded."""
        text = f"the command of `notify` has failed {failures} times: {why}"
        cause = AlarmCause("notify", "command", text, "run it by hand; see `notify` in the fleet file")
        self._conditions.report(cause, holds=failures >= self._rules().notify.limit)

    # Other processes

    def take_request(self, sample: BusSample) -> None:
        """Another process reports a condition of its own; what is not valid is logged."""
        *_, role, name = sample.key.split("/")
        source = f"{role}/{name}"
        try:
            request = AlarmRequest.model_validate_json(sample.payload)
        except ValidationError as error:
            self._log.warning(f"an alarm of {source} is left out: {describe_first_error(error, 'it')}")
            return
        cause = AlarmCause(
            kind=request.kind,
            subject=request.subject,
            text=request.text,
            action=request.action,
            code="",
            priority=request.priority,
            source=source[:MAX_SOURCE],
        )
        if self._has_place(cause, active=request.active):
            self._conditions.report(cause, holds=request.active, for_ns=REQUEST_NS if request.active else None)

    def _has_place(self, cause: AlarmCause, *, active: bool) -> bool:
        """Whether a process may raise this alarm: the number of processes, and of alarms of each, is limited, so that
        they never leave no room for others."""
        requested_records = [
            record for record in self._conditions.register.records if record.source and record.state != "normal"
        ]
        if not active or any(record.id == cause.id for record in requested_records):
            return True
        sources = {record.source for record in requested_records} | {cause.source}
        own_count = sum(record.source == cause.source for record in requested_records)
        if own_count < MAX_REQUESTED and len(sources) <= MAX_SOURCES:
            return True
        self._log.warning(f"an alarm of {cause.source} is left out, because there are too many: {cause.text}")
        return False
