"""What an adapter says of its controller: state, events, information, clock."""

from fractions import Fraction
from typing import Any, Literal

from pydantic import Field

from orchestrator.model.base import HostNs, Id, Int53, Model, Rational

Mode = Literal["offline", "idle", "armed", "committed", "moving", "jogging", "homing", "stopping", "fault"]
StartClass = Literal["clock", "line", "sync", "host"]
StartWish = Literal["auto", "clock", "line", "sync", "host"]


EventKind = Literal[
    "online",
    "offline",
    "fault",
    "cleared",
    "limit",
    "homed",
    "unreferenced",
    "input",
    "refusal",
    "started",
    "done",
    "failed",
    "stopped",
    "disarmed",
    "estop",
    "reset",
    "raw",
]


class Fault(Model):
    """Something that keeps a controller from working, and what to do about it."""

    code: str
    text: str
    remedy: str
    axis: str | None = None


class AxisState(Model):
    """One axis now, in its unit. Three coordinates: raw (counts of the controller), motor (raw in the axis's unit),
    user (motor plus `offset`, within one turn where the axis wraps). Jobs speak of user positions; soft limits are
    motor positions.

    position, commanded: user. moving: also while it is out of reach, unless its link broke after it was seen at rest.
    homing: it looks for its reference now.
    """

    position: float
    commanded: float
    velocity: float
    motor_position: float
    raw_counts: float
    commanded_counts: Int53
    offset: Rational = Fraction(0)
    unit: str
    moving: bool
    homing: bool = False
    enabled: bool
    referenced: bool
    limit: Literal["none", "forward", "reverse", "both"] = "none"
    fault: str | None = None


class ClockQuality(Model):
    """How well the controller's clock is known."""

    bound_ns: Int53
    age_ns: Int53
    samples: int


class EstopLatch(Model):
    """An e-stop that has not been reset. `event` names it."""

    event: str
    actor: str
    reason: str
    utc: str


class ControllerState(Model):
    """The full state of a controller: on change, at the fleet file's rates, and as heartbeat."""

    schema_: Literal["tutti.state/1"] = Field(default="tutti.state/1", alias="schema")
    controller: Id
    instance: str
    seq: Int53
    utc: str
    fleet_ns: Int53 | None
    read_fleet_ns: Int53 | None = Field(default=None, description="When the answer that it rests on had come.")
    mode: Mode
    axes: dict[str, AxisState]
    inputs: dict[str, bool]
    outputs: dict[str, bool]
    faults: list[Fault]
    clock: ClockQuality | None
    estop: EstopLatch | None
    epoch: Int53
    digest: str
    job: str | None = None
    step: int | None = None
    leases: dict[str, str] = Field(default={}, description="Who may move: holder by axis, for axes that are held.")
    event_seq: Int53 = Field(default=0, description="The last event, so that who has missed it learns of that.")


class Interval(Model):
    """An instant of fleet time that is not known better than this; the truth lies inside, ends included."""

    earliest_ns: Int53
    latest_ns: Int53


class AxisEvidence(Model):
    """When an axis really started and ended, by its controller's own evidence.

    modelled: the start where the evidence is vague, narrowed by what the member had promised; true as far as its link
    and host keep within their models, while `start` does not rest on them.
    late_ns: so much later than promised was the start given, because the host was busy; what else was promised holds.
    settled_s: from the end of the profile until it was seen in its window, for axes with `done: in_position`.
    """

    start: Interval
    late_ns: Int53 = 0
    modelled: Interval | None = None
    end: Interval | None = None
    settled_s: float | None = None

    @property
    def judged_start(self) -> Interval:
        """The start that verdicts rest on."""
        return self.modelled or self.start


class Event(Model):
    """What must not be lost. Numbered without gaps within an adapter's instance."""

    schema_: Literal["tutti.event/1"] = Field(default="tutti.event/1", alias="schema")
    controller: Id
    instance: str
    seq: Int53
    utc: str
    fleet_ns: Int53 | None
    kind: EventKind
    text: str
    job: str | None = None
    step: int | None = None
    evidence: dict[str, AxisEvidence] = Field(default={})
    fault: Fault | None = None


class EventsRequest(Model):
    """Ask an adapter for the events after `after`."""

    after: Int53


class EventsReply(Model):
    """Events still in the ring. `lost` counts those after `after` that the ring has dropped."""

    instance: str
    events: list[Event]
    lost: int


class Costs(Model):
    """What it takes to arm, disarm and stop a controller, at most, in ns.

    by_turns: arming takes no longer when others on its line are armed meanwhile, because they take turns, command by
    command; else they are armed one after another.
    """

    arm_ns: Int53
    by_turns: bool = False
    disarm_ns: Int53
    stop_ns: Int53


class Info(Model):
    """Who a controller is and what it can do."""

    controller: Id
    instance: str
    make: str
    model: str
    firmware: str
    serial: str
    axes: dict[str, dict[str, Any]]
    start_classes: list[StartClass]
    orders: list[Literal[2, 3]] = Field(description="Profiles it can execute: 2 trapezoids, 3 jerk-limited.")
    independent_axes: bool
    costs: Costs
    digest: str
    options_schema: dict[str, Any]


class ClockMapping(Model):
    """The controller's clock against its host's: host_ns = host_at_ns + (ticks - ticks_at) * tick_ns.

    bound_ns: guaranteed error at host_at_ns, which was age_ns ago when this was said; it grows with drift_ppm.
    rate_ppm: how far its tick is longer than it should be. residual_ns: mean distance of the readings. consistent: they
    all fit the model of link and crystal; else the last one stands alone.
    """

    controller: Id
    ticks_at: Int53
    host_at_ns: HostNs
    tick_ns: float
    rate_ppm: float
    residual_ns: Int53
    bound_ns: Int53
    drift_ppm: float
    age_ns: Int53
    samples: int
    min_rtt_ns: Int53
    valid_until_ns: HostNs
    consistent: bool = True


class LearnedCrystal(Model):
    """The crystal of a controller without a readable clock, from the moves that it has timed.

    rate_ppm: how much faster than its host's clock. bound_ppm: guaranteed error; error_ppm: standard deviation;
    residual_ppm: mean distance of the last measurements. consistent: the moves fit the model of link and crystal; else
    what was learned before is forgotten.
    """

    rate_ppm: float
    bound_ppm: float
    error_ppm: float
    residual_ppm: float
    moves: int
    consistent: bool = True


class ClockReply(Model):
    """How well a controller's clock is known now; no mapping: it has none that can be read, or it is not known yet."""

    controller: Id
    start_classes: list[StartClass]
    mapping: ClockMapping | None
    crystal: LearnedCrystal | None = Field(default=None, description="Of a controller without a clock to read.")
