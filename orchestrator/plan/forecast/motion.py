"""Parts of forecasts that motions share: the plan of their ways, and their triggers."""

from dataclasses import replace

from orchestrator.model.errors import Refusal
from orchestrator.model.steps.base import MotionOptions
from orchestrator.model.steps.kinds import Motion
from orchestrator.plan.flying.path import FlightPath, place_triggers
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.pairs import bound_pairs
from orchestrator.plan.racks import bound_racks
from orchestrator.plan.shape import PlanError
from orchestrator.plan.speeds import plan_motion
from orchestrator.plan.triggers import MAX_CHUNKED_INSTANTS, MAX_INSTANTS, resolve_triggers


def plan_ways(state: ForecastState, at: ForecastContext, step: MotionOptions, ways: MoveWays) -> Span:
    """The duration of a motion; its plan stays in `ways`."""
    try:
        plan = longest = plan_motion(state.fleet, step, ways.nearest)
        if ways.bounded and ways.farthest != ways.nearest:
            longest = plan_motion(state.fleet, step, ways.farthest)
    except PlanError as error:
        state.add_problem(at, (), Refusal("plan", str(error)))
        return Span()
    except Refusal as error:
        state.add_problem(at, (), error)
        return Span()
    state.racks = bound_racks(state.fleet, plan)
    ways.plan = plan
    try:
        state.pairs = bound_pairs(state.fleet, plan, state.alone)
    except Refusal as error:
        state.add_problem(at, (), error)
    return Span(plan.duration_s, longest.duration_s if ways.bounded else None)


def check_record(state: ForecastState, at: ForecastContext, step: Motion) -> None:
    """Check the names of the axes that a motion records."""
    if step.record is not None:
        state.expand_names(at, step.record.axes, ("record", "axes"))


def check_triggers(state: ForecastState, at: ForecastContext, step: Motion) -> None:
    """Check outputs and units of triggers, and their instants where the motion is known."""
    try:
        resolved_triggers = resolve_triggers(state.fleet, step.triggers, lambda axis: state.find_state(at, axis).offset)
        if state.motion is not None:
            if isinstance(step, FlightPath):
                resolved_triggers = place_triggers(step.part, resolved_triggers)
            most = MAX_CHUNKED_INSTANTS if step.follows_path else MAX_INSTANTS
            for trigger in resolved_triggers:
                trigger.find_instants_ns(state.motion.plan, most)
            state.motion = replace(state.motion, triggers=resolved_triggers)
    except Refusal as error:
        state.add_problem(at, ("triggers",), Refusal(error.code, error.text, error.remedy))
