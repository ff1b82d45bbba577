"""Keep-out zones in a forecast: what is refused ahead, what depends on the world, and what is not checked."""

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.steps.base import InnerSteps, Step
from orchestrator.model.steps.move import Move
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.course import Timing
from orchestrator.plan.zones.refusals import make_refusal


def check_zones(state: ForecastState, at: ForecastContext, step: Move, ways: MoveWays) -> None:
    """Check a move that was planned. What depends on positions that only the world knows is a condition."""
    zones, plan = state.zones, ways.plan
    state.zones_checked = True
    if zones is None or plan is None:
        return
    step_axes = step.find_axes(state.fleet)
    adrift = [name for name in step_axes if name not in ways.exact]
    profiles = {name: profile for name, profile in plan.profiles.items() if name in ways.exact}
    skews_ns = (step.max_start_skew, step.max_end_skew, step.max_path_skew)
    timing = Timing(state.alone, max(skew_ns or 0 for skew_ns in skews_ns) / NS_PER_S)
    course = zones.make_course(profiles, _find_positions(state, adrift), timing, adrift)
    for violation in zones.find_violations(course):
        open_axes = [
            name for name in course.unknown if name in violation.rule.constraint.axes and _is_open(state, name)
        ]
        if open_axes:
            axes, verb = ", ".join(open_axes), "stands" if len(open_axes) == 1 else "stand"
            state.notes[f"{axes} {verb} where zone {violation.rule.name} allows it"] = None
        else:
            state.add_problem(at, (), make_refusal(zones, course, violation))


def _find_positions(state: ForecastState, adrift: list[str]) -> Box:
    """Between what motor positions the axes that rules depend on stand, as far as that is known."""
    positions: dict[str, tuple[float, float]] = {}
    zones = state.zones
    for name in () if zones is None else zones.ranges:
        axis = state.axes.get(name)
        if name in adrift or axis is None or axis.referenced is False:
            continue
        known_range = state.find_range(name)
        if known_range is not None:
            positions[name] = float(known_range.low), float(known_range.high)
    return positions


def _is_open(state: ForecastState, name: str) -> bool:
    """Whether the run may find an axis at a place where a rule is kept: one that is not referenced has none."""
    axis = state.axes.get(name)
    return axis is None or axis.referenced is not False


def note_unchecked(state: ForecastState, step: Step) -> None:
    """Say of a step that moves axes on which rules depend that it was not checked. Steps inside it say it of
    themselves."""
    zones = state.zones
    if zones is None or state.zones_checked or step.inner is not None or not step.moves:
        return
    axes = [name for name in step.find_axes(state.fleet) if name in zones.ranges]
    if axes:
        state.notes[f"not checked against zones: {step.kind} of {', '.join(axes)}"] = None


def note_unchecked_passes(state: ForecastState, inner: InnerSteps, checked: int) -> None:
    """Say that passes between the first ones and the last, which differ in their targets, were not checked."""
    if state.zones is not None:
        state.notes[f"not checked against zones {inner.word} {checked + 1} to {inner.times - 1}"] = None
