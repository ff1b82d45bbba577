"""Where a running job moves each axis: by its steps, for the axis table, and which of them are paths."""

from collections.abc import Callable, Mapping
from typing import Any

from orchestrator.model.fleet import Fleet
from orchestrator.model.names import ALL_AXES, is_position_name, split_name
from orchestrator.model.operation.recording import JobBegun
from orchestrator.model.report import FINISHED_STATES, JobProgress
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.order import StepOrder, StepPlace
from orchestrator.model.units import UnitError, parse_quantity

FindRest = Callable[[str], float | None]


class JobTargets:
    """The targets of the steps that run now. Scans have none: their points follow each other too quickly to be read."""

    def __init__(self) -> None:
        self._jobs: dict[str, JobBegun] = {}
        self._steps: dict[str, int] = {}
        self._targets: dict[str, dict[str, float]] = {}
        self._by_owner: dict[str, dict[str, float]] | None = None
        self.by_axis: Mapping[str, float] = {}
        """By `controller.axis`, the user position that the running step moves it to."""
        self.paths: dict[str, dict[str, Any]] = {}
        """Of a job whose running step is a path: the index of that step, and its axes."""

    def find_targets(self, controller: str) -> Mapping[str, float]:
        """The targets of a controller's axes, by their names in it."""
        if self._by_owner is None:
            self._by_owner = {}
            for axis, target in self.by_axis.items():
                owner, name = split_name(axis)
                self._by_owner.setdefault(owner, {})[name] = target
        return self._by_owner.get(controller, {})

    def _note_targets(self) -> None:
        self.by_axis = {axis: target for targets in self._targets.values() for axis, target in targets.items()}
        self._by_owner = None

    def take_job(self, begun: JobBegun) -> None:
        """Take over a job that begins."""
        self._jobs[begun.job_id] = begun

    def take_progress(self, progress: JobProgress, fleet: Fleet | None, find_rest: FindRest) -> bool:
        """Take over a job's progress; return whether targets have changed. find_rest: the position of an
        axis before the step, for moves by a distance."""
        job_id = progress.job_id
        begun_job = self._jobs.get(job_id)
        if progress.state in FINISHED_STATES:
            self._jobs.pop(job_id, None)
            self._steps.pop(job_id, None)
            self.paths.pop(job_id, None)
            had_targets = self._targets.pop(job_id, None) is not None
            self._note_targets()
            return had_targets
        if begun_job is None or fleet is None or self._steps.get(job_id) == progress.step:
            return False
        self._steps[job_id] = progress.step
        step_place = _find_place(begun_job, progress.step)
        self._targets[job_id] = _find_targets(
            begun_job, None if step_place is None else step_place.step, fleet, find_rest
        )
        self._note_targets()
        self.paths.pop(job_id, None)
        if step_place is not None and step_place.is_path:
            self.paths[job_id] = {"step": progress.step, "axes": step_place.step.named_axes}
        return True


def _find_place(begun: JobBegun, number: int) -> StepPlace | None:
    order = StepOrder(begun.job.steps, begun.repeat)
    return order.locate(number) if number < len(order) else None


def _find_targets(begun: JobBegun, step: Step | None, fleet: Fleet, find_rest: FindRest) -> dict[str, float]:
    if not isinstance(step, Move):
        return {}
    targets: dict[str, float] = {}
    for axis, value in _list_absolute(step, begun.positions_used).items():
        try:
            targets[axis] = float(parse_quantity(value, fleet.unit_of(axis)))
        except (UnitError, ValueError):
            continue
    for axis, value in step.by.items():
        rest_position = find_rest(axis)
        try:
            distance = float(parse_quantity(value, fleet.unit_of(axis)))
        except (UnitError, ValueError):
            continue
        if rest_position is not None:
            targets[axis] = rest_position + distance
    return targets


def _list_absolute(step: Move, positions: Mapping[str, Mapping[str, str]]) -> dict[str, int | float | str]:
    """The absolute targets of a step by axis, with the values of named positions."""
    absolute: dict[str, int | float | str] = {}
    for axis, target in step.to.items():
        if axis == ALL_AXES:
            absolute |= positions.get(str(target), {})
        elif is_position_name(target):
            value = positions.get(str(target), {}).get(axis)
            absolute |= {} if value is None else {axis: value}
        else:
            absolute[axis] = target
    return absolute
