"""Where on a path a job stood: by the recording of its motion, or by where its axes are now."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import StepRecording
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.units import Unit, parse_quantity
from orchestrator.plan.continuing.ended_job import EndedJob
from orchestrator.plan.path.arc_length import Array
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path.plan import find_frame
from orchestrator.plan.path.resolve import ResolvedPath, resolve_path
from orchestrator.plan.path.rest import PathPlace, find_place, thin_out
from orchestrator.plan.path.traces import trace_path
from orchestrator.plan.path_step import find_start

MOST_ROUNDING = 2.0  # counts by which the start of a plan may be off that of its path


@dataclass(frozen=True, slots=True)
class StoodPath:
    """A path, resolved. units: of its coordinates; place: where on it the axes stood; None: at no place of it."""

    step: FollowPath
    path: ResolvedPath
    units: Sequence[Unit]
    place: PathPlace | None


def find_stood_path(ended: EndedJob, step: FollowPath, *, is_recorded: bool) -> StoodPath:
    """Where on a path a job stood. is_recorded: by the recording of the job, otherwise by where the axes are now.

    Raises `Refusal`: for triggers, which count from its start; for a zero of an axis that was elsewhere when it ran;
    for a path that the planner refuses."""
    if step.triggers:
        text = "the path has triggers, which count from its start: its rest would have others"
        raise Refusal("triggers", text, "run the whole step again: `tutti job retry`")
    fleet = ended.fleet
    axis_units = [Unit(fleet.axis(name).unit) for name in step.axes]
    frame = None if step.frame is None else find_frame(step, fleet.path_frames)
    if frame is not None and frame.corrected is not None:
        text = f"the path is in {step.frame}, whose tables of errors do not count where it is looked for on the path"
        raise Refusal("not-compensated", text, "run the whole step again: `tutti job retry`")
    units = axis_units if frame is None else [frame.unit] * len(axis_units)
    axes = [PathAxis(name, unit, 1.0, 1.0) for name, unit in zip(step.axes, axis_units, strict=True)]
    path = resolve_path(step, axes, frame)
    trace = trace_path(path)
    tolerance = float(parse_quantity(step.tolerance, units[0], "the path"))
    recording = ended.recording if is_recorded else None
    if recording is not None:
        _require_same_zeros(ended, recording, find_start_by_axis(step, fleet))
        samples = _list_samples(ended, step, recording)
    else:
        samples = _list_present(ended, step)
    return StoodPath(step, path, units, find_place(path, trace, list(samples), tolerance))


def find_start_by_axis(step: FollowPath, fleet: Fleet) -> dict[str, Fraction]:
    """Where the axes of a path stand at its start: user positions, in their units. Raises `Refusal`."""
    units = [Unit(fleet.axis(name).unit) for name in step.axes]
    return dict(zip(step.axes, find_start(step, units, fleet.path_frames), strict=True))


def _require_same_zeros(ended: EndedJob, recording: StepRecording, start: Mapping[str, Fraction]) -> None:
    """Raise `Refusal` if the zero of an axis has changed: the plan, in counts, began elsewhere then. start: of the
    path."""
    report = ended.report.steps[-1]
    if report.feed_holds or (report.path is not None and report.path.stops):
        return  # the recording is that of the last part, which began on the way
    for name, position in start.items():
        axis_now, recorded_axis = ended.axes.get(name), recording.axes.get(name)
        if axis_now is None or recorded_axis is None:
            continue
        axis = ended.fleet.axis(name)
        shift = float(position - axis_now.offset) - axis.to_unit(recorded_axis.profile.start_counts)
        play = 0.0 if axis.backlash is None else axis.backlash.amount
        if abs(shift) > play + MOST_ROUNDING / abs(recorded_axis.counts_per_unit):
            text = f"the zero of {name} has changed since the job ran, by {-shift:.6g} {recorded_axis.unit}"
            remedy = "the job is not continued; set the zero as it was, or submit a new job"
            raise Refusal("zero-changed", text, remedy)


def _list_samples(ended: EndedJob, step: FollowPath, recording: StepRecording) -> Array:
    """Positions of the axes, in their units, at the instants of the first one's samples: (samples, axes)."""
    moved_axes = [name for name in step.axes if name in recording.axes]
    instants = np.array([at_ns for at_ns, _ in recording.axes[moved_axes[0]].sampled], dtype=np.float64)
    columns: list[Array] = []
    for name in step.axes:
        offset = float(ended.axes[name].offset) if name in ended.axes else 0.0
        if name in recording.axes:
            axis = recording.axes[name]
            at_ns, counts = np.array(axis.sampled, dtype=np.float64).reshape(-1, 2).T
            columns.append(ended.fleet.axis(name).to_units(np.interp(instants, at_ns, counts)) + offset)
        else:  # it stands
            columns.append(np.full(len(instants), _find_present(ended, name)))
    samples = np.column_stack(columns)
    return samples[thin_out(len(samples))]


def _list_present(ended: EndedJob, step: FollowPath) -> Array:
    """Where the axes are now, as one sample; none if that is not known."""
    if any(name not in ended.axes for name in step.axes):
        return np.zeros((0, len(step.axes)))
    return np.array([[_find_present(ended, name) for name in step.axes]])


def _find_present(ended: EndedJob, name: str) -> float:
    axis = ended.axes[name]
    return float(axis.motor + axis.offset)
