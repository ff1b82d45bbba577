"""The forecast of the lines of a scan that flies."""

from dataclasses import replace
from fractions import Fraction
from math import ceil

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import StepProblem
from orchestrator.model.names import controller_of
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.flying.line_plan import plan_lines
from orchestrator.plan.flying.line_room import check_room
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.path import (
    ChunkAbility,
    FlightPath,
    FlownPart,
    choose_part,
    list_members,
)
from orchestrator.plan.flying.straight import StraightLines
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.io import forecast_wait
from orchestrator.plan.forecast.path import forecast_path
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.zones import ZoneArea, check_area

USUAL_CHUNKS = ChunkAbility(7.5, switches=True, shows=True)  # of the makes that load paths in chunks
SLOWER = 0.002  # of the speed, by which a plan may be slower in a window


def take_lines(state: ForecastState, at: ForecastContext, step: Scan) -> FlownLines | None:
    """The lines of a scan that flies; None, and a problem, if it cannot be flown."""
    try:
        lines = plan_lines(step, state.fleet)
        axis_states = {name: state.find_state(at, name) for name in step.flown_axes}
        offsets = {name: axis.offset for name, axis in axis_states.items() if axis.offset_kind != "unknown"}
        if isinstance(lines, StraightLines):
            check_room(lines, state.fleet, offsets.get)
    except Refusal as error:
        state.add_problem(at, ("fly",), error)
        return None
    return lines


def forecast_lines(state: ForecastState, at: ForecastContext, lines: FlownLines, between: Span, area: ZoneArea) -> Span:
    """Run the first motion of a scan that flies forward, of all its lines or the first one, and say how they are flown;
    the axes are left where all lines leave them. between: the moves between lines that are flown one by one. area: in
    which its axes are."""
    abilities = {name: state.chunks.get(name, USUAL_CHUNKS) for name in list_members(lines)}
    wait = None if lines.scan.fly is None else lines.scan.fly.wait
    if wait is not None:
        waiting_span = forecast_wait(state, replace(at, place=(*at.place, "fly", "wait")), wait)
        between = between.followed_by(waiting_span, lines.line_count)
    try:
        part, reason = choose_part(lines, state.fleet, 0, abilities)
    except Refusal as error:
        state.add_problem(at, ("fly",), error)
        return between
    problems = len(state.problems)
    _check_lines(state, part, lines, area)
    if part is not None and lines.scan.is_curved:
        is_known = all(name in state.chunks for name in abilities)
        condition = "" if is_known else ", where all its controllers load paths in chunks"
        return _forecast_curve(state, at, part, condition)
    line = _forecast_motion(state, at, lines, lines.make_path(0))
    singly = line.followed_by(line, lines.line_count - 1).followed_by(between)
    if len(state.problems) > problems:
        return singly
    if part is None:
        _note_words(
            state, lines, f"a line takes {line.least:.3f} s" + f"; line by line: {reason}" * (lines.line_count > 1)
        )
        return singly
    flown_span = _forecast_motion(state, at, lines, FlightPath.make(part))
    parts = lines.scan.point_count / (part.end - part.first)
    together_s = flown_span.least * parts
    words = f"{lines.line_count} lines are one motion of {together_s:.3f} s, with rounded turn-arounds"
    if part.end < lines.scan.point_count:
        words = (
            f"{lines.line_count} lines are {ceil(parts)} motions of {flown_span.least:.1f} s, with rounded turn-arounds"
        )
    if all(name in state.chunks for name in abilities):
        _note_words(state, lines, words)
        return Span(together_s, together_s)
    _note_words(
        state, lines, f"{words}; line by line where a controller loads no path in chunks, {line.least:.3f} s each"
    )
    most_s = None if singly.most is None else max(together_s, singly.most)
    return Span(min(together_s, singly.least), most_s)


def _check_lines(state: ForecastState, part: FlownPart | None, lines: FlownLines, area: ZoneArea) -> None:
    """Check all lines by their area, unless they are one motion, which is checked along its way."""
    if part is None or part.end - part.first < lines.scan.point_count:
        check_area(state, area, "lines")


def _forecast_curve(state: ForecastState, at: ForecastContext, part: FlownPart, condition: str) -> Span:
    """Run the first motion along curves forward. condition: on which it is flown."""
    lines, problems = part.lines, len(state.problems)
    flown_span = _forecast_motion(state, at, lines, FlightPath.make(part))
    if len(state.problems) > problems:
        return flown_span
    parts = lines.scan.point_count / (part.end - part.first)
    words = f"it takes {flown_span.least:.3f} s with a run-up and a run-down"
    if lines.line_count > 1:
        words = f"{lines.line_count} curves are {ceil(parts)} motions of {flown_span.least:.3f} s"
    _note_words(state, lines, words + condition)
    return Span(flown_span.least * parts, flown_span.least * parts)


def find_first_part(fleet: Fleet, lines: FlownLines, point: int) -> FlownPart | None:
    """The lines of a scan from a point on that are flown in one motion, as far as the fleet file says; None: each is
    flown by itself."""
    return choose_part(lines, fleet, point, dict.fromkeys(list_members(lines), USUAL_CHUNKS))[0]


def _forecast_motion(state: ForecastState, at: ForecastContext, lines: FlownLines, path: FollowPath) -> Span:
    """Run a motion through lines forward from where it begins; the axes are left where they were."""
    axes_after = {name: state.find_state(at, name) for name in path.axes}
    for (name, axis_state), begin in zip(axes_after.items(), path.start, strict=True):
        motor = Fraction(str(begin)) - axis_state.offset
        state.axes[name] = axis_state.model_copy(update={"motor": motor, "known": True})
    problems = len(state.problems)
    span = forecast_path(state, at, path)
    state.axes |= axes_after
    state.problems[problems:] = map(_name_trigger, state.problems[problems:])
    if state.motion is not None and state.motion.path is not None and len(state.problems) == problems:
        if not isinstance(path, FlightPath) and isinstance(lines, StraightLines):
            _check_speed(state, at, lines)
        state.motion = replace(state.motion, line=path)
    return span


def _note_words(state: ForecastState, lines: FlownLines, how: str) -> None:
    """Say how lines are flown."""
    assert state.motion is not None
    state.motion = replace(state.motion, line_words=f"{lines.describe()}; {how}")


def _name_trigger(problem: StepProblem) -> StepProblem:
    """A problem of the trigger of a path, where the scan has it."""
    if problem.place[-1] != "triggers":
        return problem
    keys = [*problem.place[:-1], "fly", "trigger"]
    return problem.model_copy(update={"place": keys, "text": problem.text.replace("triggers.0", "fly.trigger")})


def _check_speed(state: ForecastState, at: ForecastContext, lines: StraightLines) -> None:
    """Add a problem if the plan of a line is slower in a window."""
    assert state.motion is not None and state.motion.path is not None
    lead = lines.lead_axis
    speed, path = lines.find_speed(lead), state.motion.path
    times_s, speeds = path.times_s, path.speeds[lead.name]
    middle_s = state.motion.plan.duration_s / 2
    in_windows = np.abs(times_s - middle_s) < lines.count * lines.window_s / 2
    least = float(speeds[in_windows].min(initial=speed))
    if least < speed * (1 - SLOWER):
        unit = lines.units[-1]
        text = f"{lead.name} would fly at {least:g} {unit}/s in a window, instead of {speed:g} {unit}/s"
        state.add_problem(at, ("fly",), Refusal("fly-speed", text, "fly slower", controller_of(lead.name)))
