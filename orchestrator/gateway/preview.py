"""A drawing of a job before it runs: the planned position of each axis over time, as the forecast plans it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.parts import join_at_once
from orchestrator.model.positions.entries import PositionEntry
from orchestrator.model.positions.resolve import PositionResolver
from orchestrator.model.profile import Profile
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.numbers import name_step
from orchestrator.model.steps.order import StepOrder, StepPlace
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.flying.line_plan import plan_lines
from orchestrator.plan.flying.path import FlightPath
from orchestrator.plan.forecast.job import JobForecaster
from orchestrator.plan.forecast.line import find_first_part
from orchestrator.plan.forecast.ways import ForecastMotion

MAX_STEPS = 1000  # that are drawn
POINTS_PER_SEGMENT, MAX_POINTS = 6, 4000
DIGITS = 4

Lines = dict[str, dict[str, Any]]


def draw_parts(
    fleet: Fleet, positions: Sequence[PositionEntry], axes: Mapping[str, AxisForecast], parts: Sequence[bytes]
) -> bytes:
    """`draw_job` of a job in parts, as JSON."""
    return json.dumps(draw_job(fleet, positions, axes, join_at_once(parts))).encode()


def draw_job(
    fleet: Fleet, positions: Sequence[PositionEntry], axes: Mapping[str, AxisForecast], job: Job, repeat: int = 1
) -> dict[str, Any]:
    """The preview of a job that begins with `axes`; see the HTTP reference for its fields."""
    drawing = _Drawing(fleet, axes)
    try:
        order = StepOrder(PositionResolver(fleet, positions).resolve_steps(job.steps), repeat)
    except Refusal as error:
        drawing.note_gap(0, error.text)
        return drawing.finish()
    index = 0
    while index < min(len(order), MAX_STEPS):
        location, steps_drawn = order.locate(index), 1
        try:
            step, steps_drawn = _choose_step(fleet, location)
            drawing.take(index, step)
        except Refusal as error:
            drawing.note_gap(index, error.text)
        index += steps_drawn
    if len(order) > MAX_STEPS:
        drawing.note_gap(MAX_STEPS, f"only the first {MAX_STEPS} of {len(order)} steps are drawn")
    return drawing.finish()


def draw_path(
    fleet: Fleet, positions: Sequence[PositionEntry], axes: Mapping[str, AxisForecast], location: StepPlace
) -> dict[str, Any]:
    """The path of one step as a preview, from where it begins: the axes may stand elsewhere by now; of a scan that
    flies, the lines that are flown together. Raises `Refusal` for a step that is none."""
    if not location.is_path:
        raise Refusal("no-path", f"{location.describe()} is no path", "choose the step of a path")
    (path,) = PositionResolver(fleet, positions).resolve_steps([location.step])
    path, _ = _choose_step(fleet, replace(location, step=path))
    drawing = _Drawing(fleet, {name: axis.model_copy(update={"known": False}) for name, axis in axes.items()})
    drawing.take(location.index, path)
    return drawing.finish()


def _choose_step(fleet: Fleet, place: StepPlace) -> tuple[Step, int]:
    """The step that runs at a place, and for how many it stands: of lines of a scan that are flown together, the first
    one stands for all. Raises `Refusal`."""
    if not place.is_flown_path or place.scan is None or place.point is None:
        return place.choose_step(partial(_find_motion, fleet, place)), 1
    lines = plan_lines(place.scan, fleet)
    part = find_first_part(fleet, lines, place.point)
    if part is None:
        return lines.make_path(place.point), 1
    line_count = (part.end - part.first) // lines.count
    return FlightPath.make(part), (line_count - 1) * place.scan.points_steps + 1


def _find_motion(fleet: Fleet, place: StepPlace, scan: Scan) -> Step:
    """The move to a point of a scan, or to the beginning of a line that is flown. Raises `Refusal`."""
    assert place.point is not None
    if scan.points is not None:
        raise Refusal("not-drawn", "points that were sent as a table are not drawn")
    if scan.fly is not None:
        return plan_lines(scan, fleet).make_move(place.point)
    units = [fleet.unit_of(name) for name in scan.axis_names]
    position = scan.grid.find_position(place.point, units)
    return scan.make_move(dict(zip(scan.axis_names, map(float, position), strict=True)))


class _Drawing:
    def __init__(self, fleet: Fleet, axes: Mapping[str, AxisForecast]) -> None:
        self._fleet = fleet
        self._forecaster = JobForecaster(fleet, axes)
        self._now_s = 0.0
        self._lines: Lines = {}
        self._steps: list[dict[str, Any]] = []
        self._gap = ""

    def take(self, index: int, step: Step) -> None:
        axes_before = dict(self._forecaster.axes)
        forecast = self._forecaster.take(index, step)
        begun_s = self._now_s
        motion = self._forecaster.motion
        if motion is not None:
            self._draw_motion(motion, axes_before)
        elif step.is_motion:
            self.note_gap(index, "it begins at a position that only the machine knows")
        self._now_s += forecast.least_s
        if forecast.most_s is None or forecast.most_s > forecast.least_s:
            self.note_gap(index, f"{step.describe()} takes a time that only the machine knows")
        entry = {"index": index, "text": forecast.text, "t0": round(begun_s, 6), "t1": round(self._now_s, 6)}
        self._steps.append(entry)

    def note_gap(self, index: int, why: str) -> None:
        """Note why a part is not drawn as it will be; the first one is shown."""
        self._gap = self._gap or f"{name_step(index)}: {why}"

    def finish(self) -> dict[str, Any]:
        for line in self._lines.values():
            _thin_out(line)
        return {
            "duration_s": round(self._now_s, 6),
            "steps": self._steps,
            "axes": self._lines,
            "unknown": self._gap or None,
        }

    def _draw_motion(self, motion: ForecastMotion, before: Mapping[str, AxisForecast]) -> None:
        for name, profile in motion.plan.profiles.items():
            axis = self._fleet.axis(name)
            line = self._lines.setdefault(name, {"unit": axis.unit, "t": [], "v": []})
            offset = float(before[name].offset) if name in before else 0.0
            evaluate = profile.make_evaluator()
            for time_s in _choose_instants(profile):
                counts = profile.start_counts + evaluate(time_s).position
                line["t"].append(round(self._now_s + time_s, 6))
                line["v"].append(round(axis.to_unit(counts) + offset, DIGITS))


def _choose_instants(profile: Profile) -> list[float]:
    """Instants at which a profile is drawn, s: its corners, and some between them."""
    instants = [0.0]
    for segment in profile.segments:
        step_s = segment.duration_s / POINTS_PER_SEGMENT
        instants += [segment.start_s + step_s * (number + 1) for number in range(POINTS_PER_SEGMENT)]
    return instants


def _thin_out(line: dict[str, Any]) -> None:
    """Keep at most `MAX_POINTS` of a line, with its last one."""
    every = -(-len(line["t"]) // MAX_POINTS)
    if every > 1:
        for key in ("t", "v"):
            line[key] = [*line[key][:-1:every], line[key][-1]]
