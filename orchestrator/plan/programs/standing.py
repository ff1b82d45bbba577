"""The line of a program at which its axes stood when its job ended."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.model.paths.origin import Place
from orchestrator.model.report import JobReport, StepRecording
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.tree import find_paths
from orchestrator.model.units import Unit, convert_units
from orchestrator.plan.path.arc_length import Array
from orchestrator.plan.path.rest import TraceFollower, thin_out
from orchestrator.plan.path.traces import PathTrace, trace_paths
from orchestrator.plan.programs.program_job import ProgramJob


@dataclass(frozen=True, slots=True)
class LastMotion:
    """How a job ended. recording: of its last step; None: it has none, as after a cancel. axes: as they are now."""

    report: JobReport
    recording: StepRecording | None
    axes: Mapping[str, AxisForecast]


@dataclass(frozen=True, slots=True)
class StandingLine:
    """The line. is_recorded: the job has kept where its axes were; otherwise it is by where they stand now."""

    line: int
    is_recorded: bool = True


def find_standing_line(program: ProgramJob, end: LastMotion, fleet: Fleet) -> StandingLine:
    """Where a program stood. program: the same one, made again."""
    steps, places = program.job.steps, program.imported.places
    number, is_under_way = _find_step(program, end.report)
    if number >= len(steps):
        return StandingLine(max(max(own_places) for own_places in places if own_places).line)
    line = 0 if places[number] else program.imported.lines[number]
    if line:
        return StandingLine(line)
    path_number = sum(step.follows_path for step in steps[:number])
    path = find_paths(steps)[path_number]
    trace = trace_paths(program.job, program.paths)[path_number]
    if end.recording is not None and is_under_way:
        return StandingLine(_follow(trace, _place_samples(path, end.recording, end.axes, fleet), places[number]))
    return StandingLine(_follow(trace, _place_now(path, end.axes, fleet), places[number]), is_recorded=False)


def _find_step(program: ProgramJob, report: JobReport) -> tuple[int, bool]:
    """The number of the path, or of the other step with a line, that had begun last, or is next; and whether the report
    has it."""
    steps, contents, reports = program.job.steps, program.imported, report.steps
    # A move to the first line may have been a job of its own.
    first = 1 if program.approach and not (reports and reports[0].do == "move") else 0
    if not reports:
        number, is_under_way = first, False
    else:
        # Behind a step that is done, the next one may have begun, and left no report.
        is_under_way = reports[-1].state != "done"
        number = first + reports[-1].index + (0 if is_under_way else 1)
    while number < len(steps) and not contents.find_places(number):
        number, is_under_way = number + 1, False
    return number, is_under_way


def _place_samples(step: FollowPath, recording: StepRecording, axes: Mapping[str, AxisForecast], fleet: Fleet) -> Array:
    """Positions of the axes at the instants of the first one's samples, in its unit: (samples, axes)."""
    instants = np.array([at_ns for at_ns, _ in recording.axes[step.axes[0]].sampled], dtype=np.float64)
    columns: list[Array] = []
    for name in step.axes:
        axis = recording.axes[name]
        at_ns, counts = np.array(axis.sampled, dtype=np.float64).reshape(-1, 2).T
        offset = float(axes[name].offset) if name in axes else 0.0
        positions = fleet.axis(name).to_units(np.interp(instants, at_ns, counts)) + offset
        columns.append(positions * _scale(step, name, fleet))
    samples = np.column_stack(columns)
    return samples[thin_out(len(samples))]


def _place_now(step: FollowPath, axes: Mapping[str, AxisForecast], fleet: Fleet) -> Array:
    """The positions of the axes as one sample; none if they are not known."""
    if any(name not in axes for name in step.axes):
        return np.zeros((0, len(step.axes)))
    return np.array([[float(axes[name].motor + axes[name].offset) * _scale(step, name, fleet) for name in step.axes]])


def _scale(step: FollowPath, name: str, fleet: Fleet) -> float:
    """What makes a position of an axis one in the unit of the path."""
    return float(convert_units(Fraction(1), Unit(fleet.axis(name).unit), Unit(fleet.axis(step.axes[0]).unit)))


def _follow(trace: PathTrace, samples: Array, places: Sequence[Place]) -> int:
    """The line of the piece that was followed last."""
    follower = TraceFollower(trace.points)
    for sample in samples:
        follower.follow(sample)
    return places[int(trace.piece[follower.segment + 1])].line
