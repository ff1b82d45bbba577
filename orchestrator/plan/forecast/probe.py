"""The forecast of a probe: the whole way to its end, and what its axis goes on there behind a contact."""

from dataclasses import dataclass
from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.names import controller_of, is_position_name
from orchestrator.model.steps.probe import Probe
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.measured import check_measured
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import check_target, take_target
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.path_step import MAX_START_COUNTS
from orchestrator.plan.play import require_no_play
from orchestrator.plan.probes import ContactRange, find_longest_s, find_overtravel, find_probe_speed, make_other_start
from orchestrator.plan.racks import require_single_motor


def forecast_probe(state: ForecastState, at: ForecastContext, step: Probe) -> Span:
    """Run a probe forward: its axis is somewhere on its way afterwards."""
    field_place = ("to", step.axis)
    axis = state.find_axis(at, step.axis, field_place, "axis")
    if axis is None or (step.limit is None and not state.check_name(at, step.until, "input")):
        return Span()
    state.require_ready(at, step.axis, field_place)
    if step.otherwise == "fail":
        state.notes[f"{step.until} becomes {step.level} on the way"] = None
    try:
        require_no_play(step.axis, axis, "contact")
        require_single_motor(step.axis, axis, "probe")
        speed = find_probe_speed(step, axis)
        overtravel = _find_overtravel(state, step, axis, speed)
    except Refusal as error:
        state.add_problem(at, (), error)
        return Span()
    _check_start(state, at, step)
    begin = state.find_range(step.axis)
    end = _find_end(state, at, step)
    state.lose_positions(at, [step.axis])
    state.contacts |= dict.fromkeys(step.contact_names)
    if begin is None or end is None:
        return Span(0.0, None)
    return _take_way(state, at, step, _ProbeWay(begin, end, speed, overtravel))


@dataclass(frozen=True, slots=True)
class _ProbeWay:
    """Where a probe begins and ends, as motor positions; its speed, and how far it goes on behind the contact at
    most, in the unit of its axis."""

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


def _find_overtravel(state: ForecastState, step: Probe, axis: Axis, speed: float) -> Fraction:
    """How far the axis goes on behind the contact at most, in its unit; 0 without its controller, which alone knows
    that. Raises `Refusal` where it does not stop the axis by that input."""
    abilities = state.probes.get(controller_of(step.axis))
    if abilities is None:
        state.notes[f"the controller of {step.axis} stops it by {step.until}"] = None
        return Fraction(0)
    ability = abilities.require_ability(state.fleet, step)
    overtravel = abs(Fraction(find_overtravel(ability, axis, speed)) / axis.scale)
    state.notes[f"{step.axis} goes on by at most {float(overtravel):.3g} {axis.unit} behind the contact"] = None
    return overtravel


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


def _find_end(state: ForecastState, at: ForecastContext, step: Probe) -> ContactRange | None:
    """Where a probe ends that touches nothing; None: it is not known."""
    if step.measured:
        return check_measured(state, at, step, "to")[step.axis]
    ((name, value),) = step.to.items()
    if is_position_name(value):
        state.note_unknown_positions(step)
        return None
    field = TargetField("to", name, state.fleet.axis(name))
    amount = state.parse_amount(at, value, field)
    if amount is None:
        return None
    take_target(state, at, MoveWays(), field, amount)
    return state.find_range(name)


def _take_way(state: ForecastState, at: ForecastContext, step: Probe, way: _ProbeWay) -> Span:
    """Check what the axis goes on behind a contact at the end, and where it may be afterwards."""
    field, offset = TargetField("to", step.axis, state.fleet.axis(step.axis)), state.axes[step.axis].offset
    state.contacts |= dict.fromkeys(step.contact_names, way.contact)
    state.ranges[step.axis] = way.rest
    for farthest in way.rest:
        if farthest not in way.contact:
            check_target(state, at, field, farthest, offset)
    distance = max(abs(end - begin) for end in way.end for begin in way.begin)
    return Span(0.0, find_longest_s(field.axis, float(distance), way.speed))
