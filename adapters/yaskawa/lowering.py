"""Profiles turned into independent moves of the controller (PA, SP, AC, DC), and what is promised about them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from adapters.contract import CannotDo, Lowered
from adapters.yaskawa.options import Options
from adapters.yaskawa.program import entry, letters
from adapters.yaskawa.trapezoid import RAMP_UNIT, SPEED_UNIT, Bounds, Trapezoid, fit
from orchestrator.clock.base import NS_PER_S, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import Term
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs

STOP_EXCHANGES = 3  # a stop is three commands


@dataclass(frozen=True, slots=True)
class AxisMove:
    """One axis's move. index: 0 is X. start, end: absolute commanded positions, counts."""

    axis: str
    index: int
    start: int
    end: int
    shape: Trapezoid


@dataclass(frozen=True, slots=True)
class LoweredMoves(Lowered):
    """What arming needs beyond the contract. drift_bound_ns: the clock's error that the terms allow for."""

    moves: tuple[AxisMove, ...]
    mask: int
    drift_bound_ns: int


def fields(values: Mapping[int, int]) -> str:
    """Values by axis index, as the fields of a command: `100,,-5`."""
    return ",".join(str(values[index]) if index in values else "" for index in range(max(values) + 1))


def move_commands(moves: tuple[AxisMove, ...]) -> tuple[str, ...]:
    """The commands that load the moves; axes without a way are not touched."""
    way = [move for move in moves if move.shape.samples]
    if not way:
        return ()
    ends = fields({move.index: move.end for move in way})
    speeds = fields({move.index: move.shape.speed for move in way})
    ramps = fields({move.index: move.shape.ramp for move in way})
    return (f"PA {ends}", f"SP {speeds}", f"AC {ramps}", f"DC {ramps}")


def begin_ticks(options: Options, tick_ns: float) -> tuple[int, int]:
    """Between how many samples after XT0 the moves begin: BG takes effect some time after it, at a whole sample."""
    first = math.floor(options.decode_min_us * NS_PER_US / tick_ns) + 1
    last = math.floor(options.begin_max_us * NS_PER_US / tick_ns) + 1
    return first, max(first, last)


def lower_moves(
    config: Controller,
    motors: Mapping[str, int],
    options: Options,
    costs: Costs,
    profiles: Mapping[str, Profile],
    start: Literal["auto", "clock", "host"],
    mapping: TickMapping | None,
) -> LoweredMoves:
    """Pure. motors: index of each axis. Raises `CannotDo` naming the axis and what would fit."""
    if start == "host":
        raise CannotDo(
            "start-class",
            "this controller starts at an instant of its own clock, which is never worse than a command from the host",
            "ask for start class `auto` or `clock`",
        )
    if mapping is None:
        raise CannotDo("no-clock", "the controller's clock is not known yet", "wait a second")
    moves: list[AxisMove] = []
    for axis, profile in profiles.items():
        scale, limits = float(config.axes[axis].scale), config.axes[axis].limits
        bounds = Bounds(limits.velocity * scale, limits.acceleration * scale)
        shape = fit(axis, profile, bounds, mapping.tick_ns, options.servo_period_us)
        moves.append(AxisMove(axis, motors[axis], profile.start_counts, profile.end_counts, shape))
    # An axis that stands still is not begun; the time it is given has no meaning.
    mask = sum(1 << move.index for move in moves if move.shape.samples)
    tick_ns = mapping.tick_ns
    bound_ns = mapping.bound_at_ns(mapping.host_at_ns + round(options.lead_s * NS_PER_S))
    first, last = begin_ticks(options, tick_ns)
    # A stop brakes with the move's own DC, which a gentle move has set lower than the axis's limit.
    brake_ns = max(move.shape.speed / move.shape.ramp * RAMP_UNIT / SPEED_UNIT * tick_ns for move in moves)
    half_tick_ns = math.ceil(tick_ns / 2)
    return LoweredMoves(
        start_class="clock",
        durations_s={move.axis: move.shape.samples * tick_ns * 1e-9 for move in moves},
        path_error_counts={move.axis: move.shape.path_error_counts for move in moves},
        terms=(
            Term(name="clock", earliest_ns=-bound_ns, latest_ns=bound_ns),
            Term(name="quantisation", earliest_ns=-half_tick_ns, latest_ns=half_tick_ns),
            Term(name="tick", earliest_ns=0, latest_ns=math.ceil((last - first) * tick_ns)),
        ),
        tick_ns=tick_ns,
        costs=costs.model_copy(update={"stop_ns": math.ceil(brake_ns) + STOP_EXCHANGES * options.exchange_ns}),
        commands=(*move_commands(tuple(moves)), f"XQ {entry(mask)},0  (waits for T0, then BG{letters(mask)})"),
        moves=tuple(moves),
        mask=mask,
        drift_bound_ns=bound_ns,
    )
