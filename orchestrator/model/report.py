"""What a job did: its progress while it runs, and the record afterwards."""

from fractions import Fraction
from typing import Annotated, Any, Literal, Protocol, Self

from pydantic import Field

from orchestrator.model.base import Int53, Model, Rational
from orchestrator.model.messages import BudgetTerm, RefusalDetails
from orchestrator.model.profile import Profile
from orchestrator.model.queue import CopyMode, QueueStop, QueueTerms
from orchestrator.model.state import AxisEvidence, ClockMapping, ReadPosition, RetargetWay, StartClass, TimeInterval
from orchestrator.model.text.text_fields import SHOW_TEXT
from orchestrator.model.units import Unit

JobState = Literal[
    "queued",
    "planning",
    "arming",
    "armed",
    "committed",
    "running",
    "paused",
    "done",
    "failed",
    "cancelled",
    "aborted",
    "interrupted",
]
FINISHED_STATES: frozenset[str] = frozenset({"done", "failed", "cancelled", "aborted", "interrupted"})


class JobTransition(Model):
    """A change of a job's state, with its reason, originator and time."""

    state: JobState
    reason: Annotated[str, SHOW_TEXT]
    actor: Annotated[str, SHOW_TEXT]
    utc: str
    fleet_ns: Int53 | None = None


class JobProgress(Model):
    """The current state of a job, on `job/{id}/state`."""

    schema_: Literal["tutti.progress/1"] = Field(default="tutti.progress/1", alias="schema")
    job_id: str
    name: str
    actor: str
    state: JobState
    step: int
    steps: int
    step_name: str
    scan_step: Int53 | None = Field(default=None, description="Within a scan: the index of its first step, from 0.")
    point: Int53 | None = Field(default=None, description="The point of the scan, from 1.")
    points: Int53 | None = None
    fraction: float = Field(ge=0, le=1)
    remaining_s: float | None
    line: Int53 | None = Field(
        default=None, description="On a path that was made of a file: the line of it that runs now, from 1."
    )
    override_percent: float | None = Field(
        default=None, description="On a path whose speed can be changed: that speed, in percent of the planned one."
    )
    armed: "ArmedState | None" = Field(default=None, description="While a motion is loaded, and waits.")
    reason: str
    utc: str
    ready: bool = Field(
        default=False, description="What the job had to wait for is gone; it begins when its start is asked for."
    )

    def follows(self, before: "JobProgress | None") -> bool:
        """Whether it is newer than `before`, of the same job: an end comes before all else on the bus, and overtakes
        what was published just before it."""
        return before is None or before.state not in FINISHED_STATES or self.state in FINISHED_STATES


class QueuedJob(Protocol):
    """What a record of a job in the queue, or its entry in a list, has."""

    @property
    def id(self) -> str: ...

    @property
    def name(self) -> str: ...

    @property
    def actor(self) -> str: ...

    @property
    def from_step(self) -> int: ...


def make_queued_progress(job: QueuedJob, state: JobState, reason: str, utc: str, steps: int) -> JobProgress:
    """The progress of a job that is not running. steps: of all its repeats."""
    return JobProgress(
        job_id=job.id,
        name=job.name,
        actor=job.actor,
        state=state,
        step=job.from_step,
        steps=steps,
        step_name="",
        fraction=job.from_step / steps,
        remaining_s=None,
        reason=reason,
        utc=utc,
    )


class SkewInterval(Model):
    """A spread of instants that is known only as an interval, in ns."""

    at_least_ns: Int53
    at_most_ns: Int53


class MemberBudget(Model):
    """The predicted start of one member relative to T0, term by term."""

    terms: list[BudgetTerm]
    earliest_ns: Int53
    latest_ns: Int53


class PredictedSkew(Model):
    """A guaranteed upper bound of a skew, the allowed value if there is one, and the member with the largest share."""

    predicted_ns: Int53
    allowed_ns: Int53 | None
    worst_member: str


class VirtualBound(Model):
    """How far a virtual axis may be off its line on the way, in its unit: guaranteed where the starts are as
    promised."""

    most: float
    unit: Unit


class PairBound(Model):
    """How far the two axes of a pair may be apart after any single fault while a step moves them, less `square`, in the
    unit of the pair: how far the beam is racked then, at most."""

    most: float
    unit: Unit


class PositionBound(Model):
    """How far an axis may be from its target once it rests there, in its unit, by what the fleet file states of it:
    `most`, the sum of the other terms. rounding: to whole counts. table: the uncertainty of its table of errors. play:
    what is not known of the play of its drive, as before the first motion that takes it up."""

    most: float
    rounding: float
    table: float
    play: float
    unit: Unit


class RackBound(Model):
    """How far the two motors of an axis may be apart on the way, in its unit: `most` after any single fault, `watched`
    without one. speed: the highest one of the way, unit/s."""

    most: float
    watched: float
    speed: float
    unit: Unit


class SyncBudget(Model):
    """The guaranteed predicted start skew of a step and the member with the largest share; end and path skew once the
    step is lowered."""

    predicted_ns: Int53
    allowed_ns: Int53
    worst_member: str
    worst_term: str
    by_trigger_line: bool = Field(
        default=False, description="All start by one trigger line: the instant of its edge does not matter."
    )
    members: dict[str, MemberBudget]
    end: PredictedSkew | None = None
    path: PredictedSkew | None = None

    @property
    def margin_ns(self) -> int:
        """The remaining margin of what the job allows: the smallest of start, end and path."""
        limits = (self.end, self.path)
        margins_ns = [
            limit.allowed_ns - limit.predicted_ns for limit in limits if limit and limit.allowed_ns is not None
        ]
        return max(0, min([self.allowed_ns - self.predicted_ns, *margins_ns]))


PathTermName = Literal["profile-fit", "compensation", "execution", "start", "clock"]


class PathTerm(Model):
    """One term of a path-error bound.

    member: the controller; empty for the plan itself. profile-fit: profiles against the path. execution: the member
    against its profiles, as it states itself. start: its share of what the start windows of all members do together at
    the speeds of the path. clock: the same of the bounds of their rates over the time since the start.
    """

    name: PathTermName
    member: str = ""
    size: float = Field(ge=0)


class PathBound(Model):
    """The guaranteed greatest distance of the axes from the path, `predicted`: the sum of `terms`, in `unit`. proven:
    the same afterwards, by the controllers' evidence of their starts and ends; None until the path is over."""

    unit: Unit
    tolerance: float
    predicted: float
    terms: list[PathTerm]
    proven: float | None = None

    @property
    def largest(self) -> PathTerm:
        """The term with the largest share."""
        return max(self.terms, key=lambda term: term.size)


class PathStretch(Model):
    """A part of a path in time, and what limits the speed along it there."""

    from_s: float
    to_s: float
    binds: str


class PathStop(Model):
    """A place, in the time of the path, where it was braked along it because a chunk was not loaded in time."""

    at_s: float
    member: str = ""
    reason: str


class PathReport(Model):
    """A path as it is planned. length: along it, in `unit`, in the coordinates of its frame, if it has one. bound: once
    its members have answered. stops: where its members had to wait for its continuation."""

    unit: Unit
    frame: str = ""
    length: float
    duration_s: float
    stretches: list[PathStretch] = Field(default=[])
    bound: PathBound | None = None
    stops: list[PathStop] = Field(default=[])


class MemberReport(Model):
    """One member's part in a step. arming_fleet_ns: when its adapter began to arm it; armed_in_ns: how long that took;
    stages_ns: the last parts of it, in their order."""

    start_class: StartClass
    axes: list[str]
    arming_fleet_ns: Int53 | None = None
    armed_in_ns: Int53 = 0
    stages_ns: dict[str, Int53] = Field(default={})
    mapping: ClockMapping | None = None
    planned_s: dict[str, float] = Field(default={})
    lowered_s: dict[str, float] = Field(default={})
    evidence: dict[str, AxisEvidence] = Field(default={})


class FeedHold(Model):
    """A feed hold inside a motion step: the user behind it, when, and the spread of the axes' stops, by evidence."""

    by: str
    utc: str
    rest_skew: SkewInterval | None = None


class StepRetarget(Model):
    """Other targets that a moving step has got, in user positions, each in the unit of its axis.

    number: from 1. before: the targets that it had; empty where it was not planned yet. replaced: how many retargets
    before it were overtaken by it. asked_fleet_ns: when it was asked for. changed_ns: from then until its set-points
    had changed, at the latest; started_ns: from then to the T0 of the new motion. None: that did not come about, as
    where nothing moved yet, or the axes stood at the target already.
    """

    number: Int53
    by: str
    utc: str
    before: dict[str, float]
    to: dict[str, float]
    way: RetargetWay
    replaced: Int53 = 0
    asked_fleet_ns: Int53
    changed_ns: Int53 | None = None
    started_ns: Int53 | None = None


Verdict = Literal["green", "amber", "red", "none"]
VERDICTS: tuple[Verdict, ...] = ("green", "amber", "red")
"""From the best to the worst."""


class PointFinding(Model):
    """A point of a scan that is not green. point: its number, from 1."""

    point: Int53
    verdict: Verdict
    text: str = ""


class ScanSummary(Model):
    """What the points of a scan did, together.

    points: of the scan; done: of this run. steps_done: moves, and steps at points. verdicts: how many points of each.
    start_skew_…: upper bounds of the start skew over all points, ns; p50 and p99 are at most 2 % too large. not_green:
    the first of them. …_s: time from point to point, with the steps there.
    """

    points: Int53
    done: Int53
    steps_done: Int53
    verdicts: dict[Verdict, Int53] = Field(default={})
    start_skew_worst_ns: Int53 | None = None
    start_skew_p50_ns: Int53 | None = None
    start_skew_p99_ns: Int53 | None = None
    not_green: list[PointFinding] = Field(default=[])
    least_s: float | None = None
    mean_s: float | None = None
    most_s: float | None = None


class PointWindow(Model):
    """When an axis that flies passed the window of a point: its beginning, the point itself, and its end; fleet time,
    by the plan and the evidence of the start and the end of its line. positions: by axis, between which positions it
    was at the centre of `middle`, in its unit."""

    lower: TimeInterval
    middle: TimeInterval
    upper: TimeInterval
    positions: dict[str, tuple[float, float]] = Field(default={})


class PointRecord(Model):
    """The record of one point of a scan. step: the number of the first step of its scan; point: from 1.

    target: by axis, in its unit; measured: the last reading while the axis stood there, None: it left before the next
    one, or flew through. took_s: since the point before, or the beginning; of a scan that flies the time in the window.
    window: of a scan that flies. good: whether its line was done as planned; None of a point at which the axes stop.
    """

    step: Int53
    point: Int53
    state: Literal["done", "failed", "skipped", "stopped"]
    verdict: Verdict
    t0_fleet_ns: Int53 | None = None
    start_skew: SkewInterval | None = None
    took_s: float | None = None
    target: dict[str, float]
    measured: dict[str, float | None]
    window: PointWindow | None = None
    good: bool | None = None


class StepChain(Model):
    """How a motion step followed the one before it. kept: it was loaded while that one moved, and began at the T0 that
    was agreed then. gap_s: from the end of that one to its start, by evidence. broken: why it began from rest."""

    step: int
    kept: bool
    gap_s: float | None = None
    broken: str = ""


class SamplingReport(Model):
    """What controllers have recorded by themselves during a step. samples: by controller, how many of each axis.
    problem: why there are fewer, or none."""

    samples: dict[str, Int53] = Field(default={})
    problem: str = ""


class AxisPlace(Model):
    """Where an axis was at an instant that is known as an interval: between these positions, in its unit (motor
    position), by plan and evidence of its start."""

    least: float
    most: float


class TriggerRow(Model):
    """One instant of a trigger. number: from 1. planned_ns, earliest_ns, latest_ns: the instant asked for, and the
    interval promised for the edge, fleet time. seen: the interval of the edge by evidence of the controller; None: it
    did not happen, or nothing is known of it. positions: of the axes of the step at that, of a step that was done."""

    number: Int53
    planned_ns: Int53
    earliest_ns: Int53
    latest_ns: Int53
    seen: TimeInterval | None = None
    positions: dict[str, AxisPlace] = Field(default={})


class LatchReport(Model):
    """A position that a controller has captured by an input. position: of the user, in `unit`; counts: of the
    controller. seen: the interval in which that was. How soon after the edge it was captured depends on the make."""

    axis: str
    input: str
    position: float
    unit: Unit
    counts: Int53
    seen: TimeInterval


class ProbeReport(Model):
    """What a probe has found. Positions are of the user, in `unit`; those of the contact are bounds of it.

    touched: the input has changed; what is said of the contact counts only then. motor: the middle of its bounds, motor
    position. seen: the interval in which that was. overtravel: how far the axis went on at most; stated: the
    bound of that which was stated before. released: the input has changed back since. others: the further axes of a
    line, at the same contact.
    """

    axis: str
    until: str
    unit: Unit
    touched: bool
    start: float
    rest: float
    least: float = 0.0
    most: float = 0.0
    motor: Rational = Fraction(0)
    seen: TimeInterval | None = None
    overtravel: float = 0.0
    stated: float = 0.0
    released: bool = False
    by: Literal["controller", "host"] = "controller"
    others: list[Self] = Field(default=[], exclude_if=lambda reports: not reports)


class TriggerReport(Model):
    """What an output did on the way. planned: instants of the plan; seen: edges by evidence of the controller.

    outside: of them, those that were certainly not within the promise. widest_ns: of the intervals by evidence. rows:
    the first ones; all of them are in the recording. problem: why there are fewer, or none.
    """

    output: str
    planned: Int53
    seen: Int53 = 0
    outside: Int53 = 0
    widest_ns: Int53 = 0
    rows: list[TriggerRow] = Field(default=[])
    problem: str = ""


class ArmedState(Model):
    """A motion that is loaded in its controllers, and waits. input: that starts it, besides a request. lead_ns: from
    that start to T0 if it comes now. most_lead_ns: the same at most, as the controllers declare it: it comes while they
    are loaded anew."""

    input: str | None = None
    since_fleet_ns: Int53
    until_fleet_ns: Int53
    lead_ns: Int53
    most_lead_ns: Int53


class ArmedReport(Model):
    """How a motion that waited armed was started. go_fleet_ns: when the request came, or the input was read with its
    new value. lead_ns: from then to T0."""

    since_fleet_ns: Int53
    go_fleet_ns: Int53
    by: Literal["input", "request"]
    lead_ns: Int53


class StepReport(Model):
    """The record of one step, or of a whole scan (`scan`), followed by that of its point that was not done.
    After feed holds and retargets it describes the last part, and lists those before; of retargets, the last ones.

    verdict: green only if starts, durations and ends are certainly as promised, by the controllers' evidence and by the
    promises. start_skew: by the evidence alone. promised_skew: where the promises make it narrower, what they make of
    it; it holds while links and hosts stay within their models. arming_fleet_ns: start of its last
    arming. settled_fleet_ns: when T0 was settled, after all members had promised.
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
    waited_armed: ArmedReport | None = Field(default=None, description="Behind a `wait_armed`.")
    members: dict[str, MemberReport] = Field(default={})
    budget: SyncBudget | None = None
    start_skew: SkewInterval | None = None
    promised_skew: SkewInterval | None = None
    end_skew: SkewInterval | None = None
    verdict: Verdict = "none"
    deviations: list[str] = Field(
        default=[], description="What differs from the plan although the step is done: durations, ends, positions."
    )
    refused: RefusalDetails | None = None
    feed_holds: list[FeedHold] = Field(default=[])
    retargets: list[StepRetarget] = Field(default=[])
    scan: ScanSummary | None = None
    positions: dict[str, ReadPosition] = Field(
        default={},
        description="Of a move that is done, by axis: where it was read at rest behind it, and when. An axis that a "
        "following step has moved before its next reading is left out.",
    )
    sampling: SamplingReport | None = None
    triggers: list[TriggerReport] = Field(default=[])
    latch: LatchReport | None = None
    probe: ProbeReport | None = None
    path: PathReport | None = None
    virtual: dict[str, VirtualBound] = Field(
        default={}, description="Of a move of virtual axes: how far each may be off its straight line on the way."
    )
    bounds: dict[str, PositionBound] = Field(
        default={},
        description="Of axes with `backlash` or `correction`, and corrected ones: how far each may be from its target.",
    )
    racks: dict[str, RackBound] = Field(
        default={},
        exclude_if=lambda racks: not racks,
        description="Of axes of two motors: how far these may be apart on the way.",
    )
    pairs: dict[str, PairBound] = Field(
        default={}, description="Of a move of a pair: how far it may be racked after any single fault."
    )
    chain: StepChain | None = Field(default=None, description="How it followed the motion step before it.")

    @property
    def probed_axes(self) -> list[ProbeReport]:
        """What a probe has found, by each of its axes; empty for another step."""
        return [] if self.probe is None else [self.probe, *self.probe.others]

    @property
    def steps_done(self) -> int:
        """The number of steps that are done, with those of a scan."""
        return self.scan.steps_done if self.scan is not None else int(self.state == "done")

    @property
    def narrowest_skew(self) -> SkewInterval | None:
        """The start skew by all that is known: evidence, and promises where they make it narrower."""
        return self.promised_skew or self.start_skew


class AxisRecording(Model):
    """One axis of a step: its profile (counts), and polled samples: (fleet ns, actual counts)."""

    unit: str
    counts_per_unit: float
    profile: Profile
    sampled: list[tuple[Int53, float]]


class StepRecording(Model):
    """The plan of a motion step and its polled samples. Kept apart from the report, which is short."""

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
    origin: str | None = Field(default=None, description="The job that this one re-runs.")
    from_step: int = Field(default=0, description="The step that it began with, from 0.")
    parameters_used: dict[str, str] = Field(
        default={}, description="The parameters of the template that it was made of, with their values."
    )
    positions_used: dict[str, dict[str, str]] = Field(
        default={},
        description="The named positions of its targets: by name, the value of each axis that was taken when it began.",
    )
    verdict: Verdict | None = Field(
        default=None,
        description="The worst verdict of its steps, if it was done and one of them has a verdict; null otherwise, for "
        "the reason in `verdict_reason`.",
    )
    verdict_reason: str = ""
    steps: list[StepReport] = Field(default=[])
    transitions: list[JobTransition] = Field(default=[])
    notes: dict[str, Any] = Field(default={})

    def judge(self) -> "JobReport":
        """The report with the verdict on the job: it belongs to what was done."""
        verdicts: list[Verdict] = [step.verdict for step in self.steps if step.verdict != "none"]
        verdict: Verdict | None = None
        reason = ""
        if self.state != "done":
            reason = f"the job is {self.state}: a verdict belongs to what was done"
        elif not verdicts:
            reason = "no step of it starts several members together"
        else:
            verdict = max(verdicts, key=VERDICTS.index)
        return self.model_copy(update={"verdict": verdict, "verdict_reason": reason})


class LeaseState(Model):
    """The holder that may move a controller, or an axis of it, on `lease/{controller}[/{axis}]`. No holder: it is free.

    holder: a job's id, or `manual-…` for an operator. what: the purpose in words.
    """

    schema_: Literal["tutti.lease/1"] = Field(default="tutti.lease/1", alias="schema")
    controller: str
    axis: str | None = None
    holder: str | None
    actor: str
    what: str = ""
    until_utc: str | None = Field(default=None, description="When a reservation ends by itself.")
    epoch: Int53


class QueueEntry(Model):
    """A job in a list. A job of N steps that is repeated has the steps 0 to repeat * N - 1.

    reason: of its state; for a queued job, what it waits for. ready: what it had to wait for is gone, and its start has
    to be asked for. place: position in the queue, 1 is next. held_by:
    originator of the hold, if it is held; `approval` while its plan waits for that. origin: the job that it re-runs,
    from step `from_step` on, counted from 0. proposed: it needs the approval of its plan. note: in the answer to its
    submission, what the journal does not promise.
    """

    id: str
    name: str
    actor: str
    state: JobState
    reason: str
    submitted_utc: str
    place: int | None = None
    terms: QueueTerms = QueueTerms()
    held_by: str = ""
    origin: str | None = None
    from_step: int = 0
    proposed: bool = False
    ready: bool = False
    note: str = Field(default="", exclude_if=lambda note: not note)


class MissingPermit(Model):
    """A permit that does not hold, or has not settled yet, and the axes that may not move without it."""

    name: str
    axes: list[str]
    text: str


class QueueState(Model):
    """A list of jobs. On `queue`: the running ones, then the waiting ones in the queue's order (the first of `total`).
    In the answer to `svc/list`: the matching jobs, newest first."""

    schema_: Literal["tutti.queue/1"] = Field(default="tutti.queue/1", alias="schema")
    total: int = 0
    jobs: list[QueueEntry]
    stopped: QueueStop | None = Field(default=None, description="No job of the queue begins: since when, and why.")
    waiting: int = Field(default=0, description="Number of waiting jobs.")
    missing_permits: list[MissingPermit] = Field(default=[])
    journal: CopyMode | None = Field(
        default=None,
        exclude_if=lambda mode: mode is None,
        description="On how many machines the journal is, where that is in a database.",
    )
