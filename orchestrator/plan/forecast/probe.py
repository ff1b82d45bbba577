"""The forecast of a probe: the whole way to its end, and what its axis goes on there behind a contact."""

from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.names import controller_of, is_position_name
from orchestrator.model.steps.probe import Probe
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.measured import take_measured
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import check_target, take_target
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.play import require_no_play
from orchestrator.plan.probes import ContactRange, find_longest_s, find_overtravel, find_probe_speed
from orchestrator.plan.racks import require_single_motor


def forecast_probe(state: ForecastState, at: ForecastContext, step: Probe) -> Span:
    """Run a probe forward: its axis is somewhere on its way afterwards."""
    field_place = ("to", step.axis)
    axis = state.find_axis(at, step.axis, field_place, "axis")
    if axis is None or not state.check_name(at, step.until, "input"):
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
    state.contacts |= dict.fromkeys(step.contact_names)
    longest_s = _take_way(state, at, step, (speed, overtravel))
    state.lose_positions(at, [step.axis])
    return Span(0.0, longest_s)


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


def _take_way(state: ForecastState, at: ForecastContext, step: Probe, motion: tuple[float, Fraction]) -> float | None:
    """Check the end of the way, and what the axis goes on there; return how long it takes at most, s. motion: speed and
    overtravel."""
    if step.measured:
        take_measured(state, at, step, "to")
        return None
    ((name, value),) = step.to.items()
    if is_position_name(value):
        state.note_unknown_positions(step)
        return None
    field = TargetField("to", name, state.fleet.axis(name))
    amount = state.parse_amount(at, value, field)
    if amount is None:
        return None
    state_before = state.find_state(at, name)
    take_target(state, at, MoveWays(), field, amount)
    state_after = state.axes[name]
    if not state_before.known or not state_after.known:
        return None
    ends = sorted((state_before.motor, state_after.motor))
    state.contacts |= dict.fromkeys(step.contact_names, ContactRange(*ends))
    distance, (speed, overtravel) = state_after.motor - state_before.motor, motion
    farthest = state_after.motor + (overtravel if distance >= 0 else -overtravel)
    check_target(state, at, field, farthest, state_after.offset)
    return find_longest_s(field.axis, float(distance), speed)
