"""The adapter contract: what a make's package provides, and what it is given.

A make's package (found by the entry point group `tutti.adapters`) exports a `Make`. Its `Driver` speaks the
controller's language over links and knows nothing of the bus, of jobs, leases or fleet time: axes are called by
their names in the fleet file, positions are whole counts of the controller, instants are host nanoseconds.
Everything common to all makes (the bus, polling, fencing, limits, the e-stop latch) is in `adapters.controller`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from pydantic import BaseModel

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.rate import CrystalRate
from orchestrator.link.base import Link, LinkClosed, OpenLink
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import Refusal, StartWay, Term
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs, Fault, StartClass


class CannotDo(Exception):
    """The controller, or its adapter, refuses. The reason is a value; nothing has moved because of it."""

    def __init__(self, code: str, text: str, remedy: str = "") -> None:
        super().__init__(text)
        self.refusal = Refusal(code=code, text=text, remedy=remedy)


class DriverFault(Exception):
    """The controller does not do what its manual says: silence, garbage, an error that it reports."""

    def __init__(self, code: str, text: str, remedy: str, axis: str | None = None) -> None:
        super().__init__(text)
        self.fault = Fault(code=code, text=text, remedy=remedy, axis=axis)


class Restarted(LinkClosed):
    """The controller was switched off and on. Its link is given up, so that others hear of it before it is loaded
    again."""

    def __init__(self) -> None:
        super().__init__("the controller was restarted; it is connected again from the beginning")


@dataclass(frozen=True, slots=True)
class Identity:
    """What the controller says it is."""

    model: str
    firmware: str
    serial: str


@dataclass(frozen=True, slots=True)
class AxisReading:
    """One axis as the controller reports it, in its counts.

    lost: its counts may not be where the axis is any more (an encoder failed, a motor without one was off).
    """

    commanded_counts: int
    actual_counts: float
    velocity_counts_s: float
    moving: bool
    enabled: bool
    limit: Literal["none", "forward", "reverse", "both"] = "none"
    lost: bool = False


@dataclass(frozen=True, slots=True)
class Reading:
    """One poll of the whole controller. at_ns: the middle of the time in which the controller has looked. inputs and
    outputs: by number, true = electrically high / on.

    restarted: the controller has lost its volatile state since the last poll (power cycle, reset); its axes are no
    longer referenced and nothing is armed in it any more.
    """

    at_ns: int
    axes: Mapping[str, AxisReading]
    inputs: Mapping[int, bool] = field(default_factory=dict[int, bool])
    outputs: Mapping[int, bool] = field(default_factory=dict[int, bool])
    faults: Sequence[Fault] = ()
    restarted: bool = False


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What the make's adapter can do, before any job.

    orders: of profiles it can execute, 2 trapezoids and 3 jerk-limited ones. independent_axes: axes may move in
    different steps at once, and stop one without the other. stop_ns: from a stop request to the last axis at rest,
    at the most (transport and ramp from full speed).
    """

    start_classes: tuple[StartClass, ...]
    orders: tuple[Literal[2, 3], ...]
    independent_axes: bool
    costs: Costs


@dataclass(frozen=True, slots=True)
class Lowered:
    """A step's part as this controller will really execute it. Makes derive their own, with what `arm` needs.

    durations_s: by axis, from its start to its end, in host seconds. path_error_counts: largest distance to the
    plan, by axis, for axes that start together. terms: where the start lies about T0 (guaranteed), one entry a cause;
    of a member that waits for a line, the line's own window is among them (name `line`). edge: the same for the edge
    of the line that it drives, at its terminal. clock_ppm: by how much the unit's own crystal may make all of it longer
    or shorter, guaranteed. sooner: `go` can bring T0 forward. commands: what would be sent, for people.
    """

    start_class: StartClass
    durations_s: Mapping[str, float]
    path_error_counts: Mapping[str, float]
    terms: tuple[Term, ...]
    tick_ns: float
    costs: Costs
    commands: tuple[str, ...]
    edge: tuple[Term, ...] = field(default=(), kw_only=True)
    clock_ppm: float = field(default=100.0, kw_only=True)
    sooner: bool = field(default=False, kw_only=True)


@dataclass(frozen=True, slots=True)
class JogMove:
    """One axis moved by hand, in counts of the controller.

    velocity_counts_s: signed, not 0. ramp_counts_s2: for speeding up and slowing down. end_counts: where it comes to
    rest by itself at the latest (a soft limit); None: an axis without limits, or one that does not know where it is.
    """

    velocity_counts_s: float
    ramp_counts_s2: float
    end_counts: int | None


@dataclass(frozen=True, slots=True)
class Span:
    """A host instant known as an interval, ends included. seen: the controller has shown that it came; else that is
    taken from its promise, and only the end will tell. late_ns: so much later than promised was a start given."""

    earliest_ns: int
    latest_ns: int
    seen: bool = True
    late_ns: int = 0


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a started move ended. `ended` is by axis; `reason` says why it did not end as planned."""

    state: Literal["done", "stopped", "fault"]
    ended: Mapping[str, Span]
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Fired:
    """A byte that was sent at an instant. after_ns: so long after the one that was ordered. late: it would have been
    after `latest_ns`, and was not sent."""

    written_ns: int
    after_ns: int
    late: bool


class FireOrder(Protocol):
    """Bytes that will be written at an instant."""

    def cancel(self) -> bool:
        """Do not write. False when it is too late for that."""
        ...

    async def done(self) -> Fired:
        """Wait for the write."""
        ...


class Firer(Protocol):
    """Writes bytes to links at instants, better than an event loop could. late_us: how late it may be where the fleet
    file does not say it."""

    late_us: int

    def schedule(self, link: Link, data: bytes, at_ns: int, latest_ns: int) -> FireOrder:
        """Write `data` at host time `at_ns`; not at all if that could only be after `latest_ns`."""
        ...


@dataclass(frozen=True, slots=True)
class Setup:
    """What a driver is given. options: validated by the make's own model. shared: one mapping for all drivers whose
    controllers are on the same link, where the make's package keeps what they have in common."""

    controller: str
    config: Controller
    options: BaseModel
    clock: Clock
    open_link: OpenLink
    firer: Firer
    shared: dict[str, Any] = field(default_factory=dict[str, Any])


def require_how(how: StartWay, known: Sequence[StartClass], why: str) -> None:
    """Raises `CannotDo` for a start that a controller with the start classes `known` can not make, because `why`.

    Which line can be waited for or driven is the make's to check.
    """
    wanted = "line" if how.wait is not None else how.by
    if wanted != "auto" and wanted not in known:
        raise CannotDo("start-class", f"no start by {wanted}: {why}", f"ask for start class {' or '.join(known)}")


def too_quick(made_s: float, wanted_s: float, how: StartWay) -> bool:
    """Whether a move that can not be as slow as wanted ends too early: by a fiftieth, and by more than allowed."""
    return wanted_s - made_s > max(wanted_s / 50, how.early_ns / NS_PER_S)


class Driver(ABC):
    """One controller of a make.

    `poll` and `raw` may run beside any other call, and `stop` at any moment: the driver serialises its exchanges on
    the link itself, and a stop goes past them. Every call may raise `LinkClosed` and `DriverFault`; one that takes an
    answer from the controller gives up after a time of its own with a `DriverFault` of code `no-answer`.
    """

    @abstractmethod
    async def connect(self) -> Identity:
        """Open the links and bring the controller into a known state: right make, nothing armed, nobody's leftovers.

        It may be in any state: echo on, a half-typed line, another program running, a move under way. A moving
        controller is not stopped. Raises `LinkRefused`, or `DriverFault` with what a person has to do.
        """

    @abstractmethod
    async def configure(self) -> None:
        """Read back what the unit itself holds and load what it needs; raises `DriverFault` (code `config-mismatch`,
        naming item, found and wanted value) on a difference that it must not change by itself."""

    @property
    @abstractmethod
    def capabilities(self) -> Capabilities: ...

    @abstractmethod
    async def poll(self) -> Reading:
        """Read the state of all axes, inputs and outputs, as cheaply as the make allows; feeds the clock estimate.

        Raises `Restarted` where much is to be loaded again. It is met anew then, and the first reading says so.
        """

    def mapping(self) -> TickMapping | None:
        """The present clock estimate; None for a make without a readable clock."""
        return None

    def crystal(self) -> CrystalRate | None:
        """What moves have told of the crystal of a make without a readable clock; None where that is not learned."""
        return None

    @abstractmethod
    def lower(self, profiles: Mapping[str, Profile], how: StartWay, mapping: TickMapping | None) -> Lowered:
        """Turn profiles into what the controller can execute. Pure: the same arguments give the same answer.

        With `how.wait` the move starts when that input becomes active, and with `how.drive` the controller makes that
        output active at T0 (with or without axes of its own), and passive again later; only after `go`, like a start.
        Raises `CannotDo` naming the axis and what would fit, code `start-class` for a start that it can not make.
        """

    @abstractmethod
    async def arm(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        """Load the move for a start at host instant `t0_ns`, without moving; read it back where the make allows.

        A line that is waited for, or driven, must be passive when the wait begins (code `line-level`).

        Gives the stages of arming in ns (`encode`, `wire`, `verify`, …). Raises `CannotDo`; then nothing is armed.
        """

    @abstractmethod
    async def verify(self) -> None:
        """Just before the promise: still armed, still where the plan starts. Raises `CannotDo`."""

    @abstractmethod
    async def go(self, slack_ns: int = 0, sooner_ns: int = 0) -> None:
        """Open the gate: the armed move starts at its instant. Raises `CannotDo` (code `late`) when that is past.

        slack_ns: who is started by the host may be started so much later than its options promise. sooner_ns: T0 comes
        so much sooner than it was armed for, by a whole number of ticks to within a few hundredths of one; 0 where what
        was lowered is not `sooner`.
        """

    @abstractmethod
    async def disarm(self) -> None:
        """Unload; nothing starts, now or later. Idempotent, and safe in every state but motion."""

    @abstractmethod
    async def started(self) -> Mapping[str, Span]:
        """After T0: when each axis started, by the controller's own evidence.

        Raises `DriverFault` (code `not-started`, or `late`) as soon as it is known that it did not.
        """

    @abstractmethod
    async def outcome(self) -> Outcome:
        """Wait for the end of the started move. `poll` may be called meanwhile."""

    @abstractmethod
    async def stop(self, abort: bool) -> None:
        """Stop all axes and everything armed: by ramp, or as fast as the controller can.

        Returns when the order is sent; never waits for an outstanding reply, and may be called beside any other call.
        """

    async def stop_first(self) -> bool:
        """Stop a controller that may be moving before anything else is asked of it, by a link that it shares with
        others. False: it has one of its own, and the caller opens it and writes the make's `stop_bytes`.

        Raises `LinkRefused`, `LinkClosed`.
        """
        return False

    @abstractmethod
    async def enable(self, axes: Sequence[str], on: bool) -> None:
        """Switch motors. Raises `CannotDo`."""

    @abstractmethod
    async def home(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        """Find the reference of all `axes` at once by their `homing`; returns when all have come to rest.

        found: called with each axis as soon as it has found it. Gives those that have not, with the reason. None begins
        after a stop that was given since the call. Raises `CannotDo` when none was begun, `DriverFault`. A caller whose
        patience ends cancels the call and stops.
        """

    @abstractmethod
    async def jog(self, axis: str, move: JogMove) -> None:
        """Begin to move one axis, or change to `move` while it is jogging; returns when the order is taken.

        Other axes that jog go on. It runs until `stop_axes`, `stop`, `move.end_counts` or a limit switch: the caller
        keeps the time. Raises `CannotDo`; then the axis does not move by this call.
        """

    @abstractmethod
    async def stop_axes(self, axes: Sequence[str]) -> None:
        """Stop jogging axes by their ramps; others go on. Returns when the order is sent; never waits for an
        outstanding reply, and may be called beside any other call."""

    async def load_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        """Load the unit's own soft limits, (low, high) in counts by axis; None: the axis does not know where it is,
        and must not be held by them. A make without native soft limits has nothing to do.

        Raises `DriverFault` (code `config-mismatch`) when the unit does not hold them afterwards.
        """
        del limits

    @abstractmethod
    async def set_output(self, number: int, on: bool) -> None: ...

    @abstractmethod
    async def clear_faults(self) -> None:
        """After a reset by a person: clear what the controller latches (error state, stop). Raises `CannotDo`."""

    @abstractmethod
    async def raw(self, command: str) -> str:
        """Send a line in the controller's language and give its reply as text."""

    @abstractmethod
    async def close(self) -> None:
        """Close the links. Leaves the controller as it is."""


class Make(Protocol):
    """One make and model that can be driven: what the entry points of group `tutti.adapters` name."""

    @property
    def name(self) -> str: ...

    @property
    def options(self) -> type[BaseModel]:
        """The model of `options:` in the fleet file."""
        ...

    def check(self, config: Controller) -> None:
        """Offline check of a controller's part of the fleet file (motor names, input numbers, link kind).

        Raises `ValueError` that names field, found value and what is allowed.
        """
        ...

    def driver(self, setup: Setup) -> Driver: ...

    def stop_bytes(self, config: Controller) -> bytes:
        """What a guardian writes to a link of its own to stop everything, whatever was half-typed before."""
        ...
