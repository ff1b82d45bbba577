"""The adapter contract: what a make's package provides, and what it receives.

A make's package exports a `Make`, found by the entry point group `tutti.adapters`. Its `Driver` speaks the controller's
language over links. A driver is independent of the bus, of jobs, of leases and of fleet time.

Units throughout: axes are identified by their names in the fleet file; positions are whole counts of the controller;
instants are host nanoseconds (`Clock.now_ns`); durations carry their unit in their name (`_ns`, `_s`).

Errors: `Refusal` means that a request was declined and nothing moved because of it. `ControllerFault` means that the
controller misbehaves. `LinkClosed` and `LinkRefused` mean that the connection is lost or cannot be opened.

Everything common to all makes (the bus, polling, fencing, limits, the e-stop latch) is in `adapters.controller`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, NamedTuple, Protocol, TypeVar

from pydantic import BaseModel, ValidationError

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import Link, LinkClosed, OpenLink
from orchestrator.link.timed_write import WriteResult
from orchestrator.model.errors import SETTING_CHANGED, ControllerFault, Refusal, TuttiError
from orchestrator.model.explain import list_problems
from orchestrator.model.fleet import Controller, DigitalInput
from orchestrator.model.messages import BudgetTerm, StartOptions, sum_terms
from orchestrator.model.profile import Profile
from orchestrator.model.state import ChunkTriggers, FaultReport, RetargetAbility, RetargetWay, StartClass, StepCosts


class ControllerRestarted(LinkClosed):
    """The controller was power-cycled or reset. The driver gives up the link, so that the loss is published before the
    controller is loaded again."""

    def __init__(self) -> None:
        super().__init__("the controller was restarted; the connection is set up again from the beginning")


@dataclass(frozen=True, slots=True)
class ControllerIdentity:
    """Model, firmware and serial number as the controller reports them."""

    model: str
    firmware: str
    serial: str


class SecondMotor(NamedTuple):
    """The second motor of an axis. actual_counts: as those of the first one; the difference is the deviation. limit:
    its own switches, which `AxisReading.limit` has too."""

    actual_counts: float
    limit: Literal["none", "forward", "reverse", "both"] = "none"


@dataclass(frozen=True, slots=True)
class AxisReading:
    """One axis as the controller reports it, in its counts. Of an axis of two motors these are those of the first one;
    it moves, loses its position or is at a limit if one of them is, and is enabled if both are.

    limit_inferred: the controller does not report its switches; that one is active is concluded from a motion that has
    ended too early, and only the next motion can show whether it still is. position_lost: the counts may no longer
    match the position of the axis (an encoder failed, or a motor without an encoder was off).
    """

    commanded_counts: int
    actual_counts: float
    velocity_counts_s: float
    moving: bool
    enabled: bool
    limit: Literal["none", "forward", "reverse", "both"] = "none"
    limit_inferred: bool = False
    position_lost: bool = False
    second: SecondMotor | None = None


@dataclass(frozen=True, slots=True)
class ControllerReading:
    """One poll of the whole controller.

    at_ns: the middle of the interval in which the controller sampled its state.
    sampled: the interval in which it sampled the positions of all axes, guaranteed; None: during the call of
    `Driver.poll` that returns this. A driver states it where that is wrong (a position that came unsolicited, or that
    was asked for before), or needlessly wide (the call waits for its turn on a line).
    inputs, outputs: by number; true = electrically high / on.
    restarted: the controller has lost its volatile state since the last poll (power cycle, reset); its axes are no
    longer referenced and nothing is armed in it.
    """

    at_ns: int
    axes: Mapping[str, AxisReading]
    inputs: Mapping[int, bool] = field(default_factory=dict[int, bool])
    outputs: Mapping[int, bool] = field(default_factory=dict[int, bool])
    faults: Sequence[FaultReport] = ()
    restarted: bool = False
    sampled: "HostInterval | None" = None


@dataclass(frozen=True, slots=True)
class SettingDifference:
    """A value that motion relies on, and that the controller no longer holds: another client has changed it.

    item: the setting in the controller's own words (`IT of axis x`). found, expected: as the controller writes them.
    axis: its name in the fleet file; None: the whole controller.
    moves_reference: counts no longer stand for the positions that they stood for; the axis must be homed again.
    repairable: `Driver.clear_faults` writes the expected value again. Otherwise `remedy` says what a person must do.
    """

    item: str
    found: str
    expected: str
    axis: str | None = None
    moves_reference: bool = False
    repairable: bool = True
    remedy: str = ""

    def to_fault(self) -> FaultReport:
        """The fault that keeps the controller from moving until the setting is as expected."""
        remedy = "`tutti reset` writes it again; find out which client changed it" if self.repairable else self.remedy
        if self.moves_reference:
            remedy += "; then home again"
        text = f"{self.item} is {self.found}, expected {self.expected}: another client has changed it"
        return FaultReport(code=SETTING_CHANGED, text=text, remedy=remedy, axis=self.axis)

    def to_refusal(self) -> Refusal:
        """The refusal of a step that relies on the setting."""
        fault = self.to_fault()
        return Refusal(fault.code, fault.text, fault.remedy)


@dataclass(frozen=True, slots=True)
class DriverCapabilities:
    """What the make's adapter supports, fixed before any job.

    orders: orders of profiles that it can execute: 2 for trapezoids, 3 for jerk-limited profiles.
    independent_axes: axes may move in different steps at the same time, and one can stop without the other.
    checks_while_moving: `check_settings` may be called while an axis moves.
    compares_when_loading: loading a move compares the settings that motion relies on, and refuses it if one differs.
    chunk_s: the longest chunk of a path that it can load while it executes the one before, s; 0: a path is loaded as a
    whole. chunk_load_s: how long loading it takes at most. chunk_triggers: how it takes triggers with chunks; None: a
    path with triggers is loaded as a whole.
    retarget_s: the most time from a request for another target on the way until the set-points change; 0: its axes
    brake, and start again. retarget_way: how they continue.
    jog_ramps: an axis that is jogged gets another speed without coming to rest.
    shows_inputs: each reading shows the inputs as they are, also while a step moves axes.
    alone_s: how long its axes go on in a step at most without a message of the adapter, until the controller's own
    watchdog begins to stop them; None: to the end of the step.
    costs: upper bounds in ns for the operations of a step; `costs.stop_ns` is the time from a stop request until the
    last axis is at rest (transport, and the ramp from full speed).
    """

    start_classes: tuple[StartClass, ...]
    orders: tuple[Literal[2, 3], ...]
    independent_axes: bool
    costs: StepCosts
    checks_while_moving: bool = False
    compares_when_loading: bool = False
    chunk_s: float = 0.0
    chunk_load_s: float = 0.0
    chunk_triggers: ChunkTriggers | None = None
    retarget_s: float = 0.0
    retarget_way: RetargetWay = "stream"
    jog_ramps: bool = False
    shows_inputs: bool = False
    alone_s: float | None = None

    @property
    def retarget(self) -> RetargetAbility | None:
        """How axes get other targets on the way; None: they brake, and start again."""
        return RetargetAbility(way=self.retarget_way, within_s=self.retarget_s) if self.retarget_s else None


class ChunkInstants(NamedTuple):
    """Instants of an output, ns after T0, that come behind the `first` ones of the motion, in the place of those that
    were loaded there."""

    first: int
    instants_ns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class PathChunk:
    """A chunk of a path, in seconds after its T0: profiles from `begin_s`, along the path to `end_s`, then to rest.

    Up to `end_s` of the chunk before, which is later than `begin_s`, both are the same motion: the controller changes
    over at an instant of its own in between. last: it ends at the end of the path. profiles: by axis; none of a
    controller that only switches outputs. triggers: by output, its instants up to `end_s`.
    """

    number: int
    begin_s: float
    end_s: float
    last: bool
    profiles: Mapping[str, Profile]
    triggers: Mapping[str, ChunkInstants] = field(default_factory=dict[str, ChunkInstants])

    @property
    def stop_s(self) -> float:
        """When it is at rest; without axes, when it has nothing to switch any more."""
        durations_s = [profile.duration_s for profile in self.profiles.values()]
        return self.begin_s + max(durations_s, default=self.end_s - self.begin_s)


@dataclass(frozen=True, slots=True)
class ChunkFit:
    """How a chunk fits to the controller's clock.

    drift_ns: how far the clock had drifted from the plan at its beginning; it is corrected on the way. left_ns: what of
    that remains at its end. bound_ns: guaranteed error of the clock mapping. path_error_counts: by axis. stop_s: when
    it is at rest, from T0. triggers: as of a lowered move, for the instants of the chunk.
    """

    stop_s: float
    drift_ns: int
    left_ns: int
    bound_ns: int
    path_error_counts: Mapping[str, float]
    triggers: Mapping[str, tuple[BudgetTerm, ...]] = field(default_factory=dict[str, tuple[BudgetTerm, ...]])


@dataclass(frozen=True, slots=True)
class Lowered:
    """A controller's part of a step as the controller will execute it. Makes derive their own class, with what
    loading it needs.

    durations_s: by axis, from its start to its end, in host seconds.
    path_error_counts: by axis, the largest distance to the plan, for axes that start together.
    terms: guaranteed interval of the start relative to T0, one entry per cause; for a participant that waits for a
    trigger line, the window of that line is one of them (name `line`).
    edge: the same for the edge of the trigger line that the controller drives, at its terminal.
    clock_ppm: guaranteed bound by which the controller's own crystal may stretch or shorten all durations.
    can_advance: its release can move T0 to an earlier instant.
    gap_ns: with `start.follows`, how long after the end of the present move, at the latest, the controller can begin
    this one if it is loaded beside it, in the following slot; None: it cannot be loaded then.
    line_members: how many controllers share its line, whose loads take turns.
    release_ns: how long before T0 the release must be called at the latest, where no other controller depends on this
    start, so that nothing need be withdrawn in time; None: the move cannot start at once. With `start.at_once`, such a
    move can advance.
    commands: the commands that would be sent, for display.
    triggers: by output that the controller switches on the way (`start.triggers`), the guaranteed interval of an edge
    at its terminal relative to the instant asked for, one entry per cause. trigger_least_ns: by output, the shortest
    time from one instant to the next.
    """

    start_class: StartClass
    durations_s: Mapping[str, float]
    path_error_counts: Mapping[str, float]
    terms: tuple[BudgetTerm, ...]
    tick_ns: float
    costs: StepCosts
    commands: tuple[str, ...]
    edge: tuple[BudgetTerm, ...] = field(default=(), kw_only=True)
    clock_ppm: float = field(default=100.0, kw_only=True)
    can_advance: bool = field(default=False, kw_only=True)
    gap_ns: int | None = field(default=None, kw_only=True)
    line_members: int = field(default=1, kw_only=True)
    release_ns: int | None = field(default=None, kw_only=True)
    triggers: Mapping[str, tuple[BudgetTerm, ...]] = field(
        default_factory=dict[str, tuple[BudgetTerm, ...]], kw_only=True
    )
    trigger_least_ns: Mapping[str, int] = field(default_factory=dict[str, int], kw_only=True)

    @property
    def window_ns(self) -> tuple[int, int]:
        """The interval of the start relative to T0, from all terms together."""
        return sum_terms(self.terms)

    @property
    def edge_window_ns(self) -> tuple[int, int]:
        """The same for the edge of the trigger line that the controller drives."""
        return sum_terms(self.edge)


@dataclass(frozen=True, slots=True)
class JogMove:
    """A jog of one axis, in counts of the controller.

    velocity_counts_s: signed, not 0.
    ramp_counts_s2: acceleration and deceleration.
    end_counts: the position at which the axis comes to rest by itself at the latest (a soft limit); None for an axis
    without limits or with an unknown position.
    """

    velocity_counts_s: float
    ramp_counts_s2: float
    end_counts: int | None


@dataclass(frozen=True, slots=True)
class HostInterval:
    """A host instant known as an interval, ends included.

    seen: the controller has reported the event; otherwise the interval is inferred from the guarantees, and only the
    end of the move confirms it.
    late_ns: delay of a start command beyond the guaranteed interval."""

    earliest_ns: int
    latest_ns: int
    seen: bool = True
    late_ns: int = 0


@dataclass(frozen=True, slots=True)
class MoveOutcome:
    """How a started move ended. `ended` is by axis; `reason` states why the move did not end as planned.

    misplaced: axes that nothing has stopped and that are not at their targets, in words: their counts may be those of
    another client, and they must be homed again."""

    state: Literal["done", "stopped", "fault"]
    ended: Mapping[str, HostInterval]
    reason: str = ""
    misplaced: Mapping[str, str] = field(default_factory=dict[str, str])


@dataclass(frozen=True, slots=True)
class SwitchedOutput:
    """What an output with a trigger did in the last step: for each instant in turn, as far as it was reached, the
    interval of its edge at the terminal. unknown: one more may have happened."""

    edges: Sequence[HostInterval]
    unknown: bool = False


@dataclass(frozen=True, slots=True)
class LatchedPosition:
    """A position that the controller has captured by an input, and the interval in which that happened."""

    counts: int
    span: HostInterval


@dataclass(frozen=True, slots=True)
class LimitMove:
    """A move of one axis that something stops, in counts of the controller: its limit switch, unless this is a
    `ProbeMove`.

    end_counts: where the axis comes to rest without that. ramp_counts_s2: of its acceleration and of each of its stops.
    """

    end_counts: int
    speed_counts_s: float
    ramp_counts_s2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeMove(LimitMove):
    """A move of one axis that an input stops. point, active: the input, and what it becomes."""

    point: DigitalInput
    active: bool

    @property
    def level(self) -> bool:
        """The level of the input at the contact: whether it is high."""
        return self.active == (self.point.active == "high")


@dataclass(frozen=True, slots=True)
class ProbedContact:
    """The change of the input: between which positions the axis was then (counts, least first), and when."""

    least: float
    most: float
    span: HostInterval


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """What a controller will record: the time between two samples of a moving axis, and how long fetching them takes at
    most."""

    period_ns: int
    fetch_ns: int


@dataclass(frozen=True, slots=True)
class SampledPositions:
    """Positions that a controller has recorded by itself.

    at_ns: host instants of the samples, each within ± bound_ns, guaranteed. counts: by axis, one for each instant.
    """

    at_ns: Sequence[int]
    bound_ns: int
    counts: Mapping[str, Sequence[int]]


class TimedWrite(Protocol):
    """Bytes that are scheduled for an instant."""

    def cancel_write(self) -> bool:
        """Cancel the write. Return False when it is too late for that."""
        ...

    async def wait_until_written(self) -> WriteResult:
        """Wait for the write and return its result."""
        ...


class TimedWriter(Protocol):
    """Write bytes to links at given instants, more accurately than an event loop can.

    max_delay_us: the largest delay in µs to assume where the fleet file does not state one."""

    max_delay_us: int

    def schedule_write(self, link: Link, data: bytes, at_ns: int, latest_ns: int) -> TimedWrite:
        """Write `data` at host time `at_ns`; skip the write if it can only happen after `latest_ns`."""
        ...


class DriverLog(Protocol):
    """The log of one driver. The controller and the epoch of the leader are added to every line."""

    def info(self, text: str, **fields: Any) -> None:
        """Log an event that is a part of normal operation."""
        ...

    def warning(self, text: str, **fields: Any) -> None:
        """Log an event that an operator should know: lost replies, garbled lines, values that do not read back."""
        ...


class _NullLog:
    """A log that discards its lines."""

    def info(self, text: str, **fields: Any) -> None:
        del text, fields

    def warning(self, text: str, **fields: Any) -> None:
        del text, fields


NULL_LOG: DriverLog = _NullLog()


@dataclass(frozen=True, slots=True)
class DriverSetup:
    """What a driver receives when it is created.

    options: validated by the make's own model.
    shared: one mapping for all drivers whose controllers are on the same link; the make's package keeps their common
    state in it.
    log: for reconnects, repeated exchanges, values that do not read back and refusals; not for every poll."""

    controller: str
    config: Controller
    options: BaseModel
    clock: Clock
    open_link: OpenLink
    timed_writer: TimedWriter
    shared: dict[str, Any] = field(default_factory=dict[str, Any])
    log: DriverLog = NULL_LOG


def require_start_class(start: StartOptions, known: Sequence[StartClass], why: str) -> None:
    """Raise `Refusal` for a start that a controller with the start classes `known` cannot make, because of `why`.

    The make itself checks which trigger lines it can wait for or drive.
    """
    start_class = "line" if start.wait is not None else start.start_class
    if start_class != "auto" and start_class not in known:
        raise Refusal("start-class", f"no start by {start_class}: {why}", f"request start class {' or '.join(known)}")


def require_triggers(lowered: Lowered, start: StartOptions) -> None:
    """Raise `Refusal` for a trigger that the make has not taken into the lowered step."""
    for trigger in start.triggers:
        if trigger.output not in lowered.triggers:
            raise Refusal(
                "no-triggers",
                f"output {trigger.output}: this make has no triggers on the way",
                "use an output of an SMC-4000, of an SMC-2000 with a port of its own, or of a CiA 402 drive whose axis "
                "has a limit of `jerk`; or an SHRC-203's trigger output",
            )


def ends_too_early(made_s: float, wanted_s: float, start: StartOptions) -> bool:
    """Return whether a move that cannot be as slow as requested ends too early: by more than a fiftieth of its
    duration, and by more than `start.early_ns`."""
    return wanted_s - made_s > max(wanted_s / 50, start.early_ns / NS_PER_S)


LoadPlace = Literal["at rest", "behind", "at once", "beside"]
"""When a move is loaded. `at rest`: the axes rest. `behind`: right behind a move that has just ended as planned, at the
positions where this one starts; in no more than the time that `Lowered.costs` states for a move that follows. `at
once`: the same, and the release follows without a `verify`: what that would check is checked by loading. `beside`:
while the present move is released or moves."""


class SlotMover(Protocol):
    """What a make does with the move of one slot. `MoveSlot` calls it, and keeps the state."""

    async def load(
        self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None, place: LoadPlace
    ) -> Mapping[str, int]:
        """Load a move for a start at host instant `t0_ns`, without moving; read it back where the make allows.

        A trigger line that is waited for or driven must be passive when the wait begins (code `line-level`). `beside`:
        the controller starts the move only after its release, and only if the present move has then ended at its target
        on every axis of both moves.

        Returns the stages of loading in ns (`encode`, `wire`, `verify`, …). Raises `Refusal`; then nothing is loaded.
        """
        ...

    async def verify(self) -> None:
        """Check immediately before the commit that the move is still loaded, and for the present move that the axes
        still are where it starts. Raises `Refusal`."""
        ...

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Release the loaded move: it starts at its instant. Raises `Refusal` (code `late`) when that instant has
        passed.

        start_tolerance_ns: a move that the host starts may start this much later than the options guarantee.
        advance_ns: T0 is this much earlier than the T0 of `load`: a whole number of ticks to within a few hundredths of
        a tick; 0 unless the lowered move has `can_advance`.
        """
        ...

    async def unload(self) -> None:
        """Unload the move; nothing starts, now or later. Idempotent, and safe in every state except in motion.

        A move beside the present one is unloaded alone, and the present one continues. With the present one, a move
        beside it is unloaded too.
        """
        ...

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return, after T0, the instant at which each axis started, by the controller's own evidence.

        Raises `ControllerFault` (code `not-started` or `late`) as soon as it is certain that an axis did not start.
        """
        ...

    async def wait_for_end(self) -> MoveOutcome:
        """Wait for the end of the started move and return its outcome. `poll` may be called meanwhile."""
        ...


class SlotState(Enum):
    """How far the move of a slot has come.

    VERIFIED: checked for the commit. RELEASED: it starts at its instant, and may have started. MOVING: its start is
    proven. ENDED: its end is, or that it did not start.
    """

    EMPTY = "empty"
    LOADED = "loaded"
    VERIFIED = "verified"
    RELEASED = "released"
    MOVING = "moving"
    ENDED = "ended"


class MoveSlot:
    """A place for one move in a controller. Each method calls that of its `SlotMover`, whose docstring states what it
    does, and moves the state on.

    A slot can be loaded in every state: the make refuses that while a move is in progress. The state does not follow
    what happens to the controller without a call of the slot: see `MoveSlots.drop`.
    """

    def __init__(self, mover: SlotMover) -> None:
        self._mover = mover
        self._state = SlotState.EMPTY
        self._loads = 0
        """Counts loaded moves, so that the end of an earlier one does not change the state of a later one."""

    @property
    def state(self) -> SlotState:
        """How far its move has come."""
        return self._state

    async def load(
        self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None, place: LoadPlace = "at rest"
    ) -> Mapping[str, int]:
        """Load a move: LOADED. Raises `Refusal`; then it is EMPTY, unless a move is in progress in it."""
        try:
            stages = await self._mover.load(lowered, t0_ns, mapping, place)
        except BaseException:
            if self._state not in (SlotState.RELEASED, SlotState.MOVING):
                self._state = SlotState.EMPTY
            raise
        self._loads += 1
        self._state = SlotState.LOADED
        return stages

    async def verify(self) -> None:
        """Check the loaded move: VERIFIED. Raises `Refusal` (code `not-armed` for an empty slot)."""
        self._require_move()
        loads = self._loads
        await self._mover.verify()
        if self._state is SlotState.LOADED:
            self._change(loads, SlotState.VERIFIED)

    async def release(self, start_tolerance_ns: int = 0, advance_ns: int = 0) -> None:
        """Release the move: RELEASED from the beginning of the call on, whatever its result: it may have started, until
        it is unloaded. The caller verifies it before. Raises `Refusal` (code `not-armed` for an empty slot)."""
        self._require_move()
        self._state = SlotState.RELEASED
        await self._mover.release(start_tolerance_ns, advance_ns)

    async def unload(self) -> None:
        """Unload the move: EMPTY."""
        self.clear()
        await self._mover.unload()

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Wait for the start: MOVING. Raises `ControllerFault`, `Refusal` (code `not-armed` for an empty slot)."""
        self._require_move()
        loads = self._loads
        try:
            start_spans = await self._mover.wait_for_start()
        except (ControllerFault, Refusal):
            self._change(loads, SlotState.ENDED)
            raise
        self._change(loads, SlotState.MOVING)
        return start_spans

    async def wait_for_end(self) -> MoveOutcome:
        """Wait for the end: ENDED. Raises `ControllerFault`, `Refusal` (code `not-armed` for an empty slot)."""
        self._require_move()
        loads = self._loads
        try:
            outcome = await self._mover.wait_for_end()
        except (ControllerFault, Refusal):
            self._change(loads, SlotState.ENDED)
            raise
        self._change(loads, SlotState.ENDED)
        return outcome

    def clear(self) -> None:
        """Note that the controller does not hold the move any more: EMPTY. Nothing is sent."""
        self._loads += 1
        self._state = SlotState.EMPTY

    def _change(self, loads: int, state: SlotState) -> None:
        if loads == self._loads:
            self._state = state

    def _require_move(self) -> None:
        if self._state is SlotState.EMPTY:
            raise Refusal("not-armed", "no move is loaded", "arm it first")


class MoveSlots:
    """The slots of a controller: one, or two of a controller that can hold a move beside the present one.

    The two change roles when the present move has ended. take_over: called then, before they do: the move of the
    following slot is the present one of the make too.
    """

    def __init__(
        self, present: MoveSlot, following: MoveSlot | None = None, take_over: Callable[[], None] = lambda: None
    ) -> None:
        self._present = present
        self._following = following
        self._take_over = take_over

    @property
    def present(self) -> MoveSlot:
        """The slot of the present move."""
        return self._present

    @property
    def following(self) -> MoveSlot | None:
        """The slot of the move behind the present one, which is loaded while that is released or moves; None of a
        controller with one slot. Only a lowered move with a `gap_ns` fits in it."""
        return self._following

    def advance(self) -> None:
        """The present move has ended: the following one is the present one from now on. Raises `Refusal` (code
        `not-armed`) if there is none."""
        following = self._following
        waiting_states = (SlotState.LOADED, SlotState.VERIFIED, SlotState.RELEASED)
        if following is None or following.state not in waiting_states:
            raise Refusal("not-armed", "no next move is loaded", "arm it first")
        self._take_over()
        self._present.clear()
        self._present, self._following = following, self._present

    async def unload(self) -> None:
        """Unload both slots: nothing starts, now or later."""
        if self._following is not None:
            self._following.clear()
        await self._present.unload()

    def drop(self) -> None:
        """Note that the controller was stopped, or is lost: it holds nothing any more that could start. A present move
        that was released stays until its end is known."""
        if self._present.state in (SlotState.LOADED, SlotState.VERIFIED):
            self._present.clear()
        if self._following is not None:
            self._following.clear()


class Driver(ABC):
    """One controller of a make: what every make does. What some do besides are the protocols of `adapters.abilities`.

    Concurrency: `poll` and `send_raw` may run concurrently with any other call, and `stop` may be called at any moment.
    The driver serialises its exchanges on the link itself; a stop bypasses that queue.

    Errors: every call may raise `LinkClosed` and `ControllerFault`. A call that waits for a reply of the controller has
    a timeout of its own and raises `ControllerFault` with code `no-answer`.
    """

    @abstractmethod
    async def connect(self) -> ControllerIdentity:
        """Open the links and bring the controller into a known state: the right make, nothing armed, no leftovers of an
        earlier session.

        The controller may be in any state: echo on, a half-typed command, another program running, a move under way. A
        moving controller is not stopped. Raises `LinkRefused`, or `ControllerFault` whose remedy states what the
        operator must do.
        """

    async def configure(self) -> None:
        """Read back the controller's stored settings and load what the driver needs; by default nothing.

        Raises `ControllerFault` (code `config-mismatch`, with item, found and expected value) for a difference that the
        driver must not correct by itself."""
        return

    @property
    @abstractmethod
    def capabilities(self) -> DriverCapabilities: ...

    @abstractmethod
    async def poll(self) -> ControllerReading:
        """Read the state of all axes, inputs and outputs, as cheaply as the make allows; the poll also updates the
        clock estimate.

        Raises `ControllerRestarted` when the controller has restarted and much must be loaded again. The caller then
        reconnects, and the first reading after that reports `restarted`.
        """

    def clock_mapping(self) -> TickMapping | None:
        """Return the current clock estimate; None for a make without a readable clock."""
        return None

    @abstractmethod
    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> Lowered:
        """Compile profiles to what the controller can execute. Pure: the same arguments give the same result.

        With `start.wait` the move starts when that input becomes active. With `start.drive` the controller makes that
        output active at T0 (with or without axes of its own) and passive again later. With `start.triggers` it switches
        outputs on the way, and the step ends only after the last of them. All happen only after the release, like any
        start; none after `stop` or `unload`, or after the end, and the outputs are passive then. An output that follows
        the pulses of an axis may go on while that brakes, not longer.

        Raises `Refusal` that names the axis and what would fit; code `start-class` for a start that the controller
        cannot make.
        """

    @property
    @abstractmethod
    def slots(self) -> MoveSlots:
        """The places for moves of the controller, the same over all its connections."""

    @abstractmethod
    async def stop(self, *, abort: bool) -> None:
        """Stop all axes and everything armed: by ramp, or with `abort` as fast as the controller can.

        Returns when the command is sent; never waits for an outstanding reply, and may be called concurrently with any
        other call.
        """

    @abstractmethod
    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        """Switch motors on or off. Raises `Refusal`."""

    @abstractmethod
    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        """Find the reference of all `axes` at the same time by their `homing`; return when all have come to rest.

        found: called with each axis as soon as its reference is found. Returns the axes without a reference, with the
        reason for each. No axis begins after a stop that was commanded since the call.

        Raises `Refusal` when no axis began, `ControllerFault`. On a timeout the caller cancels the call and then stops
        the controller.
        """

    @abstractmethod
    async def clear_faults(self) -> None:
        """Clear what the controller latches (error state, stop) after an operator's reset. Raises `Refusal`."""

    async def send_raw(self, command: str) -> str:
        """Send a command in the controller's language and return its reply as text. Raises `Refusal`; by default for
        every command."""
        raise Refusal("no-raw", f"this make takes no raw commands: {command!r}", "")

    @abstractmethod
    async def close(self) -> None:
        """Close the links. The controller stays as it is."""


class ConfigError(TuttiError, ValueError):
    """A controller's part of the fleet file that its make cannot drive.

    texts: one per mistake, each beginning with its field, `axes.x.limits.velocity: …`.
    """

    def __init__(self, texts: Sequence[str]) -> None:
        super().__init__("\n".join(texts))
        self.texts = tuple(texts)


Options = TypeVar("Options", bound=BaseModel)


def validate_options(model: type[Options], config: Controller) -> Options:
    """Return the `options` of a controller. Raises `ConfigError` with every mistake."""
    try:
        return model.model_validate(config.options)
    except ValidationError as error:
        raise ConfigError(
            [f"options.{'.'.join(map(str, problem.place))}: {problem.text}" for problem in list_problems(error, model)]
        ) from None


def require_no_problems(texts: Iterable[str]) -> None:
    """Raise `ConfigError` if there is any problem."""
    problems = list(texts)
    if problems:
        raise ConfigError(problems)


@dataclass(frozen=True, slots=True)
class ExamplePlace:
    """Where a controller of an example fleet is.

    number: among those of its make, from 0. port: a number that no other make of the file has, the first of as many as
    the make has controllers.
    """

    number: int
    port: int

    @property
    def own_port(self) -> int:
        """The number of a port that no other controller has."""
        return self.port + self.number


class Make(Protocol):
    """One make and model that can be driven: the object that an entry point of group `tutti.adapters` names.

    Optional: `make_decoder(options)` returns an `adapters.toolkit.frames.FrameDecoder` for `tutti trace`, made for a
    controller with these options; without it the trace shows text. `searches_by_direction = True`: a search for the
    reference goes in `homing.direction` and ends at a switch, so that soft limits beyond it are a mistake of the file.
    `gears_motors = True`: an axis may have two motors; without it such an axis is refused.
    """

    @property
    def name(self) -> str: ...

    @property
    def options_model(self) -> type[BaseModel]:
        """The model of `options:` in the fleet file."""
        ...

    def check_config(self, config: Controller) -> None:
        """Check a controller's part of the fleet file offline (motor names, input numbers, link kind).

        Raises `ConfigError` with every mistake: the field, the value found and the values allowed.
        """
        ...

    def fleet_example(self, place: ExamplePlace) -> str:
        """Return a commented example of a controller's part of a fleet file, which passes `check_config`."""
        ...

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        """The fields of a serial link that the fleet file may leave out, as the make is delivered."""
        ...

    def create_driver(self, setup: DriverSetup) -> Driver: ...

    def stop_bytes(self, config: Controller) -> bytes:
        """Return the bytes that a guardian writes to a link of its own to stop everything, whatever half-typed command
        the controller holds."""
        ...
