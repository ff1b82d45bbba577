"""What checks each kind of step ahead."""

from collections.abc import Callable, Mapping
from typing import Any

from orchestrator.model.errors import Refusal
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.home import Home
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.latch import Latch
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.motors import Disable, Enable
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.probe import Probe
from orchestrator.model.steps.repeat import Repeat
from orchestrator.model.steps.save_position import SavePosition
from orchestrator.model.steps.scan import Scan
from orchestrator.model.steps.set_position import SetPosition
from orchestrator.model.steps.wait_armed import WaitArmed
from orchestrator.plan.flying.path import FlightPath
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.dwell import forecast_dwell
from orchestrator.plan.forecast.home import forecast_home
from orchestrator.plan.forecast.io import forecast_output, forecast_wait, forecast_wait_armed
from orchestrator.plan.forecast.latch import forecast_latch
from orchestrator.plan.forecast.live import forecast_live
from orchestrator.plan.forecast.motors import forecast_motors
from orchestrator.plan.forecast.move import forecast_move
from orchestrator.plan.forecast.path import forecast_path
from orchestrator.plan.forecast.probe import forecast_probe
from orchestrator.plan.forecast.save_position import forecast_save_position
from orchestrator.plan.forecast.scan import forecast_scan
from orchestrator.plan.forecast.set_position import forecast_set_position
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.zones import begin_zones, check_swept
from orchestrator.plan.pairs import require_whole_pairs


def _forecast_repeat(state: ForecastState, at: ForecastContext, step: Repeat) -> Span:
    """A repeat takes as long as the steps inside it, which are run forward by themselves."""
    del state, at, step
    return Span()


FORECASTERS: Mapping[type[Step], Callable[[ForecastState, ForecastContext, Any], Span]] = {
    Move: forecast_move,
    FollowPath: forecast_path,
    FlightPath: forecast_path,
    Scan: forecast_scan,
    Home: forecast_home,
    Enable: forecast_motors,
    Disable: forecast_motors,
    SetPosition: forecast_set_position,
    SavePosition: forecast_save_position,
    Dwell: forecast_dwell,
    SetOutput: forecast_output,
    WaitInput: forecast_wait,
    WaitArmed: forecast_wait_armed,
    Latch: forecast_latch,
    Probe: forecast_probe,
    Live: forecast_live,
    Repeat: _forecast_repeat,
}
"""By kind, what runs a step forward: it changes the state, notes problems and conditions, and returns the duration."""


def forecast_step(state: ForecastState, at: ForecastContext, step: Step) -> Span:
    """Run one step forward, without those inside it."""
    try:
        require_whole_pairs(state.fleet, step)
    except Refusal as error:
        state.add_problem(at, (), error)
        return Span()
    count = len(state.problems)
    begin_zones(state)
    span = FORECASTERS[type(step)](state, at, step)
    check_swept(state, at, step)
    line_text = "" if step.origin is None or step.follows_path else step.origin.describe(1)
    if line_text:  # a path names the line of the piece
        for number, problem in enumerate(state.problems[count:], count):
            state.problems[number] = problem.model_copy(update={"text": f"{line_text}: {problem.text}"})
    return span
