"""Pairs of axes that carry one beam: what may move them, and how far apart a fault may leave them."""

from collections.abc import Mapping, Sequence
from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.operation.pair_reach import FaultReach, find_size, floor_speed, make_fault_reach
from orchestrator.model.profile import Profile
from orchestrator.model.report import PairBound
from orchestrator.model.steps.base import Step
from orchestrator.model.virtual_maps import Pair
from orchestrator.plan.step import StepPlan

SHARE = 1e-6  # of a limit: rounding to counts


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
            length = find_size(fleet, axis, pair.unit) / abs(float(fleet.axis(axis).counts_per_unit))
            speeds.append(profile.peak_velocity * length)
            ways.append(abs(profile.end_counts - profile.start_counts) * length)
        reach = make_fault_reach(fleet, pair, alone)
        begin, growth = float(pair.max_deviation), reach.find_growth(max(speeds), max(ways))
        if len(profiles) == len(pair.real):
            racks = _find_racks(fleet, pair, list(profiles.values()))
            begin = max(begin, racks[0])
            # What brings them together cannot take them apart, wherever one of them stays.
            growth = 0.0 if max(racks) <= racks[0] else growth
        _require_room(pair, reach, growth, max(speeds))
        bounds[pair.group] = PairBound(most=begin + growth, unit=pair.unit)
    return bounds


def _find_racks(fleet: Fleet, pair: Pair, profiles: Sequence[Profile]) -> list[float]:
    """How far the beam is racked with each axis at the begin or at the end of its way; first with both at the begin."""
    virtual_map = fleet.virtual_axes.maps[pair.group]
    ends = [
        [fleet.axis(axis).to_position(counts) for counts in (profile.start_counts, profile.end_counts)]
        for axis, profile in zip(pair.real, profiles, strict=True)
    ]
    return [abs(float(virtual_map.to_virtual([first, second])[1])) for first in ends[0] for second in ends[1]]


def _require_room(pair: Pair, reach: FaultReach, growth: float, speed: float) -> None:
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
    fitting = f"{floor_speed(reach.find_speed(room)):g} {pair.unit}/s"
    raise Refusal("may-rack", f"{text}; {fitting} is the highest speed for that", f"move it at {fitting} at most")


def find_homing_speed(axis: Axis) -> float:
    """The approach speed of an axis that searches for its reference, in its unit/s."""
    return axis.limits.velocity / 10 if axis.homing.speed is None else axis.homing.speed


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
            text = f"{name} is one of the pair {pair.group}, and does not move alone"
            raise Refusal("pair", text, f"name {pair.middle}, which moves both", controller_of(name))


def _list_set_axes(step: Step) -> list[str]:
    """The axes that a step counts anew, where they stand."""
    return step.named_axes if step.sets_positions else []


def _require_both(fleet: Fleet, step: Step) -> None:
    """Both axes of a pair are homed together."""
    axes = set(step.find_axes(fleet))
    for pair in fleet.virtual_axes.pairs.values():
        searched_axes = axes & set(pair.real)
        if len(searched_axes) == 1:
            (axis,) = searched_axes
            text = f"{axis} is one of the pair {pair.group}, and is not homed alone"
            raise Refusal("pair", text, f"home {pair.middle}, which homes both", controller_of(axis))
        if searched_axes:
            _require_slow_homing(fleet, pair)


def _require_slow_homing(fleet: Fleet, pair: Pair) -> None:
    """Both search at one speed, at which a fault racks the beam by no more than it may be."""
    speeds = [find_homing_speed(fleet.axis(axis)) * find_size(fleet, axis, pair.unit) for axis in pair.real]
    shown_speeds = " and ".join(f"{axis} at {speed:g}" for axis, speed in zip(pair.real, speeds, strict=True))
    if max(speeds) - min(speeds) > SHARE * max(speeds):
        text = f"{pair.group}: {shown_speeds} {pair.unit}/s search for their references, and would come apart"
        raise Refusal("pair", text, "give both one `homing: {speed}` (and `search_speed`) in the fleet file")
    most = make_fault_reach(fleet, pair, {}).find_speed(float(pair.jog_reach))
    if max(speeds) > most * (1 + SHARE):
        fitting = f"{floor_speed(most):g} {pair.unit}/s"
        text = f"{pair.group}: {shown_speeds} {pair.unit}/s search for their references, and a fault might rack the"
        text += f" beam by more than it may be ({float(pair.may_rack):g}, `may_rack`); {fitting} is the highest speed"
        raise Refusal("may-rack", text, f"`homing: {{speed: {fitting}}}` for both")


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
    rack_now = positions[1]
    if middle is not None:
        if abs(rack_now) > pair.max_deviation:
            raise Refusal("racked", pair.describe_rack(float(rack_now)), pair.square_remedy)
        return [middle, Fraction(0)]
    assert rack is not None
    if abs(rack) > abs(rack_now) or rack * rack_now < 0:
        text = f"{pair.rack} is {float(rack_now):.4g} {pair.unit}, and moves only towards 0, not to {float(rack):.4g}"
        raise Refusal("pair", text, pair.square_remedy)
    return [positions[0], rack]
