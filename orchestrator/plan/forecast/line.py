"""The forecast of the lines of a scan that flies."""

from dataclasses import replace
from fractions import Fraction

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.forecast import StepProblem
from orchestrator.model.names import controller_of
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.flying.lines import FlownLines, check_room, plan_lines
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.path import forecast_path
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState

SLOWER = 0.002  # of the speed, by which a plan may be slower in a window


def take_lines(state: ForecastState, at: ForecastContext, step: Scan) -> FlownLines | None:
    """The lines of a scan that flies; None, and a problem, if it cannot be flown."""
    try:
        lines = plan_lines(step, state.fleet)
        axis_state = state.find_state(at, lines.axis)
        if axis_state.offset_kind != "unknown":
            check_room(lines, state.fleet.axis(lines.axis), axis_state.offset)
    except Refusal as error:
        state.add_problem(at, ("fly",), error)
        return None
    return lines


def forecast_line(state: ForecastState, at: ForecastContext, lines: FlownLines) -> Span:
    """Run the first line forward, and say how it is flown; the axis is left where all lines leave it."""
    name = lines.axis
    axis_after, problems = state.find_state(at, name), len(state.problems)
    begin = Fraction(str(lines.ends.begin)) - axis_after.offset
    state.axes[name] = axis_after.model_copy(update={"motor": begin, "known": True})
    path = lines.make_path(0)
    span = forecast_path(state, at, path)
    state.axes[name] = axis_after
    state.problems[problems:] = map(_name_trigger, state.problems[problems:])
    if state.motion is None or state.motion.path is None or len(state.problems) > problems:
        return span
    _check_speed(state, at, lines)
    unit = lines.units[-1]
    words = (
        f"{name} flies through {lines.count} points at {lines.speed:g} {unit}/s, {lines.window_s * 1e3:g} ms each, "
        f"with a run-up and a run-down of {lines.run_up:.4g} {unit}; a line takes {span.least:.3f} s"
    )
    state.motion = replace(state.motion, line=path, line_words=words)
    return span


def _name_trigger(problem: StepProblem) -> StepProblem:
    """A problem of the trigger of a path, where the scan has it."""
    if problem.place[-1] != "triggers":
        return problem
    keys = [*problem.place[:-1], "fly", "trigger"]
    return problem.model_copy(update={"place": keys, "text": problem.text.replace("triggers.0", "fly.trigger")})


def _check_speed(state: ForecastState, at: ForecastContext, lines: FlownLines) -> None:
    """Add a problem if the plan of a line is slower in a window."""
    assert state.motion is not None and state.motion.path is not None
    times_s, speeds = state.motion.path.times_s, state.motion.path.speeds[lines.axis]
    middle_s = state.motion.plan.duration_s / 2
    in_windows = np.abs(times_s - middle_s) < lines.count * lines.window_s / 2
    least = float(speeds[in_windows].min(initial=lines.speed))
    if least < lines.speed * (1 - SLOWER):
        unit = lines.units[-1]
        text = f"{lines.axis} would fly at {least:g} {unit}/s in a window, instead of {lines.speed:g} {unit}/s"
        state.add_problem(at, ("fly",), Refusal("fly-speed", text, "fly slower", controller_of(lines.axis)))
