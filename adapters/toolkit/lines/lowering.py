"""Lowering to trapezoids: a target, a speed and an acceleration for each axis, started by one command."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, sqrt

from adapters.contract import Lowered, ends_too_early, require_start_class
from adapters.toolkit.lines.dialect import LineDialect, LineTarget
from adapters.toolkit.lines.options import LineOptions
from adapters.toolkit.path_error import path_error_counts
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.messages import BudgetTerm, StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import StepCosts

_STEPS_OF_ARMING = 8  # exchanges of arming besides one per axis, at most
_LINE_CHARACTERS = 120  # of a command and its reply
_HOST_NS = 5 * NS_PER_MS
_PROMPT_NS = 20 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class LineAxisMove:
    """One axis of a move: counts, counts/s, counts/s². The velocity is 0 for an axis that stays where it is."""

    name: str
    start_counts: int
    end_counts: int
    velocity: float
    acceleration: float

    @property
    def distance(self) -> int:
        return self.end_counts - self.start_counts

    @property
    def duration_s(self) -> float:
        """From start to end, at the controller's own time."""
        if not self.distance:
            return 0.0
        return abs(self.distance) / self.velocity + self.velocity / self.acceleration

    @property
    def legs(self) -> tuple[tuple[float, float, float], ...]:
        """Duration, initial speed and acceleration of ramp, cruise and ramp."""
        ramp_s = self.velocity / self.acceleration
        cruise_s = max(0.0, self.duration_s - 2 * ramp_s)
        return (
            (ramp_s, 0.0, self.acceleration),
            (cruise_s, self.velocity, 0.0),
            (ramp_s, self.velocity, -self.acceleration),
        )


@dataclass(frozen=True, slots=True)
class LineLowered(Lowered):
    """A lowered step with its moves, and the targets in the controller's unit."""

    moves: tuple[LineAxisMove, ...] = ()
    targets: tuple[LineTarget, ...] = ()


@dataclass(frozen=True, slots=True)
class CountScale:
    """How counts of an axis are written: position = (counts + offset_counts) / counts_per_unit."""

    counts_per_unit: float
    offset_counts: float = 0.0

    def to_position(self, counts: float) -> float:
        """Return the controller's position."""
        return (counts + self.offset_counts) / self.counts_per_unit

    def to_counts(self, position: float) -> int:
        """Return whole counts."""
        return round(position * self.counts_per_unit - self.offset_counts)


def lower_step(
    config: Controller,
    dialect: LineDialect,
    scales: Mapping[str, CountScale],
    profiles: Mapping[str, Profile],
    start: StartOptions,
) -> tuple[tuple[LineAxisMove, ...], tuple[LineTarget, ...]]:
    """Return the moves and targets of a step. Raises `Refusal`."""
    require_start_class(start, ("host",), "this controller starts by a command of the host")
    if start.drive is not None:
        raise Refusal("start-class", "this adapter drives no trigger line", "use an output of another controller")
    moves = [_fit_axis(name, config.axes[name], profile, dialect) for name, profile in profiles.items()]
    if dialect.traits.joint:
        moves = _join_axes(config, moves, max((profile.duration_s for profile in profiles.values()), default=0.0))
    for move, profile in zip(moves, profiles.values(), strict=True):
        if move.distance and ends_too_early(move.duration_s, profile.duration_s, start):
            raise Refusal(
                "too-slow",
                f"axis {move.name}: the move takes {move.duration_s:.6g} s, planned are {profile.duration_s:.6g} s",
                "plan a faster move",
            )
    targets = [
        LineTarget(
            config.axes[move.name].motors[0],
            scales[move.name].to_position(move.end_counts),
            move.distance / scales[move.name].counts_per_unit,
            move.velocity / scales[move.name].counts_per_unit,
            move.acceleration / scales[move.name].counts_per_unit,
        )
        for move in moves
        if move.distance
    ]
    return tuple(moves), tuple(targets)


def axis_acceleration(axis: Axis) -> float:
    """Return the acceleration limit of an axis, counts/s²."""
    return axis.limits.acceleration * float(axis.scale)


def _fit_axis(name: str, axis: Axis, profile: Profile, dialect: LineDialect) -> LineAxisMove:
    """Return the trapezoid of the same distance and duration: with the profile's own ramps, or where the controller
    has one acceleration, with that one."""
    if any(profile.jerks):
        raise Refusal("jerk", f"axis {name}: this controller cannot limit jerk", "remove `jerk` from the axis's limits")
    distance, wanted_s = abs(profile.end_counts - profile.start_counts), profile.duration_s
    if not distance:
        return LineAxisMove(name, profile.start_counts, profile.end_counts, 0.0, axis_acceleration(axis))
    if dialect.traits.fixed_acceleration:
        acceleration = axis_acceleration(axis)
        velocity = velocity_of_duration(distance, wanted_s, acceleration)
    else:
        velocity = profile.peak_velocity
        ramp_s = wanted_s - distance / velocity
        acceleration = velocity / ramp_s if ramp_s > 0 else axis_acceleration(axis)
    return LineAxisMove(name, profile.start_counts, profile.end_counts, velocity, acceleration)


def velocity_of_duration(distance: float, duration_s: float, acceleration: float) -> float:
    """Return the speed at which a trapezoid with this acceleration covers the distance in this time; the highest one
    of a triangle where it cannot be so short."""
    square = duration_s**2 - 4 * distance / acceleration
    return acceleration * (duration_s - sqrt(max(0.0, square))) / 2


def _join_axes(config: Controller, moves: list[LineAxisMove], wanted_s: float) -> list[LineAxisMove]:
    """Return the same moves along a straight line: all axes have one duration, and the acceleration that the slowest
    of them allows."""
    real_moves = [move for move in moves if move.distance]
    if not real_moves:
        return moves
    # The path from 0 to 1.
    path_acceleration = min(axis_acceleration(config.axes[move.name]) / abs(move.distance) for move in real_moves)
    path_velocity = velocity_of_duration(1.0, wanted_s, path_acceleration)
    return [
        LineAxisMove(
            move.name,
            move.start_counts,
            move.end_counts,
            path_velocity * abs(move.distance),
            path_acceleration * abs(move.distance),
        )
        if move.distance
        else move
        for move in moves
    ]


def start_terms(options: LineOptions) -> tuple[BudgetTerm, ...]:
    """Return the interval of the start relative to T0."""
    return (
        options.host_term(),
        BudgetTerm(name="wire", earliest_ns=0, latest_ns=options.wire_jitter_us * NS_PER_US),
        BudgetTerm(name="firmware", earliest_ns=0, latest_ns=options.decode_spread_us * NS_PER_US),
    )


def step_costs(options: LineOptions, char_ns: int, axes: int, ramp_s: float) -> StepCosts:
    """Return upper bounds for arming, disarming and stopping. ramp_s: longest ramp of a stop."""
    each_ns = (options.decode_us + options.decode_spread_us + 2 * options.wire_jitter_us) * NS_PER_US
    each_ns += _LINE_CHARACTERS * char_ns + _HOST_NS
    return StepCosts(
        arm_ns=(_STEPS_OF_ARMING + axes) * each_ns + _PROMPT_NS,
        disarm_ns=_STEPS_OF_ARMING * each_ns + 2 * _PROMPT_NS,
        stop_ns=ceil(ramp_s * NS_PER_S) + 2 * each_ns + _PROMPT_NS,
    )


def make_lowered(
    moves: tuple[LineAxisMove, ...],
    targets: tuple[LineTarget, ...],
    profiles: Mapping[str, Profile],
    options: LineOptions,
    costs: StepCosts,
) -> LineLowered:
    """Return the whole lowered step."""
    return LineLowered(
        start_class="host",
        durations_s={move.name: move.duration_s for move in moves},
        path_error_counts={
            move.name: path_error_counts(profiles[move.name], move.legs) if move.distance else 0.0 for move in moves
        },
        terms=start_terms(options),
        tick_ns=0.0,
        costs=costs,
        commands=tuple(f"{target.motor}: to {target.position:.6g} at {target.velocity:.6g}/s" for target in targets),
        clock_ppm=options.clock_ppm,
        moves=moves,
        targets=targets,
    )
