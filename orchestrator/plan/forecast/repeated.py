"""Steps that run several times: passes of a repeat, points of a scan.

The first passes are run forward, the others follow from what these differ in, and the last one is run forward again.
"""

from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import NamedTuple

from orchestrator.model.fleet import Axis
from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.model.steps.base import InnerSteps, Step
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.kinds import forecast_step
from orchestrator.plan.forecast.passes import (
    RUN_PASSES,
    LaterTarget,
    TargetCheck,
    find_first_pass,
    find_last_state,
    find_later_targets,
    find_range,
    group_by_axis,
)
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState, unknown_position
from orchestrator.plan.forecast.targets import check_room, check_target, exceeds_room
from orchestrator.plan.forecast.zones import note_unchecked_passes
from orchestrator.plan.targets import explain_beyond_limits, explain_beyond_range

Forecasting = Generator[None, None, Span]
"""A forecast with a break before each step, for the other work of a process."""


class _Pass(NamedTuple):
    """One pass of repeated steps: the targets that were checked, the axes after it, its duration, new problems."""

    checks: list[TargetCheck]
    axes: dict[str, AxisForecast]
    span: Span
    problems: int


def forecast_in_parts(state: ForecastState, at: ForecastContext, step: Step) -> Forecasting:
    """Run one step forward, and those inside it as often as they run."""
    yield
    span = forecast_step(state, at, step)
    if step.inner is not None:
        outer_area, state.scanned = state.scanned, {**state.scanned, **state.scan_area}
        span = span.followed_by((yield from _run_passes(state, at, step.inner)))
        state.scanned = outer_area
    return span


def _run_passes(state: ForecastState, at: ForecastContext, inner: InnerSteps) -> Forecasting:
    """Run steps forward as often as they run: the first passes, the others by what these differ in, and the last."""
    times, passes, total = inner.times, list[_Pass](), Span()

    def describe_pass(number: int) -> str:
        return f", {inner.word} {number} of {times}{at.when}"

    for number in range(1, min(times, RUN_PASSES) + 1):
        pass_text = describe_pass(number) if number > 1 else at.when
        passes.append((yield from _run_pass(state, at, inner, pass_text)))
        total = total.followed_by(passes[-1].span)
        if passes[-1].problems:
            return total  # it would be there in every pass
    if times <= RUN_PASSES:
        return total
    third, problems = passes[-1].span, len(state.problems)
    _skip_passes(state, at, passes, times - 1, describe_pass)
    if len(state.problems) > problems:
        return total
    targets = find_later_targets(passes[1].checks, passes[2].checks)
    if not any(target.drift or target.offset_drift for target in targets):
        return total.followed_by(third, times - RUN_PASSES)
    note_unchecked_passes(state, inner, RUN_PASSES)
    last = (yield from _run_pass(state, at, inner, describe_pass(times))).span
    span_between = third
    if last != third:
        # A way that changes from pass to pass is longest at one end; it may be nothing in between.
        most = None if third.most is None or last.most is None else max(third.most, last.most)
        span_between = Span(0.0, most)
    return total.followed_by(span_between, times - RUN_PASSES - 1).followed_by(last)


def _run_pass(state: ForecastState, at: ForecastContext, inner: InnerSteps, when: str) -> Generator[None, None, _Pass]:
    """Run steps forward once."""
    context, problems, span = at.in_pass(when), len(state.problems), Span()
    for number, step in enumerate(inner.steps):
        span = span.followed_by((yield from forecast_in_parts(state, context.at_inner(inner.key, number), step)))
    at.checks.extend(context.checks)
    return _Pass(context.checks, dict(state.axes), span, len(state.problems) - problems)


def _skip_passes(
    state: ForecastState, at: ForecastContext, passes: Sequence[_Pass], times: int, describe_pass: Callable[[int], str]
) -> None:
    """Go on from the third pass to pass `times`."""
    _, (second, forecasts_before, _, _), (third, forecasts_after, _, _) = passes
    for name, targets in group_by_axis(find_later_targets(second, third)).items():
        axis, reached_forecast = state.fleet.axis(name), forecasts_after[name]
        problems = len(state.problems)
        for number, check in _find_leaving_targets(axis, targets, times).values():
            context, field = _find_field(at, axis, check, describe_pass(number))
            check_target(state, context, field, check.target, check.offset)
        # A position that was lost in each pass is no common beginning.
        is_lost = reached_forecast.since > at.index
        targets_apart = [target for target in targets if not target.check.known and not is_lost]
        number = (
            find_first_pass(times, partial(_leaves_room, axis, reached_forecast, targets_apart))
            if targets_apart
            else None
        )
        if number is not None:
            context, field = _find_field(at, axis, targets_apart[-1].check, describe_pass(number))
            lowest, highest = find_range(reached_forecast, targets_apart, number)
            farther_forecast = reached_forecast.model_copy(update={"lowest": lowest, "highest": highest})
            check_room(state, context, field, farther_forecast)
        state.axes[name] = find_last_state(forecasts_before[name], reached_forecast, targets_apart, times)
        if len(state.problems) > problems:
            state.axes[name] = reached_forecast.model_copy(update=unknown_position(at))
        at.checks.extend(target.in_pass(times) for target in targets)


def _find_field(at: ForecastContext, axis: Axis, check: TargetCheck, when: str) -> tuple[ForecastContext, TargetField]:
    """The step of a target that was checked, at another pass, and the field of the target in it."""
    return at.at_place(check.place[:-2], when), TargetField(str(check.place[-2]), check.axis, axis)


def _find_leaving_targets(
    axis: Axis, targets: Sequence[LaterTarget], times: int
) -> dict[tuple[str | int, ...], tuple[int, TargetCheck]]:
    """By place: the first pass in which a target is out of reach, and that target."""
    leaving: dict[tuple[str | int, ...], tuple[int, TargetCheck]] = {}
    for target in targets:
        if target.check.known and (target.drift or target.offset_drift):
            number = find_first_pass(times, partial(_leaves_limits, axis, target))
            if number is not None and number < leaving.get(target.check.place, (times + 1, None))[0]:
                leaving[target.check.place] = number, target.in_pass(number)
    return leaving


def _leaves_limits(axis: Axis, target: LaterTarget, number: int) -> bool:
    check = target.in_pass(number)
    beyond_limits = explain_beyond_limits(check.axis, axis, check.target, check.offset)
    return (beyond_limits or explain_beyond_range(check.axis, axis, check.target)) is not None


def _leaves_room(axis: Axis, state: AxisForecast, targets: Sequence[LaterTarget], number: int) -> bool:
    return exceeds_room(axis, find_range(state, targets, number))
