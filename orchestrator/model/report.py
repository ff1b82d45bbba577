"""What a job did: its progress while it runs, and the record afterwards."""

from typing import Any, Literal

from pydantic import Field

from orchestrator.model.base import Int53, Model
from orchestrator.model.messages import Refusal, Term
from orchestrator.model.profile import Profile
from orchestrator.model.queue import Terms
from orchestrator.model.state import AxisEvidence, ClockMapping, StartClass

JobState = Literal[
    "queued",
    "planning",
    "arming",
    "armed",
    "committed",
    "running",
    "holding",
    "done",
    "failed",
    "cancelled",
    "aborted",
    "interrupted",
]
ENDED: frozenset[str] = frozenset({"done", "failed", "cancelled", "aborted", "interrupted"})


class Transition(Model):
    """A change of a job's state: why, by whom, when."""

    state: JobState
    reason: str
    actor: str
    utc: str
    fleet_ns: Int53 | None = None


class Progress(Model):
    """A job as it stands, on `job/{id}/state`."""

    schema_: Literal["tutti.progress/1"] = Field(default="tutti.progress/1", alias="schema")
    job_id: str
    name: str
    actor: str
    state: JobState
    step: int
    steps: int
    step_name: str
    fraction: float = Field(ge=0, le=1)
    remaining_s: float | None
    reason: str
    utc: str


class Skew(Model):
    """A spread of instants that is known only as an interval, in ns."""

    at_least_ns: Int53
    at_most_ns: Int53


class MemberBudget(Model):
    """The predicted start of one member against T0, term by term."""

    terms: list[Term]
    earliest_ns: Int53
    latest_ns: Int53


class Predicted(Model):
    """A skew that is guaranteed not to be larger, what is allowed of it if anything, and who makes it worst."""

    predicted_ns: Int53
    allowed_ns: Int53 | None
    worst_member: str


class Budget(Model):
    """The predicted start skew of a step, guaranteed, and who makes it worst; end and path skew once it is lowered."""

    predicted_ns: Int53
    allowed_ns: Int53
    worst_member: str
    worst_term: str
    by_line: bool = Field(default=False, description="All start by one line: when its edge comes does not matter.")
    members: dict[str, MemberBudget]
    end: Predicted | None = None
    path: Predicted | None = None

    @property
    def slack_ns(self) -> int:
        """What is left of what the job allows: of start, end and path, whichever leaves least."""
        limits = (self.end, self.path)
        left = [each.allowed_ns - each.predicted_ns for each in limits if each and each.allowed_ns is not None]
        return max(0, min([self.allowed_ns - self.predicted_ns, *left]))


class MemberReport(Model):
    """One member's part in a step."""

    start_class: StartClass
    axes: list[str]
    armed_in_ns: Int53 = 0
    stages_ns: dict[str, Int53] = Field(default={})
    mapping: ClockMapping | None = None
    planned_s: dict[str, float] = Field(default={})
    lowered_s: dict[str, float] = Field(default={})
    evidence: dict[str, AxisEvidence] = Field(default={})


class Held(Model):
    """A hold inside a motion step: by whom, when, and how far the axes' rests were apart, by evidence."""

    by: str
    utc: str
    rest_skew: Skew | None = None


class StepReport(Model):
    """What one step did. One that was held inside says of its last part how it went, and when it was held before.

    arming_fleet_ns: when its last arming began. settled_fleet_ns: when T0 was settled, all having promised.
    """

    index: int
    do: str
    name: str
    state: Literal["done", "failed", "skipped", "stopped"]
    reason: str = ""
    planned_s: float | None = None
    actual_s: float | None = None
    arming_fleet_ns: Int53 | None = None
    settled_fleet_ns: Int53 | None = None
    t0_fleet_ns: Int53 | None = None
    members: dict[str, MemberReport] = Field(default={})
    budget: Budget | None = None
    start_skew: Skew | None = None
    end_skew: Skew | None = None
    verdict: Literal["green", "amber", "red", "none"] = "none"
    refused: Refusal | None = None
    holds: list[Held] = Field(default=[])


class AxisRecording(Model):
    """One axis of a step: its profile (counts), and what polls have seen: (fleet ns, actual counts)."""

    unit: str
    counts_per_unit: float
    profile: Profile
    sampled: list[tuple[Int53, float]]


class StepRecording(Model):
    """What a motion step was planned to do and what polls have shown of it. Kept beside the report, which is short."""

    schema_: Literal["tutti.recording/1"] = Field(default="tutti.recording/1", alias="schema")
    step: int
    name: str
    t0_fleet_ns: Int53
    axes: dict[str, AxisRecording]


class JobReport(Model):
    """The record of a job, on `job/{id}/report` and in the journal."""

    schema_: Literal["tutti.report/1"] = Field(default="tutti.report/1", alias="schema")
    job_id: str
    name: str
    actor: str
    state: JobState
    reason: str
    epoch: Int53
    submitted_utc: str
    started_utc: str | None = None
    ended_utc: str | None = None
    max_start_skew_ns: Int53
    repeat: int = 1
    origin: str | None = Field(default=None, description="The job that this one does again.")
    from_step: int = Field(default=0, description="The step that it began with.")
    steps: list[StepReport] = Field(default=[])
    transitions: list[Transition] = Field(default=[])
    notes: dict[str, Any] = Field(default={})


class Lease(Model):
    """Who may move a controller, or an axis of it, on `lease/{controller}[/{axis}]`. No holder: it is free.

    holder: a job's id, or `hand-…` for a person. what: in words.
    """

    schema_: Literal["tutti.lease/1"] = Field(default="tutti.lease/1", alias="schema")
    controller: str
    axis: str | None = None
    holder: str | None
    actor: str
    what: str = ""
    epoch: Int53


class QueueEntry(Model):
    """A job in a list. A job of N steps that is repeated has the steps 0 to repeat * N - 1.

    reason: of its state; of one that is queued, for whom it waits. place: in the queue, the next one is 1. held_by: who
    holds it, if it is held. origin: the job that it does again, from step `from_step` on.
    """

    id: str
    name: str
    actor: str
    state: JobState
    reason: str
    submitted_utc: str
    place: int | None = None
    terms: Terms = Terms()
    held_by: str = ""
    origin: str | None = None
    from_step: int = 0


class QueueState(Model):
    """Jobs in a list: on `queue` those that run, then those that wait, in the queue's order (the first of them, of
    `total` in all); in the answer to `svc/list` the newest of those asked for, newest first."""

    schema_: Literal["tutti.queue/1"] = Field(default="tutti.queue/1", alias="schema")
    total: int = 0
    jobs: list[QueueEntry]
