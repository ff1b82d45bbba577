"""The forecast of a probe: the whole way to its end, and what its axes go on there behind a contact."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.names import controller_of, is_position_name
from orchestrator.model.state import ProbeAbility
from orchestrator.model.steps.probe import Probe, find_line_ramps
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.measured import check_measured
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import check_target, take_target
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.held_probes import find_watch_s, find_ways_to_stop
from orchestrator.plan.path_step import MAX_START_COUNTS
from orchestrator.plan.play import require_no_play
from orchestrator.plan.probes import (
    ContactRange,
    find_longest_s,
    find_most_speeds,
    find_overtravel,
    find_probe_speeds,
    make_other_start,
)
from orchestrator.plan.racks import require_single_motor


def forecast_probe(state: ForecastState, at: ForecastContext, step: Probe) -> Span:
    """Run a probe forward: its axes are somewhere on their way afterwards."""
    axes = _find_axes(state, at, step)
    if axes is None:
        return Span()
    if step.otherwise == "fail":
        state.notes[f"{step.until} becomes {step.level} on the way"] = None
    try:
        for name, axis in axes.items():
            require_no_play(name, axis, "contact")
            require_single_motor(name, axis, "probe")
        most_speeds = find_most_speeds(step, axes)
        abilities = _find_abilities(state, step, axes, most_speeds)
        _check_start(state, at, step)
        begins = {name: state.find_range(name) for name in axes}
        ends = _find_ends(state, at, step)
        state.lose_positions(at, axes)
        state.contacts |= dict.fromkeys(step.contact_names)
        ways = _find_ways(begins, ends)
        speeds = most_speeds if ways is None else find_probe_speeds(step, axes, ways)
    except Refusal as error:
        state.add_problem(at, (), error)
        return Span()
    overtravels = _find_overtravels(state, axes, speeds, abilities)
    return _take_ways(
        state,
        at,
        step,
        {
            name: _ProbeWay(begin, end, speeds[name], overtravels[name])
            for name, begin in begins.items()
            if begin is not None and (end := ends[name]) is not None
        },
    )


def _find_axes(state: ForecastState, at: ForecastContext, step: Probe) -> dict[str, Axis] | None:
    """The axes of a probe, which must be ready; None where one of them, or the input, is not known."""
    axes = {name: state.find_axis(at, name, ("to", name), "axis") for name in step.axes}
    known_axes = {name: axis for name, axis in axes.items() if axis is not None}
    if len(known_axes) < len(axes) or (step.limit is None and not state.check_name(at, step.until, "input")):
        return None
    for name in axes:
        state.require_ready(at, name, ("to", name))
    return known_axes


@dataclass(frozen=True, slots=True)
class _ProbeWay:
    """Where an axis of a probe begins and ends, as motor positions; its speed, and how far it goes on behind the
    contact at most, in its unit."""

    begin: ContactRange
    end: ContactRange
    speed: float
    overtravel: Fraction

    @property
    def contact(self) -> ContactRange:
        """Where it may touch."""
        return ContactRange(min(self.begin.low, self.end.low), max(self.begin.high, self.end.high))

    @property
    def rest(self) -> ContactRange:
        """Where it may come to rest."""
        low, high = self.contact
        is_upward = self.end.high - self.begin.high >= self.begin.low - self.end.low
        return ContactRange(low, high + self.overtravel) if is_upward else ContactRange(low - self.overtravel, high)


def _find_abilities(
    state: ForecastState, step: Probe, axes: Mapping[str, Axis], most_speeds: Mapping[str, float]
) -> dict[str, ProbeAbility]:
    """What stops each axis; empty without its controller, which alone knows that. Raises `Refusal` where it does not
    stop an axis by that input."""
    if any(controller_of(name) not in state.probes for name in axes):
        pronoun = "them" if step.is_line else "it"
        stopper = "coordinator" if step.is_held else f"controller of {' and '.join(step.axes)}"
        state.notes[f"the {stopper} stops {pronoun} by {step.until}"] = None
        return {}
    if step.is_held:
        watch_s = find_watch_s(state.fleet, step)
        state.notes[f"a contact that lasts less than {watch_s:.3g} s may not be seen"] = None
    return find_ways_to_stop(state.fleet, step, axes, state.probes, most_speeds)


def _find_ways(
    begins: Mapping[str, ContactRange | None], ends: Mapping[str, ContactRange | None]
) -> dict[str, float] | None:
    """How far each axis goes; None where that is not known of all."""
    ways: dict[str, float] = {}
    for name, begin in begins.items():
        end = ends[name]
        if begin is None or end is None or begin.low != begin.high or end.low != end.high:
            return None
        ways[name] = float(end.low - begin.low)
    return ways


def _find_overtravels(
    state: ForecastState, axes: Mapping[str, Axis], speeds: Mapping[str, float], abilities: Mapping[str, ProbeAbility]
) -> dict[str, Fraction]:
    """How far each axis goes on behind the contact at most, in its unit; 0 without its controller."""
    ramps, overtravels = find_line_ramps(axes, speeds), dict.fromkeys(axes, Fraction(0))
    for name, ability in abilities.items():
        axis, scale = axes[name], float(axes[name].scale)
        counts = find_overtravel(ability, axis, speeds[name], ramps[name])
        overtravels[name] = abs(Fraction(counts) / axis.scale)
        text = f"{name} goes on by at most {float(overtravels[name]):.3g} {axis.unit} behind the contact"
        off_line = ability.find_off_line(speeds[name] * scale) / scale
        state.notes[f"{text}, and is off its line by at most {off_line:.3g} {axis.unit}" if off_line else text] = None
    return overtravels


def _check_start(state: ForecastState, at: ForecastContext, step: Probe) -> None:
    """Where axes must stand before it: an axis whose position is not known must be there."""
    for name, value in step.start.items():
        axis = state.find_axis(at, name, ("start", name))
        amount = None if axis is None else state.parse_amount(at, value, TargetField("start", name, axis))
        if axis is None or amount is None:
            continue
        state_before = state.find_state(at, name)
        position_here = state_before.motor + state_before.offset
        if not state_before.known or state_before.offset_kind != "motor":
            state.notes[f"{name} stands at {float(amount):g} {axis.unit} when the probe begins"] = None
        elif abs(position_here - amount) * axis.scale > MAX_START_COUNTS:
            state.add_problem(at, ("start", name), make_other_start(name, float(position_here), amount, axis))


def _find_ends(state: ForecastState, at: ForecastContext, step: Probe) -> dict[str, ContactRange | None]:
    """Where the axes of a probe end that touches nothing; None: it is not known."""
    ends: dict[str, ContactRange | None] = dict.fromkeys(step.axes)
    ends |= check_measured(state, at, step, "to")
    state.note_unknown_positions(step)
    for name, value in step.to.items():
        field = TargetField("to", name, state.fleet.axis(name))
        amount = None if is_position_name(value) else state.parse_amount(at, value, field)
        if amount is not None:
            take_target(state, at, MoveWays(), field, amount)
            ends[name] = state.find_range(name)
    return ends


def _take_ways(state: ForecastState, at: ForecastContext, step: Probe, ways: Mapping[str, _ProbeWay]) -> Span:
    """Check what axes go on behind a contact at their ends, and where they may be afterwards. ways: of those whose
    positions are known."""
    longest_s: list[float] = []
    for name, way in ways.items():
        field, offset = TargetField("to", name, state.fleet.axis(name)), state.axes[name].offset
        state.contacts |= {text: way.contact for text, axis in step.contact_names.items() if axis == name}
        state.ranges[name] = way.rest
        for farthest in way.rest:
            if farthest not in way.contact:
                check_target(state, at, field, farthest, offset)
        distance = max(abs(end - begin) for end in way.end for begin in way.begin)
        longest_s.append(find_longest_s(field.axis, float(distance), way.speed))
    return Span(0.0, max(longest_s) if len(longest_s) == len(step.axes) else None)
