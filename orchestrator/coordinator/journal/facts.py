"""What the journal records, besides jobs, reports and the values of the models."""

from typing import NamedTuple

from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.queue import QueueTerms
from orchestrator.model.steps.points import PointColumn


class RetryOrigin(NamedTuple):
    """What a new job re-runs: the old job's id, and the step that it begins with."""

    origin: str
    from_step: int


class QueueEntryOptions(NamedTuple):
    """Options of a new job: its place in the queue, and the job that it re-runs. key_owner: whose its key is; with the
    same key of another one it is another job. digest: of the request."""

    terms: QueueTerms = QueueTerms()
    again: RetryOrigin | None = None
    key_owner: str = ""
    digest: str = ""


class KeyedJob(NamedTuple):
    """The job of a client's key: when and by which user it was submitted. digest: of the request; empty in journals of
    schema 10 and before."""

    job_id: str
    actor: str
    submitted_utc: str
    digest: str


class StepDecision(NamedTuple):
    """The decision that a step may move: under which term, when (T0, fleet ns), and its members, joined by commas."""

    step: int
    epoch: int
    t0_fleet_ns: int
    members: str


class Reservation(NamedTuple):
    """Axes that are reserved for work at the machine."""

    holder: str
    actor: str
    what: str
    axes: tuple[str, ...]
    until_utc: str


class AlarmChange(NamedTuple):
    """A change of an alarm. notify: the command of the fleet file is to be run for it."""

    record: AlarmRecord
    notify: bool = False


class AlarmNotice(NamedTuple):
    """A notice that is pending: the alarm as it was, and how often its command has failed."""

    record: AlarmRecord
    tries: int = 0


WORST = "worst"  # at the beginning of a figure's name: the largest value counts, not the sum


class StatisticsRow(NamedTuple):
    """A figure of one UTC day, such as ("2026-01-01", "axis", "gantry.x", "moves", 12)."""

    day: str
    kind: str
    subject: str
    figure: str
    value: float


class UploadState(NamedTuple):
    """How many bytes of an upload are here, of how many. columns: once all are, and the digest is right."""

    received: int
    size: int
    columns: list[PointColumn] | None
