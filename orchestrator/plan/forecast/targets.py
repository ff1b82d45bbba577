"""Targets of axes in a forecast: where they lead, and whether that is inside the limits."""

from fractions import Fraction

from orchestrator.model.compensation import Approach
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.model.steps.numbers import name_step
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.passes import TargetCheck
from orchestrator.plan.forecast.state import ForecastState, Order, unknown_position
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.play import (
    MotorWay,
    bound_position,
    choose_approach,
    explain_overrun,
    find_motor_way,
    find_play_at_end,
)
from orchestrator.plan.step import AxisMove
from orchestrator.plan.targets import choose_turn, explain_beyond_limits, explain_beyond_range, make_axis_move


def take_target(
    state: ForecastState, at: ForecastContext, ways: MoveWays, field: TargetField, amount: Fraction
) -> None:
    """Move one axis, and add its way."""
    name, axis = field.name, field.axis
    state_before = state.find_state(at, name)
    forecast_after, distance_known = _find_target(state, at, field, amount)
    state.axes[name] = forecast_after
    order = state.order_of(name, axis)
    if distance_known:
        way = _find_way(state_before, forecast_after, axis, choose_approach(axis, ways.approach))
        _take_way(state, at, ways, field, way)
        ways.add_known(make_axis_move(name, axis, way.start, way.target, order))
        if state_before.known and forecast_after.known:
            ways.exact[name] = (forecast_after.motor, way.target)
    else:
        ways.add_unknown(_longest_move(name, axis, forecast_after, order))


def _find_way(before: AxisForecast, after: AxisForecast, axis: Axis, approach: Approach) -> MotorWay:
    start, target = (axis.to_target_counts(end.motor) for end in (before, after))
    play = before.play or axis.play
    return find_motor_way(axis, start - (0 if play is None else play.least), play, target, approach)


def _take_way(state: ForecastState, at: ForecastContext, ways: MoveWays, field: TargetField, way: MotorWay) -> None:
    """Add what the play of a drive makes of a way: where it leaves the axis, its bound, and an overrun that leads too
    far."""
    name, axis, forecast_after = field.name, field.axis, state.axes[field.name]
    bound = bound_position(axis, way)
    if bound is not None:
        state.bounds[name] = bound
    if axis.play is not None:
        state.axes[name] = forecast_after.model_copy(update={"play": find_play_at_end(axis, way)})
    beyond_overrun = explain_overrun(name, axis, way, float(forecast_after.offset)) if forecast_after.known else None
    if beyond_overrun is not None:
        state.add_problem(at, field.place, beyond_overrun)


def _find_target(
    state: ForecastState, at: ForecastContext, field: TargetField, amount: Fraction
) -> tuple[AxisForecast, bool]:
    """The state after a move, and whether the distance is known."""
    name, axis, relative = field.name, field.axis, field.key == "by"
    state_before = state.find_state(at, name)
    if relative:
        target = state_before.motor + amount
    elif state_before.offset_kind == "unknown":
        state.conditions[f"the target of {name} in {name_step(at.index)} depends on its user offset"] = None
        return state_before.model_copy(update=unknown_position(at)), False
    elif state_before.offset_kind == "motor" and not state_before.known:
        state.note_room(name, state_before)
        target = choose_turn(axis, amount - state_before.offset, amount - state_before.offset, state_before.offset)
        _note_check(at, field, target, state_before.offset, known=True)
        check_target(state, at, field, target, state_before.offset)
        state.conditions["user offsets (`set-position`) are 0 where no step sets them"] = None
        return state_before.model_copy(update={"motor": target, "known": True}), False
    else:
        target = choose_turn(axis, state_before.motor, amount - state_before.offset, state_before.offset)
    update: dict[str, object] = {"motor": target}
    _note_check(at, field, target, state_before.offset, known=state_before.known)
    if state_before.known:
        if not check_target(state, at, field, target, state_before.offset) and relative:
            update |= unknown_position(at)  # further moves by a distance would repeat the same mistake
    else:
        update |= {"lowest": min(state_before.lowest, target), "highest": max(state_before.highest, target)}
        forecast_after = state_before.model_copy(update=update)
        if not check_room(state, at, field, forecast_after):
            update |= unknown_position(at)
    return state_before.model_copy(update=update), True


def _note_check(at: ForecastContext, field: TargetField, target: Fraction, offset: Fraction, *, known: bool) -> None:
    at.checks.append(TargetCheck((*at.place, *field.place), field.name, target, offset, known))


def check_target(
    state: ForecastState, at: ForecastContext, field: TargetField, target: Fraction, offset: Fraction
) -> bool:
    """Whether an axis may be at `target`; otherwise it is a problem."""
    code, remedy = "soft-limit", "change the target, or the soft limits in the fleet file"
    text = explain_beyond_limits(field.name, field.axis, target, offset)
    if text is None:
        code, remedy = "position-range", "move the other way, or home the axis, which begins to count again"
        text = explain_beyond_range(field.name, field.axis, target)
    if text is not None:
        state.add_problem(at, field.place, Refusal(code, text, remedy, field.controller))
    return text is None


def find_offset(state: AxisForecast, begin: Fraction) -> Fraction:
    """User minus motor position of an axis that was at the motor position `begin` when its position became unknown."""
    return state.offset - begin if state.offset_kind == "start" else state.offset


def exceeds_room(axis: Axis, reached: tuple[Fraction, Fraction]) -> bool:
    """Whether the soft limits are too near to each other for all positions in a range."""
    limits = axis.soft_limits_counts
    if limits is None:
        return False
    width = abs(axis.to_position(limits[1]) - axis.to_position(limits[0]))
    return round(abs(reached[1] - reached[0]) * axis.scale) > round(width * axis.scale)


def check_room(state: ForecastState, at: ForecastContext, field: TargetField, after: AxisForecast) -> bool:
    """Whether the moves by a distance from an unknown position can stay inside the soft limits at all."""
    axis, begin = field.axis, state.ranges.get(field.name)
    if begin is not None:
        ends = (begin.low, after.lowest), (begin.high, after.highest)
        return all(
            check_target(state, at, field, motor + way, find_offset(after, motor)) for motor, way in dict.fromkeys(ends)
        )
    limits = axis.soft_limits_counts
    if limits is None or not exceeds_room(axis, (after.lowest, after.highest)):
        return True
    span = abs(float(after.highest - after.lowest))
    width = abs(axis.to_unit(limits[1]) - axis.to_unit(limits[0]))
    text = (
        f"axis {field.name}: the moves from {name_step(after.since)} (`steps[{after.since}]`) on cover "
        f"{span:g} {axis.unit}; its soft limits are {width:g} {axis.unit} apart"
    )
    remedy = "move less far, or change the soft limits"
    state.add_problem(at, field.place, Refusal("soft-limit", text, remedy, field.controller))
    return False


def _longest_move(name: str, axis: Axis, after: AxisForecast, order: Order) -> AxisMove | None:
    """The move from the farther soft limit; None without limits."""
    limits = axis.soft_limits_counts
    if limits is None or not after.known:
        return None
    target = axis.to_target_counts(after.motor)
    return make_axis_move(name, axis, max(limits, key=lambda end: abs(end - target)), target, order)
