"""Lowering to commands of the SHRC-203: a prebuffer move per axis, all started by one `G:`, or by an input.

Where a single move cannot reproduce the planned duration, a follow-up move is loaded while the first one runs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from adapters.contract import Lowered, ends_too_early, require_start_class
from adapters.shrc203.costs import following_costs
from adapters.shrc203.fleetaxes import TRIGGER_NUMBER, axis_bounds, motor_number
from adapters.shrc203.interpolation import SteadyAxis, StraightPath, fit_straight_path
from adapters.shrc203.options import LOWEST_POINT, ShrcOptions, edge_terms
from adapters.shrc203.pulses import PulseTrigger
from adapters.shrc203.shapes.pair import TwoPartMove, find_two_part_moves
from adapters.shrc203.shapes.trapezoid import DISTANCE_MAX, RAMP_MAX_MS, ShrcBounds, ShrcTrapezoid, fit_trapezoid
from adapters.shrc203.wire.replies import axis_argument
from adapters.toolkit.firing import learned_terms
from adapters.toolkit.host_start import find_release_ns, withdrawable_costs
from adapters.toolkit.path_error import legs_in_host_time, path_error_counts
from adapters.toolkit.wired_points import (
    WiredInput,
    WiredOutput,
    resolve_driven_output,
    resolve_wait_input,
    waiting_terms,
)
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.inferred import ClockEstimate
from orchestrator.clock.latency import StartLatency
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.messages import BudgetTerm, StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import StepCosts

OUTPUT_VALUES = range(64)
_START_CLASS_REASONS = {
    "line": "the controller accepts no input wait while its axes are at rest, or no input was named",
    "clock": "the SHRC-203 has no readable clock to start by",
}
# An interpolated path must be nearer to the plan by this many pulses: the controller moves in whole pulses.
_NEARER_PULSES = 0.5
# A follow-up move is not needed where a single move is this near to the planned duration.
_SINGLE_MOVE_S = 0.2e-3


@dataclass(frozen=True, slots=True)
class ConnectionTraits:
    """Properties of the connection that lowering uses.

    line_starts: whether axes can wait for an input.
    line_costs: costs of steps with a trigger line.
    known: knowledge about the controller's clock.
    closed_loop: motors that settle for a while at the end of a move.
    pulsed: the axis whose drive pulses triggers follow, if any."""

    char_ns: int
    line_starts: bool
    costs: StepCosts
    line_costs: StepCosts
    known: ClockEstimate
    closed_loop: frozenset[int] = frozenset()
    pulsed: str | None = None


@dataclass(frozen=True, slots=True)
class ShrcAxisMove:
    """One axis's part. distance: pls, signed. shape is None for an axis that stays at rest."""

    name: str
    motor: int
    start_counts: int
    distance: int
    shape: ShrcTrapezoid | TwoPartMove | SteadyAxis | None

    @property
    def running_shape(self) -> ShrcTrapezoid | TwoPartMove | SteadyAxis:
        """The shape of an axis that moves. Raises `ValueError` for one that stays at rest."""
        if self.shape is None:
            raise ValueError(f"axis {self.name} stays at rest")
        return self.shape

    @property
    def executed_moves(self) -> "tuple[ShrcAxisMove, ...]":
        """Return the moves that the controller executes for it, in their order."""
        if not isinstance(self.shape, TwoPartMove):
            return (self,)
        first_shape, second_shape = self.shape.first, self.shape.second
        first = replace(self, distance=self.sign * first_shape.distance, shape=first_shape)
        return first, ShrcAxisMove(
            self.name, self.motor, first.end_counts, self.sign * second_shape.distance, second_shape
        )

    @property
    def end_counts(self) -> int:
        return self.start_counts + self.distance

    @property
    def sign(self) -> int:
        """The direction of the move in counts."""
        return 1 if self.distance > 0 else -1


@dataclass(frozen=True, slots=True)
class ShrcLowered(Lowered):
    """A lowered step with what loading it needs: the moves, the commands that load and start them, and the trigger
    lines.

    lead_ns: the end of the command that starts, or switches an output, reaches the controller this long before T0.
    first_moves: the moves loaded by `load`.
    followup_moves: the follow-up moves, which `load_followup` loads once the first ones run.
    straight: the moves are parts of one interpolated path.
    trigger: of the trigger output, set before the move is loaded."""

    lead_ns: int = 0
    moves: tuple[ShrcAxisMove, ...] = ()
    first_moves: tuple[ShrcAxisMove, ...] = ()
    followup_moves: tuple[ShrcAxisMove, ...] = ()
    load: str = ""
    load_followup: str = ""
    start: str = ""
    wait: WiredInput | None = None
    drive: WiredOutput | None = None
    straight: StraightPath | None = None
    trigger: PulseTrigger | None = None


def lower_step(
    config: Controller,
    options: ShrcOptions,
    traits: ConnectionTraits,
    profiles: Mapping[str, Profile],
    start_options: StartOptions,
) -> ShrcLowered:
    """Lower all axes of a step. Raises `Refusal`."""
    wait, drive = _resolve_points(config, traits, start_options)
    moves, straight = _make_moves(config, options, traits, profiles, start_options)
    real_moves = tuple(move for move in moves if move.shape is not None)
    commands = _make_commands(real_moves, straight)
    rate, lead_ns = traits.known.rate, traits.known.latency.usual_ns
    durations_s = {move.name: move.shape.duration_s / rate.clock_factor if move.shape else 0.0 for move in moves}
    behind_ns = (len(f"O:{max(OUTPUT_VALUES)}") + 2) * traits.char_ns if real_moves and wait is None else 0
    costs = traits.costs
    if wait is not None or drive is not None:
        costs = traits.line_costs
    elif start_options.follows:
        costs = following_costs(options, traits.char_ns, commands.load, costs)
    elif start_options.waits_armed:
        costs = withdrawable_costs(costs, lead_ns + (len(commands.start) + len("\r\n")) * traits.char_ns)
    return ShrcLowered(
        start_class="host" if wait is None else "line",
        durations_s=durations_s,
        path_error_counts={move.name: _path_error(profiles[move.name], move, rate.clock_factor) for move in moves},
        terms=start_terms(options, traits.known.latency) if wait is None else _line_start_terms(options, wait),
        tick_ns=0.0,
        clock_ppm=traits.known.bound_ppm(max(durations_s.values(), default=0.0)),
        costs=costs,
        commands=(*_display_commands(real_moves, commands, wait, drive), *commands.followup_lines),
        edge=() if drive is None else edge_terms(options, lead_ns, behind_ns),
        can_advance=True,
        lead_ns=lead_ns,
        release_ns=find_release_ns(lead_ns, (len(commands.start) + len("\r\n")) * traits.char_ns, wait, drive),
        moves=real_moves,
        first_moves=commands.firsts,
        followup_moves=commands.followups,
        load=commands.load,
        load_followup=commands.load_followup,
        start=commands.start,
        wait=wait,
        drive=drive,
        straight=straight,
    )


def _resolve_points(
    config: Controller, traits: ConnectionTraits, start_options: StartOptions
) -> tuple[WiredInput | None, WiredOutput | None]:
    """Return the input that the step waits for, and the output that it drives. Raises `Refusal`."""
    if start_options.wait is not None and traits.line_starts:
        require_start_class(start_options, ("host", "line"), "")
    else:
        require_start_class(
            start_options,
            ("host",),
            _START_CLASS_REASONS[
                "line" if start_options.wait is not None or start_options.start_class == "line" else "clock"
            ],
        )
    wait = None if start_options.wait is None else resolve_wait_input(config, start_options.wait, LOWEST_POINT)
    drive = None if start_options.drive is None else resolve_driven_output(config, start_options.drive, LOWEST_POINT)
    if drive is not None and drive.number == TRIGGER_NUMBER:
        raise Refusal(
            "start-class", f"output {drive.name} is the trigger output, which gives pulses only", "use OUT1 to 6"
        )
    return wait, drive


@dataclass(frozen=True, slots=True)
class _StepCommands:
    """The moves of a step that are begun by its start, and those that follow by themselves; with their commands."""

    firsts: tuple[ShrcAxisMove, ...]
    followups: tuple[ShrcAxisMove, ...]
    load: str
    load_followup: str
    start: str

    @property
    def followup_lines(self) -> tuple[str, ...]:
        return (self.load_followup,) if self.followups else ()


def _make_commands(real_moves: tuple[ShrcAxisMove, ...], straight: StraightPath | None) -> _StepCommands:
    firsts = tuple(move.executed_moves[0] for move in real_moves)
    followups = tuple(piece for move in real_moves for piece in move.executed_moves[1:])
    load = straight.load_command if straight is not None else load_line(firsts) if real_moves else ""
    return _StepCommands(
        firsts=firsts,
        followups=followups,
        load=load,
        load_followup=load_line(followups) if followups else "",
        start=start_line(real_moves) if real_moves else "",
    )


def _make_moves(
    config: Controller,
    options: ShrcOptions,
    traits: ConnectionTraits,
    profiles: Mapping[str, Profile],
    start_options: StartOptions,
) -> tuple[tuple[ShrcAxisMove, ...], StraightPath | None]:
    """Return the part of every axis. A straight path uses the controller's interpolation where that is nearer to the
    plan than moves of single axes, or these cannot be slow enough.

    The messages at the end of an interpolated path are not documented (L4653), so that it must have a clear advantage.
    """
    ways = {name: _unshaped_move(name, config.axes[name], profile) for name, profile in profiles.items()}
    real_ways = tuple(way for way in ways.values() if way.distance)
    resting_axes = tuple(way for way in ways.values() if not way.distance)
    factor = traits.known.rate.clock_factor
    line = (
        fit_straight_path(config, options, profiles, [way.name for way in real_ways], factor)
        if start_options.wait is None
        else None
    )
    try:
        single_moves = tuple(
            _require_slow_enough(
                _single_move(config.axes[way.name], options, traits, way, profiles[way.name]),
                profiles[way.name],
                factor,
                start_options,
            )
            for way in real_ways
        )
    except Refusal as refusal:
        if line is None or refusal.code != "too-slow":
            raise
        single_moves = None
    parts = () if line is None else _interpolated_axes(line, real_ways)
    if single_moves is not None and (
        not parts
        or _worst_path_error(profiles, parts, factor)
        > _worst_path_error(profiles, single_moves, factor) - _NEARER_PULSES
    ):
        parts, line = single_moves, None
    return tuple(sorted((*parts, *resting_axes), key=lambda move: move.motor)), line


def _worst_path_error(profiles: Mapping[str, Profile], moves: tuple[ShrcAxisMove, ...], factor: float) -> float:
    return max((_path_error(profiles[move.name], move, factor) for move in moves), default=0.0)


def _interpolated_axes(line: StraightPath, moves: tuple[ShrcAxisMove, ...]) -> tuple[ShrcAxisMove, ...]:
    """Return the axes of an interpolated path."""
    return tuple(replace(move, shape=SteadyAxis(abs(move.distance), line.duration_s)) for move in moves)


def _display_commands(
    running: tuple[ShrcAxisMove, ...], commands: _StepCommands, wait: WiredInput | None, drive: WiredOutput | None
) -> tuple[str, ...]:
    """Return the commands for display. The other inputs and outputs keep their states at that time."""
    switch = () if drive is None else (f"O: with OUT{drive.number} {'on' if drive.active else 'off'}",)
    if not running:
        return switch
    if wait is None:
        return (commands.load, commands.start, *switch)
    pattern = (
        f"WI:{axis_argument(move.motor for move in running)}, with IN{wait.number} {'on' if wait.active else 'off'}"
    )
    return (pattern, commands.start, commands.load, *switch)


def start_terms(options: ShrcOptions, start: StartLatency) -> tuple[BudgetTerm, ...]:
    """Return the terms of the start relative to T0: the starting command is written so that its usual delay ends at
    T0."""
    jitter_ns = options.wire_jitter_us * NS_PER_US
    first_ns, last_ns = start.earliest_ns - start.usual_ns, start.latest_ns - jitter_ns - start.usual_ns
    first_ns, last_ns = first_ns + start.learned_early_ns, last_ns - start.learned_late_ns
    return (
        options.host_term(),
        BudgetTerm(name="wire", earliest_ns=0, latest_ns=jitter_ns),
        BudgetTerm(name="firmware", earliest_ns=first_ns, latest_ns=last_ns),
        *learned_terms(start),
    )


def load_line(moves: tuple[ShrcAxisMove, ...]) -> str:
    """Return `MP:A+P10000-P4000,S2F5714R250S5F2285R250` (L3124-L3167); relative, so that it is exact in commanded
    pulses."""
    ways = "".join(f"{'-' if move.distance < 0 else '+'}P{abs(move.distance)}" for move in moves)
    shapes = [move.shape for move in moves if isinstance(move.shape, ShrcTrapezoid)]
    speeds = "".join(f"S{shape.s}F{shape.f}R{shape.r}" for shape in shapes)
    return f"MP:{axis_argument(move.motor for move in moves)}{ways},{speeds}"


def start_line(moves: tuple[ShrcAxisMove, ...]) -> str:
    """Return the one command that starts all axes of a controller (L4779-L4822)."""
    return f"G:{axis_argument(move.motor for move in moves)}"


def _unshaped_move(name: str, axis: Axis, profile: Profile) -> ShrcAxisMove:
    """Return the move of an axis, without a shape yet."""
    if any(profile.jerks):
        raise Refusal("jerk", f"axis {name}: the SHRC-203 cannot limit jerk", "remove `jerk` from the axis's limits")
    distance = profile.end_counts - profile.start_counts
    if distance and (abs(distance) > DISTANCE_MAX or abs(profile.end_counts) > DISTANCE_MAX):
        raise Refusal(
            "too-far",
            f"axis {name}: a move of {distance} pulses to {profile.end_counts} exceeds {DISTANCE_MAX}",
            "make it shorter",
        )
    return ShrcAxisMove(name, motor_number(axis), profile.start_counts, distance, None)


def _single_move(
    axis: Axis,
    options: ShrcOptions,
    traits: ConnectionTraits,
    move: ShrcAxisMove,
    profile: Profile,
) -> ShrcAxisMove:
    """Return the move of an axis by itself; one without a pause, if triggers follow it. Raises `Refusal`."""
    factor, limits, way, name = traits.known.rate.clock_factor, axis_bounds(axis), abs(move.distance), move.name
    wanted_s = profile.duration_s * factor  # of the controller's own
    shape: ShrcTrapezoid | TwoPartMove | None = fit_trapezoid(way, wanted_s, profile.durations_s[0] * factor, limits)
    if shape is None:
        raise Refusal(
            "start-rate",
            f"axis {name}: no start speed from {limits.start_min} to {limits.start_max} pls/s is below its speed limit",
            "correct `start_rate`",
        )
    # In closed loop the end of a first move is known only when the scale has settled; and triggers promise instants,
    # which a pause of unknown length between two moves does not allow.
    if move.motor not in traits.closed_loop and name != traits.pulsed:
        shape = _nearer_shape(shape, profile, limits, options, factor)
    return replace(move, shape=shape)


def _require_slow_enough(
    move: ShrcAxisMove, profile: Profile, factor: float, start_options: StartOptions
) -> ShrcAxisMove:
    """Return the move. Raises `Refusal` when it ends too early."""
    shape, way, name = move.running_shape, abs(move.distance), move.name
    # The controller's lowest speed is its start speed: a slower move is refused, a longer duration is reported.
    if ends_too_early(shape.duration_s / factor, profile.duration_s, start_options):
        raise Refusal(
            "too-slow",
            f"axis {name}: {way} pulses in {profile.duration_s:.6g} s is too slow for the controller; its "
            f"longest duration within ramps of {RAMP_MAX_MS} ms and its start speeds is "
            f"{shape.duration_s / factor:.6g} s",
            f"plan {shape.duration_s / factor:.6g} s or less, lower `start_rate.min`, or let it end early with "
            "`max_end_skew`",
        )
    return move


def _nearer_shape(
    one: ShrcTrapezoid, profile: Profile, limits: ShrcBounds, options: ShrcOptions, factor: float
) -> ShrcTrapezoid | TwoPartMove:
    """Return one move, or two where a single move misses the planned duration; of those that reach it, the one nearest
    to the plan."""
    wanted_s = profile.duration_s * factor

    def off_s(shape: ShrcTrapezoid | TwoPartMove) -> float:
        return abs(shape.duration_s - wanted_s)

    if off_s(one) <= _SINGLE_MOVE_S:
        return one
    candidates = find_two_part_moves(one.distance, wanted_s, limits, options.handover_us * 1e-6)
    two = min(
        candidates,
        key=lambda candidate: path_error_counts(profile, legs_in_host_time(candidate.motion_legs, factor)),
        default=None,
    )
    return one if two is None or off_s(two) >= off_s(one) else two


def _path_error(profile: Profile, move: ShrcAxisMove, factor: float) -> float:
    return 0.0 if move.shape is None else path_error_counts(profile, legs_in_host_time(move.shape.motion_legs, factor))


def _line_start_terms(options: ShrcOptions, wait: WiredInput) -> tuple[BudgetTerm, ...]:
    """Return the terms of a start by trigger line relative to T0."""
    return waiting_terms(wait, options.input_scan_us, options.clock_ppm, options.line_start_us)
