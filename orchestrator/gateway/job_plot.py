"""Recordings as curves: one step over the time after its T0, or all motion steps of a job over one time."""

from collections.abc import Mapping, Sequence
from typing import Any

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.jobs.service import JobShown
from orchestrator.model.report import AxisRecording, StepRecording
from orchestrator.model.steps.kinds import MOTION_STEPS
from orchestrator.model.steps.order import StepOrder, StepPlace

MAX_PLOTTED_STEPS = 200  # motion steps of a job, the last ones
PLAN_POINTS = 400  # of one step
MIN_PLAN_POINTS = 12  # of one step among many
MAX_POINTS = 4000  # of an axis
DIGITS = 6

Curve = dict[str, list[float]]


def draw_step(recording: StepRecording) -> dict[str, Any]:
    """Planned and polled motor positions of each axis over the seconds after T0 of the step."""
    t0_ns = recording.t0_fleet_ns
    return {name: _draw_axis(axis, t0_ns, t0_ns, PLAN_POINTS) for name, axis in recording.axes.items()}


def find_plotted_steps(shown: JobShown) -> tuple[list[StepPlace], int]:
    """The last motion steps of a job that have begun, in their order, those to points of scans too; and how many steps
    before them are left out."""
    if shown.job is None or shown.entry is None:
        return [], 0
    order = StepOrder(shown.job.steps, shown.entry.terms.repeat)
    places: list[StepPlace] = []
    first, end = shown.entry.from_step, min(len(order), _find_end(shown))
    for index in range(end - 1, first - 1, -1):
        location = order.locate(index)
        if location.kind in MOTION_STEPS:
            if len(places) == MAX_PLOTTED_STEPS:
                return places[::-1], index - first + 1
            places.append(location)
    return places[::-1], 0


def _find_end(shown: JobShown) -> int:
    """The index after the last step that has begun."""
    if shown.report is not None:
        return max((step.index + max(1, step.steps_done) for step in shown.report.steps), default=0)
    return 0 if shown.progress is None or shown.progress.state == "queued" else shown.progress.step + 1


def draw_job_steps(recordings: Sequence[tuple[StepPlace, StepRecording]]) -> dict[str, Any]:
    """Planned and polled motor positions of all axes over the seconds after T0 of the first step, and when each step
    moved. recordings: at least one, in the order of the steps."""
    first_ns = recordings[0][1].t0_fleet_ns
    points = max(MIN_PLAN_POINTS, min(PLAN_POINTS, MAX_POINTS // len(recordings)))
    steps: list[dict[str, Any]] = []
    axes: dict[str, dict[str, Any]] = {}
    for location, recording in recordings:
        begun_s = (recording.t0_fleet_ns - first_ns) / NS_PER_S
        lasts_s = max((axis.profile.duration_s for axis in recording.axes.values()), default=0.0)
        entry = {"index": location.index, "name": recording.name, "text": location.describe(kinds=False)}
        steps.append({**entry, "t0": round(begun_s, DIGITS), "t1": round(begun_s + lasts_s, DIGITS)})
        for name, axis in recording.axes.items():
            drawn_axis = _draw_axis(axis, recording.t0_fleet_ns, first_ns, points)
            known_axis = axes.setdefault(name, {"unit": axis.unit, "planned": _no_curve(), "actual": _no_curve()})
            for kind in ("planned", "actual"):
                _extend_curve(known_axis[kind], drawn_axis[kind])
    for axis in axes.values():
        _thin_out(axis["planned"])
        _thin_out(axis["actual"])
    return {"t0_fleet_ns": first_ns, "steps": steps, "axes": axes}


def list_samples(recording: StepRecording, name: str, axis: AxisRecording) -> list[list[Any]]:
    """A row for each polled position of an axis, for a table."""
    evaluate, start, scale = axis.profile.make_evaluator(), axis.profile.start_counts, axis.counts_per_unit
    rows: list[list[Any]] = []
    for at_ns, counts in axis.sampled:
        after_s = (at_ns - recording.t0_fleet_ns) / NS_PER_S
        planned_position = (start + evaluate(after_s).position) / scale
        rows.append(
            [recording.step, name, axis.unit, at_ns, after_s, round(planned_position, 9), round(counts / scale, 9)]
        )
    return rows


def _draw_axis(axis: AxisRecording, t0_ns: int, zero_ns: int, points: int) -> dict[str, Any]:
    """An axis over the seconds after `zero_ns`. points: of the plan."""
    evaluate, duration_s = axis.profile.make_evaluator(), axis.profile.duration_s
    instants = [duration_s * number / points for number in range(points + 1)]
    start, scale, begun_s = axis.profile.start_counts, axis.counts_per_unit, (t0_ns - zero_ns) / NS_PER_S
    return {
        "unit": axis.unit,
        "planned": {
            "t": [round(begun_s + instant, DIGITS) for instant in instants],
            "v": [round((start + evaluate(instant).position) / scale, DIGITS) for instant in instants],
        },
        "actual": {
            "t": [round((at_ns - zero_ns) / NS_PER_S, DIGITS) for at_ns, _ in axis.sampled],
            "v": [round(counts / scale, DIGITS) for _, counts in axis.sampled],
        },
    }


def _no_curve() -> Curve:
    return {"t": [], "v": []}


def _extend_curve(curve: Curve, addition: Mapping[str, list[float]]) -> None:
    """Append what is later: a step is recorded from its arming on, when the one before it still moves."""
    last_s = curve["t"][-1] if curve["t"] else float("-inf")
    for at_s, value in zip(addition["t"], addition["v"], strict=True):
        if at_s > last_s:
            curve["t"].append(at_s)
            curve["v"].append(value)


def _thin_out(curve: Curve) -> None:
    """Keep at most `MAX_POINTS`, with the last one."""
    stride = -(-len(curve["t"]) // (MAX_POINTS - 1))
    if stride > 1:
        for key in ("t", "v"):
            curve[key] = [*curve[key][:-1:stride], curve[key][-1]]
