"""Pairs of axes that carry one beam: what may move them, and how far apart a fault may leave them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.report import PairBound
from orchestrator.model.steps.base import Step
from orchestrator.model.units import Unit, convert_units
from orchestrator.model.virtual_maps import Pair
from orchestrator.plan.step import StepPlan

DETECTION_S = 1.0
"""After any fault every member that can be reached has begun to decelerate within this time (invariant 3)."""
SHARE = 1e-6  # of a limit: rounding to counts
SHOWN_SHARE = 1e-3  # of a speed, by which the one that fits is rounded down


@dataclass(frozen=True, slots=True)
class FaultReach:
    """How far the axes of a pair may come apart by one fault, in the pair's unit.

    Before the fault both are within `max_deviation` of square: farther apart they are stopped, whatever the cause is
    (start skew, end skew, path errors, an axis that lags). Let both move at v when the fault occurs. The axis that it
    concerns stops at once in the worst case, without a ramp (its power is lost, its brake closes), and its way is 0
    from then on. The other one goes on at v for a time T, and then by its ramp a, which takes it
    v T + v² / (2 a) farther. So both come apart by at most that, in either direction, and by no more than the rest of
    the way, behind which an axis stands anyhow.

    T is what invariant 3 allows from the fault to the beginning of the ramp, polls, messages and the request to stop
    included (`DETECTION_S`): a drive or its power, a host, the coordinator, an e-stop. A controller whose link is lost
    cannot be stopped, and goes on until its own watchdog stops it (`alone_s`); without one (None), to the end of its
    way. With both, T is the longer one.

    ramp: the smaller acceleration of both axes, unit/s².
    """

    ramp: float
    alone_s: float | None

    def find_growth(self, speed: float, way: float = math.inf) -> float:
        """How far both come apart at `speed` (unit/s), with `way` left."""
        if self.alone_s is None:
            return way if speed else 0.0
        return min(way, speed * max(DETECTION_S, self.alone_s) + speed**2 / (2 * self.ramp))

    def find_speed(self, growth: float) -> float:
        """The highest speed at which both come apart by no more than `growth`, however long the way is."""
        if self.alone_s is None:
            return 0.0
        wait_s = max(DETECTION_S, self.alone_s)
        return self.ramp * (math.sqrt(wait_s**2 + 2 * growth / self.ramp) - wait_s)


def make_fault_reach(fleet: Fleet, pair: Pair, alone: Mapping[str, float | None]) -> FaultReach:
    """The reach of a fault of a pair. alone: for how long controllers go on without their adapters, s; those that are
    not in it have not answered, and count as stopped by then."""
    ramps = [fleet.axis(axis).limits.acceleration * _find_size(fleet, axis, pair.unit) for axis in pair.real]
    times_s = [alone.get(controller_of(axis), DETECTION_S) for axis in pair.real]
    known_s = [time_s for time_s in times_s if time_s is not None]
    return FaultReach(min(ramps), max(known_s) if len(known_s) == len(times_s) else None)


def bound_pairs(fleet: Fleet, plan: StepPlan, alone: Mapping[str, float | None]) -> dict[str, PairBound]:
    """How far the pairs that a plan moves may be apart after one fault, by group. alone: see `make_fault_reach`. Raises
    `Refusal`: code `may-rack`, with the highest speed that fits."""
    bounds: dict[str, PairBound] = {}
    for pair in fleet.virtual_axes.pairs.values():
        profiles = {axis: plan.profiles[axis] for axis in pair.real if axis in plan.profiles}
        if not profiles:
            continue
        speeds, ways = list[float](), list[float]()
        for axis, profile in profiles.items():
            length = _find_size(fleet, axis, pair.unit) / abs(float(fleet.axis(axis).counts_per_unit))
            speeds.append(profile.peak_velocity * length)
            ways.append(abs(profile.end_counts - profile.start_counts) * length)
        reach = make_fault_reach(fleet, pair, alone)
        growth = reach.find_growth(max(speeds), max(ways))
        begin = float(pair.max_deviation)
        if len(profiles) == len(pair.real):
            starts = [fleet.axis(axis).to_position(profile.start_counts) for axis, profile in profiles.items()]
            rack = fleet.virtual_axes.maps[pair.group].to_virtual(starts)[1]
            begin = max(begin, abs(float(rack)))
        _require_room(fleet, pair, reach, growth, max(speeds))
        bounds[pair.group] = PairBound(most=begin + growth, unit=pair.unit)
    return bounds


def _require_room(fleet: Fleet, pair: Pair, reach: FaultReach, growth: float, speed: float) -> None:
    room = float(pair.may_rack - pair.max_deviation)
    if growth <= room * (1 + SHARE):
        return
    most = growth + float(pair.max_deviation)
    text = f"{pair.group} at {speed:.3g} {pair.unit}/s: {' and '.join(pair.real)} might be {most:.3g} {pair.unit} apart"
    text += f" after a single fault, and the beam may be racked by {float(pair.may_rack):g} (`may_rack`)"
    if reach.alone_s is None:
        lonely = [controller_of(axis) for axis in pair.real]
        remedy = f"give {' and '.join(lonely)} a watchdog that stops them without their links (`watchdog_ms`), or move "
        raise Refusal("may-rack", text, f"{remedy}by {room:.3g} {pair.unit} at most at a time")
    fitting = floor_speed(reach.find_speed(room))
    raise Refusal("may-rack", text, f"move it at {fitting:g} {pair.unit}/s at most")


def find_homing_speed(axis: Axis) -> float:
    """The approach speed of an axis that searches for its reference, in its unit/s."""
    return axis.limits.velocity / 10 if axis.homing.speed is None else axis.homing.speed


def floor_speed(speed: float) -> float:
    """A speed to show: three digits, rounded down so that it still fits."""
    if not speed:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(speed)) - 2)
    return math.floor(speed * (1 + 1e-12) / digit) * digit


def _find_size(fleet: Fleet, axis: str, unit: Unit) -> float:
    """The size of the unit of an axis in `unit`."""
    return float(convert_units(Fraction(1), fleet.axis(axis).unit, unit, axis))


# What may move them


def require_whole_pairs(fleet: Fleet, step: Step) -> None:
    """Raise `Refusal` (code `pair`) for a step that would move, search or count one axis of a pair without the
    other."""
    pair_of = fleet.virtual_axes.pair_of
    if not pair_of:
        return
    if step.searches:
        _require_both(fleet, step)
        return
    names = dict.fromkeys([*(step.named_axes if step.moves else ()), *step.placed_axes, *_list_set_axes(step)])
    for name in names:
        pair = pair_of.get(name)
        if pair is not None:
            raise Refusal(
                "pair", f"{name} is one of the pair {pair.group}, and does not move alone", _tell_middle(pair), controller_of(name)
            )


def _list_set_axes(step: Step) -> list[str]:
    """The axes that a step counts anew, where they stand."""
    return step.named_axes if step.sets_positions else []


def _require_both(fleet: Fleet, step: Step) -> None:
    """Both axes of a pair are homed together."""
    if not step.named_axes:
        return
    axes = set(step.find_axes(fleet))
    for pair in fleet.virtual_axes.pairs.values():
        searched_axes = axes & set(pair.real)
        if len(searched_axes) == 1:
            (axis,) = searched_axes
            text = f"{axis} is one of the pair {pair.group}, and is not homed alone"
            raise Refusal("pair", text, f"home {pair.middle}, which homes both", controller_of(axis))


def _tell_middle(pair: Pair) -> str:
    return f"name {pair.middle}, which moves both"


def find_pair_targets(
    pair: Pair, targets: Sequence[Fraction | None], positions: Sequence[Fraction] | None
) -> list[Fraction | None]:
    """The targets of the virtual axes of a pair: its moves end square. targets: those of the middle and of `rack` that
    the step states, None where it states none. positions: of both now; None: unknown. Raises `Refusal`."""
    middle, rack = targets
    if middle is not None and rack is not None and rack != 0:
        text = f"{pair.middle} and {pair.rack} in one step: a pair moves square"
        raise Refusal("pair", text, f"leave {pair.rack} out")
    if positions is None:
        return [middle, rack if middle is None else Fraction(0)]
    here = positions[1]
    if middle is not None:
        if abs(here) > pair.max_deviation:
            raise Refusal("racked", describe_rack(pair, float(here)), tell_square(pair))
        return [middle, Fraction(0)]
    assert rack is not None
    if abs(rack) > abs(here) or rack * here < 0:
        text = f"{pair.rack} is {float(here):.4g} {pair.unit}, and moves only towards 0, not to {float(rack):.4g}"
        raise Refusal("pair", text, tell_square(pair))
    return [positions[0], rack]


def describe_rack(pair: Pair, rack: float) -> str:
    """That a pair is racked, in words."""
    return (
        f"{pair.group} is racked by {abs(rack):.3g} {pair.unit}, {' and '.join(pair.real)} are farther apart than "
        f"max_deviation ({float(pair.max_deviation):g})"
    )


def tell_square(pair: Pair) -> str:
    """What to do about a racked pair."""
    return f"find out why; then square it: `tutti axis move {pair.rack}=0`"
