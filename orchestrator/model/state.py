"""What an adapter publishes of its controller: state, events, information, clock."""

from collections.abc import Iterable
from fractions import Fraction
from typing import Any, Literal, Self

from pydantic import Field

from orchestrator.model.base import HostNs, Id, Int53, Label, Model, Rational
from orchestrator.model.compensation import Play
from orchestrator.model.errors import ControllerFault
from orchestrator.model.queue import Utc
from orchestrator.model.units import Unit
from orchestrator.model.version import ProtocolText

Mode = Literal["offline", "idle", "armed", "committed", "moving", "jogging", "homing", "stopping", "fault"]
RESTING_MODES: tuple[Mode, ...] = ("offline", "idle", "fault")
"""Modes in which a controller does not move, and is not about to."""
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
    "setting",
]


class FaultReport(Model):
    """A condition that keeps a controller from working, and the remedy."""

    code: str
    text: str
    remedy: str
    axis: str | None = None

    @classmethod
    def of(cls, error: ControllerFault) -> Self:
        """The report of `error`."""
        return cls(code=error.code, text=error.text, remedy=error.remedy, axis=error.axis)


class PairState(Model):
    """The two motors of one axis, in its unit. motors: the positions by the make's names, motor positions. deviation:
    the second one minus the first one; 0 where the beam is square."""

    motors: dict[str, float]
    deviation: float


class AxisState(Model):
    """One axis now, in its unit. Three coordinates: raw (counts of the controller), motor (raw in the axis's unit,
    with its play and its table of errors), user (motor plus `offset`, within one turn where the axis wraps). Jobs use
    user positions; soft limits are motor positions.

    position, commanded: user. moving: also while it is offline, unless it was seen at rest before its link broke.
    homing: it is searching for its reference.
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
    play: Play | None = Field(
        default=None,
        exclude_if=lambda play: play is None,
        description="By how many counts the axis is ahead of its motor; left out for one without `backlash`.",
    )
    pair: PairState | None = Field(
        default=None,
        exclude_if=lambda pair: pair is None,
        description="Its two motors, of which the first one is the position; left out for an axis of one motor.",
    )

    @property
    def axis_counts(self) -> int | Fraction:
        """The commanded counts with the middle of the play: those of the axis, not of its motor."""
        return self.commanded_counts if self.play is None else self.commanded_counts + self.play.middle


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

    def describe(self) -> str:
        """What has sent it, and why."""
        return f"e-stop by {self.actor}: {self.reason}" if self.reason else f"e-stop by {self.actor}"


class TimeInterval(Model):
    """An instant of fleet time that is known only as an interval; the true instant is inside, ends included."""

    earliest_ns: Int53
    latest_ns: Int53


class ReadPosition(Model):
    """A position of an axis as it was read. position: of the user, in `unit`; read: the interval in which the axis was
    there, fleet time."""

    position: float
    unit: Unit
    read: TimeInterval


class ControllerState(Model):
    """The full state of a controller: published on change, at the fleet file's rates, and as heartbeat."""

    schema_: Literal["tutti.state/1"] = Field(default="tutti.state/1", alias="schema")
    controller: Id
    instance: str
    seq: Int53
    utc: str
    fleet_ns: Int53 | None
    read_fleet_ns: Int53 | None = Field(default=None, description="The middle of the poll, or when what it shows came.")
    read_within: TimeInterval | None = Field(
        default=None,
        description="The interval in which the positions were sampled, guaranteed; None: of an adapter before 0.5, or "
        "while it has no fleet time, or is offline.",
    )
    mode: Mode
    axes: dict[str, AxisState]
    inputs: dict[str, bool]
    outputs: dict[str, bool]
    faults: list[FaultReport]
    clock: ClockQuality | None
    estop: EstopLatch | None
    epoch: Int53
    digest: str
    job: str | None = None
    step: int | None = None
    leases: dict[str, str] = Field(default={}, description="Holders by axis, for axes that are leased.")
    event_seq: Int53 = Field(
        default=0, description="The last event's number, so that a reader that missed it can query it."
    )

    def is_older_than(self, other: "ControllerState") -> bool:
        """Whether the same start of the adapter has made `other` after this one."""
        own_mark, other_mark = (self.seq, self.fleet_ns or 0), (other.seq, other.fleet_ns or 0)
        return self.instance == other.instance and own_mark < other_mark


class AxisEvidence(Model):
    """When an axis started and ended, by its controller's own evidence.

    modelled: the start where the evidence is vague, narrowed by the member's promise; valid while its link and host
    stay within their models, on which `start` does not depend.
    late_ns: how much later than promised the start was given, because the host was busy; the rest of the promise held.
    settled_s: from the end of the profile until the axis was in its window, for axes with `done: in_position`.
    """

    start: TimeInterval
    late_ns: Int53 = 0
    modelled: TimeInterval | None = None
    end: TimeInterval | None = None
    settled_s: float | None = None

    @property
    def start_for_verdict(self) -> TimeInterval:
        """The start interval that the verdict uses."""
        return self.modelled or self.start


class ControllerEvent(Model):
    """An event that must not be lost. Numbered without gaps within an adapter's instance."""

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
    positions: dict[str, ReadPosition] = Field(
        default={}, description="With `done`: of the axes of the step, read at rest behind it; empty: not read there."
    )
    fault: FaultReport | None = None


class EventsRequest(Model):
    """Query an adapter for the events after number `after`."""

    after: Int53


class EventsReply(Model):
    """Events still in the ring. lost: number of those after `after` that the ring has dropped."""

    instance: str
    events: list[ControllerEvent]
    lost: int


class StepCosts(Model):
    """Maximum times to arm, disarm and stop a controller, in ns.

    interleaved: arming takes no longer when other controllers on its line are armed at the same time, because they
    alternate command by command; otherwise they are armed one after another.
    """

    arm_ns: Int53
    interleaved: bool = False
    disarm_ns: Int53
    stop_ns: Int53

    def find_stop_lead_s(self, ramps_s: Iterable[float]) -> float:
        """How long it takes at most from a request to stop until the ramps begin, s. ramps_s: of its axes, from full
        speed; what the time of a stop has beyond the longest one is the way to the controller."""
        return max(0.0, self.stop_ns / 1e9 - max(ramps_s))


class CertificateEnd(Model):
    """The certificate of a session: the common name, e.g. `host-lab3.2`, and when it ends."""

    name: Label
    ends_utc: Utc


RetargetWay = Literal["brake", "stream", "extend"]
"""How a moving axis gets another target. `brake`: it brakes by its plan, and starts again from there. `stream`: its
positions continue to the new target from where they are. `extend`: its controller moves farther in the same direction,
at the speed that it has reached; in the other direction, and once it brakes, it is as `brake`."""


class RetargetAbility(Model):
    """How the axes of a controller get other targets while they move. within_s: the most time from a request until
    their set-points change."""

    way: RetargetWay
    within_s: float


class ChunkTriggers(Model):
    """How a controller takes triggers with the chunks of a path. most: instants of a chunk, of all its outputs.
    load_ns: by how much an instant makes loading a chunk longer. How close they may be depends on pulse and path: it
    is in the proposal. shows: what it has switched can be fetched while it moves."""

    most: int
    load_ns: Int53 = 0
    shows: bool = False


INPUT_S = 0.02
"""How much later than its terminal an input of any make is read at most: optocouplers and filters."""
HOST_RAMP_SHARE = 0.75
"""Of the acceleration that a move or a jog has, what its ramp has at least when a computer stops it."""
PROBE_BY_HOST = "let its computer stop it (`by: host`), which has a longer overtravel"
"""What to do where a controller does not stop an axis by an input."""


class ProbeAbility(Model):
    """How far an axis goes on at most when an input of its controller stops it, and how well the position at that is
    known. Speeds in counts/s, ramps in counts/s²; the axis is stopped by its whole acceleration.

    inputs: by axis, the numbers of the inputs that can stop it. levels: what such an input may become.
    reaction_s: at the speed of the probe, until the ramp is in effect. ramp_share: the ramp is at least this share of
    the acceleration. margin_counts: beyond that. contact_s, contact_counts: the axis was at most the way of that time,
    and these counts, before the position that is captured. slower: what stops axes by further inputs, or at other
    levels of these. line_s, line_counts: an axis is off its line by at most the way of that time, and these counts.
    """

    inputs: dict[Id, list[int]]
    levels: list[Literal["active", "passive"]]
    reaction_s: float
    ramp_share: float = 1.0
    margin_counts: float
    contact_s: float
    contact_counts: float
    line_s: float = Field(default=0.0, exclude_if=lambda time_s: not time_s)
    line_counts: float = Field(default=0.0, exclude_if=lambda counts: not counts)
    slower: Self | None = Field(default=None, exclude_if=lambda ability: ability is None)

    def find_way(self, axis: str, number: int, level: Literal["active", "passive"]) -> Self | None:
        """What stops an axis when an input becomes `level`; None: nothing does."""
        if number in self.inputs.get(axis, ()) and level in self.levels:
            return self
        return None if self.slower is None else self.slower.find_way(axis, number, level)

    def find_overtravel(self, speed: float, ramp: float) -> float:
        """How far the axis goes behind the contact at most, in counts."""
        return speed * (self.reaction_s + self.contact_s) + speed**2 / (2 * ramp * self.ramp_share) + self.margin_counts

    def find_off_line(self, speed: float) -> float:
        """How far an axis of a line is off it at most, in counts; 0 for one that moves alone."""
        return speed * self.line_s + self.line_counts


class ControllerInfo(Model):
    """Identity and capabilities of a controller."""

    controller: Id
    instance: str
    make: str
    model: str
    firmware: str
    serial: str
    axes: dict[str, dict[str, Any]]
    start_classes: list[StartClass]
    orders: list[Literal[2, 3]] = Field(description="Profile orders it can execute: 2 trapezoidal, 3 jerk-limited.")
    independent_axes: bool
    costs: StepCosts
    chunk_s: float = Field(
        default=0.0, description="Longest chunk of a path that it loads while it moves, s; 0: a path is loaded whole."
    )
    chunk_load_s: float = Field(default=0.0, description="How long loading it takes at most, s.")
    chunk_triggers: ChunkTriggers | None = Field(
        default=None,
        exclude_if=lambda ability: ability is None,
        description="How it takes triggers with the chunks of a path; left out: a path with triggers is loaded whole.",
    )
    retarget: RetargetAbility | None = Field(
        default=None,
        exclude_if=lambda ability: ability is None,
        description="How its axes get other targets while they move; left out: they brake, and start again.",
    )
    probe: ProbeAbility | None = Field(
        default=None,
        exclude_if=lambda ability: ability is None,
        description="How it stops an axis by an input; left out: it does not.",
    )
    limit_probe: ProbeAbility | None = Field(
        default=None,
        exclude_if=lambda ability: ability is None,
        description="How a limit switch stops its axis, for probes; left out: the make does not state it.",
    )
    line_probe: ProbeAbility | None = Field(
        default=None,
        exclude_if=lambda ability: ability is None,
        description="How it stops several axes on a straight line by an input; left out: it does not.",
    )
    host_probe: ProbeAbility | None = Field(
        default=None,
        exclude_if=lambda ability: ability is None,
        description="How its host stops an axis by an input; left out: its axes cannot be jogged.",
    )
    alone_s: float | None = Field(
        default=None,
        exclude_if=lambda time_s: time_s is None,
        description="How long its axes go on in a step without its adapter, until its own watchdog stops them, s; left "
        "out: to the end of the step.",
    )
    jog_ramps: bool = Field(
        default=False,
        exclude_if=lambda is_able: not is_able,
        description="Whether an axis that is jogged gets another speed without coming to rest; left out: it rests.",
    )
    shows_inputs: bool = Field(
        default=False,
        exclude_if=lambda is_able: not is_able,
        description="Whether its states show the inputs as they are also while a step moves its axes; left out: at "
        "rest only.",
    )
    digest: str
    options_schema: dict[str, Any]
    tutti: Label = Field(default="", description="Version of Tutti of its adapter host.")
    protocol: ProtocolText = Field(default="", description="Version of the messages that it understands, major.minor.")
    certificate: CertificateEnd | None = Field(
        default=None,
        exclude_if=lambda certificate: certificate is None,
        description="That of its adapter host's session; left out where it has none.",
    )

    @property
    def retarget_ability(self) -> RetargetAbility:
        """How its axes get other targets while they move. Where it states nothing, they brake: by the longest time of a
        stop they stand."""
        return self.retarget or RetargetAbility(way="brake", within_s=self.costs.stop_ns / 1e9)


class ClockMapping(Model):
    """The controller's clock against its host's: host_ns = host_at_ns + (ticks - ticks_at) * tick_ns.

    bound_ns: guaranteed error at host_at_ns, which was age_ns before this message; it grows with drift_ppm.
    rate_ppm: how much longer its tick is than nominal. residual_ns: mean distance of the readings from the fit.
    consistent: all readings fit the model of link and crystal; otherwise only the last one is used.
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


class LinkTotals(Model):
    """Bytes on a controller's link since its adapter host has started, on `ctl/{id}/link`.

    Controllers on one serial line share them.
    """

    schema_: Literal["tutti.link/1"] = Field(default="tutti.link/1", alias="schema")
    controller: Id
    bytes_out: Int53
    bytes_in: Int53


class LearnedCrystal(Model):
    """The crystal of a controller without a readable clock, estimated from the moves that it has timed.

    rate_ppm: how much faster than its host's clock. bound_ppm: guaranteed error; error_ppm: standard deviation;
    residual_ppm: mean distance of the last measurements. consistent: the moves fit the model of link and crystal;
    otherwise earlier measurements are discarded.
    """

    rate_ppm: float
    bound_ppm: float
    error_ppm: float
    residual_ppm: float
    moves: int
    consistent: bool = True


class LearnedStart(Model):
    """A start outside the declared bounds, which widens them for a while.

    outside_ns: by how much it was certainly late; negative: early. age_ns: since then. remaining_ns: what is left.
    job, step: of the start, the index of the step from 0; empty and None if the adapter does not know it any more.
    """

    outside_ns: Int53
    age_ns: Int53
    remaining_ns: Int53
    job: str = Field(default="", max_length=64)
    step: Int53 | None = None


class ClockReply(Model):
    """How well a controller's clock is known now. No mapping: it has no readable clock, or the mapping is not known
    yet."""

    controller: Id
    start_classes: list[StartClass]
    mapping: ClockMapping | None
    crystal: LearnedCrystal | None = Field(default=None, description="For a controller without a readable clock.")
    unusual_starts: list[LearnedStart] = Field(
        default=[], description="Starts outside the declared bounds; from the second one on they widen the bounds."
    )
    widened_ns: Int53 = Field(default=0, description="By how much they widen the bounds of a start now.")
