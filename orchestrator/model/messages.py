"""Requests and replies on the bus. A refusal is a value: a reply reports either what was done or why it was not."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from orchestrator.model.base import Actor, HostNs, Id, Int53, Label, Model, Sentence
from orchestrator.model.errors import Refusal
from orchestrator.model.profile import Profile
from orchestrator.model.state import ClockMapping, ControllerState, EstopLatch, StartClass, StartWish, StepCosts
from orchestrator.model.units import Quantity
from orchestrator.model.version import ProtocolText


class RefusalDetails(Model):
    """A refusal on the bus and in reports: why something was not done, and what to do about it.

    code: for programs; it does not change. member: the controller that refuses, if it was one.
    """

    code: str
    text: str
    remedy: str = ""
    member: str | None = None

    @classmethod
    def of(cls, error: Refusal) -> Self:
        """The details of `error`."""
        return cls(code=error.code, text=error.text, remedy=error.remedy, member=error.controller)

    def as_error(self) -> Refusal:
        """The error to raise for it."""
        return Refusal(self.code, self.text, self.remedy, self.member)

    def as_step_error(self) -> Refusal:
        """The error to raise for a step that this controller refuses; its text names the controller."""
        return Refusal(self.code, f"{self.member}: {self.text}", self.remedy, self.member)


class Request(Model):
    """Fields that every request has."""

    request_id: Label
    actor: Actor


class Reply(Model):
    """Fields that every reply has."""

    refused: RefusalDetails | None = None


def raise_first_refusal(replies: Mapping[str, Reply]) -> None:
    """Raise the first refusal among the replies of a step's controllers; its text names the controller.

    Raises `Refusal`.
    """
    for reply in replies.values():
        if reply.refused is not None:
            raise reply.refused.as_step_error()


class BatchRequest(Model):
    """The same verb for several controllers of one adapter host, in one request.

    requests: by controller, the JSON text of its own request. within_ns: a controller that has not answered by then is
    left out of the reply; its request continues.
    """

    requests: dict[Id, str] = Field(min_length=1)
    answer_within_ns: Int53 = Field(gt=0)


class BatchReply(Model):
    """By controller: the JSON text of its own reply, or why its request is not valid. A controller that is absent or
    has not answered in time is in neither.

    took_ns: from the batch request to each answer."""

    replies: dict[Id, str] = Field(default={})
    errors: dict[Id, str] = Field(default={})
    took_ns: dict[Id, Int53] = Field(default={})


class FencedRequest(Request):
    """A request that only the current leader may make: epoch and uuid of its leadership."""

    epoch: Int53
    coordinator: str


COMPARING = "comparing-latches"
"""Code of a refusal to be adopted: an adapter that starts has not yet compared e-stop latches with other processes."""

MAX_EPOCH_STEP = 1_000_000
"""Each start of a coordinator takes one epoch. One that is further from the known one is no real one; if it were
accepted, it would shut out all coordinators after it."""

MAX_EPOCH = 2**52  # of a journal; one start in a nanosecond would reach it in fifty days

EPOCH_REMEDY = "if no other coordinator leads: `tutti repair epoch`, with all axes at rest"

HEARTBEAT_NS = 100_000_000  # period of the leader's heartbeat


class LeaderHeartbeat(Model):
    """The leader's heartbeat, with its fleet time: fleet_ns = host_ns - origin_host_ns on the leader's kernel.

    estop: the event of the e-stop that the leader keeps, for an adapter host that did not receive it; empty: none.
    tutti, protocol: versions of the leader (`orchestrator.model.version`).
    """

    schema_: Literal["tutti.leader/1"] = Field(default="tutti.leader/1", alias="schema")
    fleet: str
    epoch: Int53
    coordinator: str
    seq: Int53
    scale_id: str
    kernel_id: str
    origin_host_ns: HostNs
    utc: str
    estop: Label = ""
    tutti: Label = ""
    protocol: ProtocolText = ""

    # It is also a part of the request to adopt, which a newer coordinator sends.
    model_config = ConfigDict(extra="ignore")


class TimeReply(Model):
    """The leader's fleet time when it answered."""

    scale_id: str
    fleet_ns: Int53


class AdoptRequest(FencedRequest):
    """Adopt a controller: it accepts this epoch from now on, and no older one."""

    leader: LeaderHeartbeat


class AcceptEpoch(Request):
    """Take the epoch of the present leader for the highest one, although it is older, or far from the one that the
    adapter remembers; at rest only, by order of a person. No other coordinator may lead. The leader then
    adopts the controller."""

    epoch: Int53
    coordinator: str


class AdoptedReply(Reply):
    """last_job, last_step: of the last command to the controller that may have changed something at the machine, since
    its adapter has started; the step only of one that has steps. A journal that was replaced by a copy may not know of
    it. Empty: none."""

    epoch: Int53 = 0
    mode: str = "idle"
    last_job: str = ""
    last_step: Int53 | None = None


class StepRequest(FencedRequest):
    """A request about one motion step."""

    job: str
    step: int


class TriggerWait(Model):
    """Start when a trigger line becomes active.

    input: the member's own, by name. The edge is at its terminal between T0 + earliest_ns and T0 + latest_ns.
    """

    input: Id
    earliest_ns: Int53
    latest_ns: Int53


class TriggerDrive(Model):
    """Make a trigger line active at T0, and passive again after `active_ns`. output: the member's own, by name."""

    output: Id
    active_ns: Int53 = 100_000_000


class ChunkOptions(Model):
    """The profiles are a part of a path: along it up to `end_s` after T0, then to rest. last: there the path ends.
    Otherwise another chunk follows while this one is executed.

    peak_accelerations, peak_jerks: by axis, the largest of the whole path, counts/s², counts/s³, for what the member
    states of its path error.
    """

    end_s: float
    last: bool
    peak_accelerations: dict[str, float] = Field(default={})
    peak_jerks: dict[str, float] = Field(default={})


class OutputTrigger(Model):
    """Switch an output on the way. output: the member's own, by name.

    instants_ns: from T0 on, growing; of a path in chunks, those of the first chunk, if it has any. pulse_ns: how long
    it is active each time; 0: it changes its level each time, first to active, and is passive after the end of the
    step. axis: the member's own axis of whose positions the instants were made; None: they are times, or positions of
    an axis of another member. least_ns: of a path in chunks, the shortest time from one instant to the next on all of
    it, as planned; 0: it has one at most.
    """

    output: Id
    axis: Id | None = None
    instants_ns: list[Int53]
    pulse_ns: Int53 = Field(ge=0)
    least_ns: Int53 = Field(default=0, ge=0)


class ChunkTrigger(Model):
    """The instants of an output that come with a chunk of a path: up to its `end_s`, none in its stopping tail.

    output: the member's own, by name, of the arming. first: how many of the motion's instants come before these; what
    was loaded behind them is withdrawn. instants_ns: from T0 on, growing.
    """

    output: Id
    first: Int53 = Field(ge=0)
    instants_ns: list[Int53]


class StartOptions(Model):
    """How a member is to start.

    by: a start class, or `auto` for the best one; with `wait` it is `line`.
    lead_ns: maximum time from the last reading of the controller's clock to T0; clock bounds are promised for this
    long.
    drive: the member drives a trigger line; it may also move axes, or only drive the line (no profiles).
    exact: T0 is exactly `lead_ns` ahead.
    brake_s: how long a stop from the peak velocity should take, so that all axes of the step stay on their common path
    and come to rest together; 0: as short as the limits allow.
    end_ns: how long after T0 a member that ends at its own ticks should end: at most a few ticks after the plan, where
    the ticks of all members coincide best; 0: with the plan.
    early_ns: how much before the plan an axis may end if it cannot move as slowly as planned.
    follows: the move begins where the member's present move ends, and is loaded while that one runs, as far as the make
    can.
    at_once: no other member depends on this start: T0 is the earliest instant of a start as soon as the member can.
    waits_armed: the move is loaded long before its start is asked for, which is to follow soon then: what counts is
    how late the start can be withdrawn, not how long unloading takes.
    chunk: the move is the first chunk of a path; of a member that moves no axis of it, its triggers are.
    triggers: outputs of the member that it switches on the way; it may also move no axis of the step.
    """

    start_class: StartWish = "auto"
    lead_ns: Int53 = 0
    exact: bool = False
    brake_s: float = 0.0
    end_ns: Int53 = 0
    early_ns: Int53 = 0
    follows: bool = False
    at_once: bool = False
    waits_armed: bool = False
    wait: TriggerWait | None = None
    drive: TriggerDrive | None = None
    chunk: ChunkOptions | None = None
    triggers: list[OutputTrigger] = Field(default=[])

    @property
    def starts_soon(self) -> bool:
        """Whether the release comes close to the start, so that what counts is how late that can be withdrawn."""
        return self.follows or self.waits_armed


class ProposeRequest(StepRequest):
    """Ask whether a member can execute these profiles. digest: the configuration that the coordinator assumes.

    rehearsal: the profiles begin where earlier steps will leave the axes, so their present state is not compared.
    """

    digest: str
    duration_s: float
    profiles: dict[str, Profile]
    start: StartOptions = StartOptions()
    rehearsal: bool = False


class BudgetTerm(Model):
    """One term of a budget: because of it, the start lies between T0 + earliest_ns and T0 + latest_ns."""

    name: Literal[
        "clock",
        "wire",
        "firmware",
        "tick",
        "host",
        "quantisation",
        "tick-residual",
        "line",
        "input",
        "output",
        "learned-starts",
        "fleet-time",
        "at-once",
    ]
    earliest_ns: Int53
    latest_ns: Int53


def sum_terms(terms: Iterable[BudgetTerm]) -> tuple[int, int]:
    """The earliest and the latest instant around T0 that the terms together allow, ns."""
    term_list = list(terms)
    return sum(term.earliest_ns for term in term_list), sum(term.latest_ns for term in term_list)


class Proposal(Reply):
    """What a member can execute of the proposed profiles."""

    durations_s: dict[str, float] = Field(default={}, description="By axis, as the controller will execute it.")
    path_error_counts: dict[str, float] = Field(default={}, description="Maximum distance from the plan, by axis.")
    costs: StepCosts | None = None
    start_class: StartClass = "host"
    tick_ns: float = 0.0
    tick_at_fleet_ns: Int53 | None = Field(default=None, description="One of the ticks at which it could start.")
    terms: list[BudgetTerm] = Field(default=[])
    edge: list[BudgetTerm] = Field(
        default=[], description="Window of the edge of the trigger line that it drives, relative to T0."
    )
    triggers: dict[Id, list[BudgetTerm]] = Field(
        default={}, description="By output with a trigger: window of its edges relative to the instants asked for."
    )
    trigger_least_ns: dict[Id, Int53] = Field(
        default={}, description="By output with a trigger: the shortest time from one instant to the next."
    )
    clock_ppm: float = Field(default=100.0, description="Guaranteed bound of the controller's rate error.")
    can_advance: bool = Field(default=False, description="Whether T0 can be brought forward after it was armed.")
    gap_ns: Int53 | None = Field(
        default=None,
        description="Of a move that follows, and that the controller can hold beside its present one: how long after "
        "the promised end of that it can begin. Without it, the member loads the move then.",
    )
    commands: list[str] = Field(default=[], description="The commands that the controller would receive, for people.")
    starts_at_once: bool = Field(
        default=False,
        description="Whether one request can load the step and start it, at a T0 that the member chooses.",
    )


class ArmRequest(StepRequest):
    """Load the move for a start at T0; do not move.

    after_step: the step of the same job that may still be moving the member; the new move begins where that one ends,
    and only if it ends as planned. None: the member is at rest.
    """

    digest: str
    t0_fleet_ns: Int53
    after_step: int | None = None
    profiles: dict[str, Profile]
    start: StartOptions = StartOptions()


class ArmedReply(Reply):
    """The step is loaded. durations_s, terms, edge, triggers: as in the proposal, for the clock mapping that is frozen
    into it, at T0.

    waits: the controller cannot load the move while its present one runs. The adapter loads it as soon as that has
    ended, and answers the commit after that.
    """

    waits: bool = False
    durations_s: dict[str, float] = Field(default={})
    terms: list[BudgetTerm] = Field(default=[])
    edge: list[BudgetTerm] = Field(default=[])
    triggers: dict[Id, list[BudgetTerm]] = Field(default={})
    mapping: ClockMapping | None = None
    began_fleet_ns: Int53 | None = Field(default=None, description="When the adapter began.")
    took_ns: Int53 = 0
    stages_ns: dict[str, Int53] = Field(default={}, description="Duration of each stage of arming.")


class CommitRequest(StepRequest):
    """Promise to start at T0 if `go` comes; a member that can advance promises each earlier T0 by whole ticks, too."""

    t0_fleet_ns: Int53


class CommittedReply(Reply):
    """The member promises. armed: what it has loaded since it answered that the move waits for the present one."""

    armed: ArmedReply | None = None


class GoRequest(StepRequest):
    """All members have promised: start at T0.

    advance_ns: how much earlier than the T0 that it was armed for, a whole number of the member's ticks (`tick_ns` of
    its proposal, if it has any); only for members that can advance.
    start_tolerance_ns: how much later than promised a member may start, because the job allows more than was promised;
    a member that could only start later than that does not start.
    """

    t0_fleet_ns: Int53
    advance_ns: Int53 = 0
    start_tolerance_ns: Int53 = 0


class StartAtOnceRequest(StepRequest):
    """Load a step that no other member takes part in, and start it as soon as the controller can. Its decision is
    recorded.

    decided_fleet_ns: the instant of the decision, for which the step starts once. after_step: as of an arming; the step
    starts as soon as that one has ended as planned. lead_ns: for what T0 it is loaded, before that is brought forward:
    arming, and what the start needs. not_before_fleet_ns: the planned end of a step beside which the controller can
    hold this one.
    """

    digest: str
    decided_fleet_ns: Int53
    after_step: int | None = None
    lead_ns: Int53
    not_before_fleet_ns: Int53 = 0
    start_tolerance_ns: Int53 = 0
    profiles: dict[str, Profile]
    start: StartOptions = StartOptions()


class StartedReply(ArmedReply):
    """The step is loaded and released. t0_fleet_ns: the T0 that the member has chosen."""

    t0_fleet_ns: Int53 = 0


class LoadChunkRequest(StepRequest):
    """Load the next chunk of a path, for the motion that began at T0. number: of the chunk; the step itself is chunk 0.

    begin_s: from T0 to the beginning of the profiles. What the member executes there is what they begin with.
    """

    t0_fleet_ns: Int53
    number: int = Field(ge=1)
    begin_s: float
    chunk: ChunkOptions
    profiles: dict[str, Profile]
    triggers: list[ChunkTrigger] = Field(default=[])


class ChunkReply(Reply):
    """The chunk is loaded. drift_ns: how far the member's clock had drifted from the plan, and is corrected on the way;
    left_ns: what of that remains at its end. bound_ns: guaranteed error of its clock mapping. stop_s: when it is at
    rest, from T0, if no further chunk comes. triggers: as in the proposal, for the instants of the chunk."""

    stop_s: float = 0.0
    drift_ns: Int53 = 0
    left_ns: Int53 = 0
    bound_ns: Int53 = 0
    path_error_counts: dict[str, float] = Field(default={})
    triggers: dict[Id, list[BudgetTerm]] = Field(default={})


class ReleaseChunkRequest(StepRequest):
    """All members have loaded the chunk: change over to it."""

    t0_fleet_ns: Int53
    number: int


class RetargetRequest(StepRequest):
    """Continue the motion that began at T0 by other profiles: up to `from_s` after T0 they are the present ones."""

    t0_fleet_ns: Int53
    from_s: float
    profiles: dict[str, Profile]


class RetargetReply(Reply):
    """The motion is continued so. durations_s: by axis, from T0 to its end."""

    durations_s: dict[str, float] = Field(default={})


class DisarmRequest(StepRequest):
    """Unload; nothing starts.

    if_waiting: only a step that waits for the end of the present one; one that has been started stays untouched."""

    if_waiting: bool = False


class DisarmedReply(Reply):
    """may_have_started: the member was released before, and its stop came so late that it may have started."""

    may_have_started: bool = False


StopMode = Literal["decelerate", "abort", "feed-hold"]


class StopRequest(Request):
    """Stop the controller; accepted from any client at any epoch.

    decelerate: by its planned ramp. abort: as fast as it can. feed-hold: by its planned ramp; the step is followed
    until it is at rest, so that there is evidence of when that was."""

    mode: StopMode = "decelerate"
    reason: Sentence = ""


class AxesRequest(FencedRequest):
    """A request about axes of one controller, by their names in the fleet file."""

    axes: list[str]


class PairLease(Model):
    """How an axis of a pair is jogged. by: the virtual axis that moves both. reach: how far one jog goes, in the axis's
    unit: if the link of one is lost, it goes on to that end, and its partner is stopped."""

    by: str = Field(max_length=140)
    reach: float = Field(gt=0)


class JogRoom(Model):
    """Between which motor positions an axis that moves bodies of zones is jogged while it has a reference, in its unit.

    low, high: it is not jogged beyond; it may be jogged back from there. low_by, high_by: the rule of the fleet file
    that ends it; empty: its range does. Where the bodies of a rule stand too near already, the room leads out.
    """

    low: float
    high: float
    low_by: str = Field(default="", max_length=140)
    high_by: str = Field(default="", max_length=140)

    def narrow(self, other: "JogRoom") -> "JogRoom":
        """The room in both."""
        low = self if self.low >= other.low else other
        high = self if self.high <= other.high else other
        return JogRoom(low=low.low, low_by=low.low_by, high=high.high, high_by=high.high_by)


class LeaseRequest(AxesRequest):
    """Only `holder` may move these axes, for `ttl_ms` or until the lease is renewed; 0 ends it.

    What the holder moves when its lease ends is stopped. holder: of a job, its id. reason: why it is ended.
    acquisition: increases with each acquisition of axes, so that a late renewal does not revive a lease that has ended.
    session: the session of a command that a person waits for; the lease ends when its signs of life are missing.
    pairs: of axes that are one of a pair, how they are jogged. rooms: of axes that move bodies of zones,
    where; that of an axis that is being jogged does not change.
    """

    holder: Label
    pairs: dict[Id, PairLease] = Field(default={}, max_length=64)
    rooms: dict[Id, JogRoom] = Field(default={}, max_length=64, exclude_if=lambda rooms: not rooms)
    acquisition: Int53 = 0
    session: Label = ""
    reason: Sentence = ""
    ttl_ms: int = Field(ge=0, le=60_000)


class LeaseReply(Reply):
    """state: the controller's state if another holder had the axes before, which saves a query; None if nothing has
    changed. kept: axes that are being jogged, and keep another room than that of the request."""

    state: ControllerState | None = None
    kept: list[Id] = Field(default=[], exclude_if=lambda axes: not axes)


class LeasedRequest(AxesRequest):
    """A request that only the holder of the axes' leases may make."""

    holder: Label


class CheckSettingsRequest(LeasedRequest):
    """Compare all settings that motion relies on, of a controller at rest: another client may have changed one."""


class SettingsChecked(Reply):
    """state: the controller's state after the comparison, if one differs, which its faults name; None if none does."""

    state: ControllerState | None = None


class EnableRequest(LeasedRequest):
    on: bool


class HomeRequest(LeasedRequest):
    """Find the reference. The reply comes when all axes have found it or failed."""


class HomeReply(Reply):
    """Axes that are referenced now, and those that are not, with the reason."""

    homed: list[str] = Field(default=[])
    failed: dict[str, RefusalDetails] = Field(default={})


class SetPositionRequest(LeasedRequest):
    """Set the current position of the one axis of `axes` to `position` (None: remove the offset). Nothing moves."""

    position: Quantity | None


class ConfigureRequest(FencedRequest):
    """Replace the configuration (a controller of a fleet file, in its JSON form); the adapter restarts with it.

    check: only report whether it could be done.
    """

    configuration: dict[str, Any]
    check: bool = False


class JogRequest(Request):
    """Move axes at a velocity (unit/s, user's direction) for `valid_ms`; 0 stops the axis. Only from the lease's
    holder.

    seq: increases with each request of a holder; an older one that arrives late is refused. renew: continue motion that
    was requested before; an axis that has been stopped meanwhile stays stopped. groups: of virtual axes that the jog
    moves: an axis of a pair is jogged with its group only.
    """

    holder: Label
    seq: Int53
    velocities: dict[str, float] = Field(min_length=1)
    groups: list[Id] = Field(default=[], max_length=64)
    renew: bool = False
    valid_ms: int = Field(default=200, ge=20, le=200)


class OutputRequest(FencedRequest):
    output: str
    value: bool


class BeginSampling(FencedRequest):
    """Have the controller record positions of its axes by itself, for a step that is about to be armed.

    period_ns: longest time between two samples. seconds: for how long, from now.
    """

    job: Label
    step: Int53
    axes: list[str] = Field(min_length=1, max_length=64)
    period_ns: Int53 = Field(gt=0)
    seconds: float = Field(gt=0, le=86_400)


class SamplingBegun(Reply):
    """period_ns: time between two samples. fetch_ns: longest time that fetching them takes."""

    period_ns: Int53 = 0
    fetch_ns: Int53 = 0


class TakeSamples(FencedRequest):
    """Fetch what was recorded for a step; at rest. After that the controller records no more."""

    job: Label
    step: Int53


class SamplesTaken(Reply):
    """fleet_ns, bound_ns: see `recording.StepSamples`. counts: by axis."""

    fleet_ns: list[Int53] = Field(default=[])
    bound_ns: Int53 = 0
    counts: dict[str, list[Int53]] = Field(default={})


class LatchRequest(LeasedRequest):
    """Arm the latch of the one axis of `axes`, and answer when `input` has captured a position; at rest."""

    input: Id
    within_ns: Int53 = Field(gt=0)


class LatchReply(Reply):
    """The captured position, and the interval in which that was, fleet time."""

    counts: Int53 = 0
    earliest_ns: Int53 = 0
    latest_ns: Int53 = 0


class ProbeTerms(Model):
    """An axis of a probe goes to `end_counts` at `speed`, its unit/s. overtravel_counts: how far it may go behind the
    contact."""

    end_counts: Int53
    speed: float = Field(ge=0)
    overtravel_counts: float = Field(ge=0)


class ProbeRequest(LeasedRequest):
    """Move the first axis of `axes` to `end_counts` at `speed` (its unit/s), and stop it when `input` becomes active,
    or passive; without an input its limit switch `limit` does. The reply comes when it is at rest.

    by: what stops it, the controller or its adapter host. overtravel_counts: how far it may go behind the contact.
    line: the same of the further axes, by axis, which move with it on a straight line.
    """

    input: Id | None = None
    limit: Literal["forward", "reverse"] | None = None
    active: bool
    end_counts: Int53
    speed: float = Field(gt=0)
    by: Literal["controller", "host"]
    overtravel_counts: float = Field(ge=0)
    line: dict[Id, ProbeTerms] = Field(default={}, exclude_if=lambda line: not line)

    @model_validator(mode="after")
    def _lists_line(self) -> Self:
        if not self.axes or self.axes[0] in self.line or sorted(self.axes[1:]) != sorted(self.line):
            raise ValueError("`line` has the axes behind the first one of `axes`")
        return self

    @property
    def terms(self) -> dict[str, ProbeTerms]:
        """The terms of each axis."""
        first_terms = ProbeTerms(end_counts=self.end_counts, speed=self.speed, overtravel_counts=self.overtravel_counts)
        return {self.axes[0]: first_terms, **self.line}


class ProbedAxis(Model):
    """Where an axis began and stands, and between what positions it was when the input changed."""

    least_counts: float = 0.0
    most_counts: float = 0.0
    start_counts: float = 0.0
    rest_counts: float = 0.0


class ProbeReply(Reply):
    """touched: the input has changed. least_counts, most_counts: between them the axis was then; earliest_ns,
    latest_ns: when that was, fleet time. rest_counts: where it stands. released: the input has changed back since.
    line: the same of the further axes."""

    touched: bool = False
    least_counts: float = 0.0
    most_counts: float = 0.0
    earliest_ns: Int53 = 0
    latest_ns: Int53 = 0
    start_counts: float = 0.0
    rest_counts: float = 0.0
    released: bool = False
    line: dict[Id, ProbedAxis] = Field(default={}, exclude_if=lambda line: not line)

    def list_axes(self, axes: Sequence[str]) -> dict[str, ProbedAxis]:
        """What it says of each axis of its request."""
        first_axis = ProbedAxis(
            least_counts=self.least_counts,
            most_counts=self.most_counts,
            start_counts=self.start_counts,
            rest_counts=self.rest_counts,
        )
        return {axes[0]: first_axis, **self.line}


MAX_EDGES_PART = 2_000  # edges of an output in one answer: some 60 KB


class TakeTriggers(FencedRequest):
    """Fetch what the outputs with triggers did in a step; at rest, after its end. first: the number of the first edge
    of each output, from 0, of at most `limit`. moving: what they did up to now, in a step that moves; refused by
    controllers whose `ChunkTriggers` do not show it."""

    job: Label
    step: Int53
    first: Int53 = Field(default=0, ge=0)
    limit: int = Field(default=MAX_EDGES_PART, ge=1, le=MAX_EDGES_PART)
    moving: bool = False


class TriggerEdges(Model):
    """What an output with a trigger did: for each instant in turn, as far as it was reached, the interval of its edge
    at the terminal, fleet time. unknown: one more edge may have happened, of which there is no evidence."""

    earliest_ns: list[Int53] = Field(default=[])
    latest_ns: list[Int53] = Field(default=[])
    unknown: bool = False


class TriggersTaken(Reply):
    """By output. more: an output has further edges."""

    outputs: dict[Id, TriggerEdges] = Field(default={})
    more: bool = False


class RawRequest(Request):
    """A command in the make's own language. Logged; needs the leases of all axes, and `i_know`: no limit is checked."""

    holder: Label
    command: str = Field(max_length=4000)
    i_know: bool = False


class ForgetRequest(Request):
    """Forget what unusual starts have added to the bounds of the controller's starts. Nothing is sent to it."""


class RawReply(Reply):
    reply: str = ""


class EstopMessage(Model):
    """Stops every controller that receives it, and latches."""

    event: Label
    actor: Actor
    reason: Sentence = ""


class EstopReset(Model):
    """Every controller has been reset: processes that keep the latch `event` (None: any) release it."""

    event: str | None = None
    actor: str


class KeptEstop(Model):
    """The e-stop that a process keeps for adapter hosts that were not on the bus; None: none since the last reset."""

    estop: EstopLatch | None = None


class ResetRequest(Request):
    """Release the e-stop latch named `event` (`None`: whichever is latched), and clear faults that can be cleared.

    check: only report whether the conditions for it hold.
    """

    event: Label | None = None
    check: bool = False


MAX_TRACE_PART = 500  # entries of one answer: some milliseconds of the adapter's time


class TraceRequest(Request):
    """Query an adapter for bytes of the last minute on its link: those after entry number `after_entry`, and of the
    last `last_ns` (None: all that it has)."""

    after_entry: Int53 = 0
    last_ns: Int53 | None = Field(default=None, ge=0)
    limit: int = Field(default=MAX_TRACE_PART, ge=1, le=MAX_TRACE_PART)


class TracedBytes(Model):
    """Bytes that were written or read at once. number: from 1, in the order in which they were recorded. data: base64.

    at_ns: host time; bytes that another process has written are recorded afterwards, so it may be smaller than before.
    """

    number: Int53
    at_ns: HostNs
    direction: Literal["out", "in"]
    data: str


class TracePart(Model):
    """Some entries of the trace, in the order of their numbers.

    make, options: of the controller, for decoding. newest: number of the last entry that there is. lost: entries after
    that one that are not kept any more. host_ns, utc, fleet_ns: now.
    """

    make: str
    options: dict[str, Any]
    entries: list[TracedBytes]
    newest: Int53
    lost: Int53
    utc: str
    host_ns: HostNs
    fleet_ns: Int53 | None


class TraceReply(Model):
    """Bytes on a controller's link, the oldest first: (host ns, direction, bytes as latin-1 text).

    newest: number of the last entry, to continue after it. lost: entries that were not kept long enough. make, options:
    of the controller, for decoding. utc, host_ns, fleet_ns: the same instant, just after the last entry.
    """

    entries: list[tuple[HostNs, Literal["out", "in"], str]] = Field(default=[])
    newest: Int53 = 0
    lost: Int53 = 0
    make: str = ""
    options: dict[str, Any] = Field(default={})
    utc: str = ""
    host_ns: HostNs = 0
    fleet_ns: Int53 | None = None
