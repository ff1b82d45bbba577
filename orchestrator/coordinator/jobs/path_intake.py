"""Paths with members that move from rest to rest only: they become paths one after the other when a job comes in."""

from contextlib import suppress

from orchestrator.bus.base import BusError
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.errors import Refusal
from orchestrator.model.job import MAX_REPEATED, FollowPath, Job, Repeat, Step
from orchestrator.model.names import controller_of
from orchestrator.plan.path_split import split_path


async def split_paths(view: FleetView, job: Job) -> Job:
    """The job with each path that has such members split, as a repeat of one pass, so that what is said about a step
    names the step that was written. Raises `Refusal`, code `path-class`, for a piece that hinders.

    A controller that does not answer is taken to follow any path; if it cannot, the path is refused when it runs.
    """
    steps = [await _split_step(view, step) for step in job.steps]
    if all(new is old for new, old in zip(steps, job.steps, strict=True)):
        return job
    return job.model_copy(update={"steps": steps})


async def _split_step(view: FleetView, step: Step) -> Step:
    if isinstance(step, Repeat):
        inside = [await _split_step(view, each) for each in step.steps]
        same = all(new is old for new, old in zip(inside, step.steps, strict=True))
        return step if same else step.model_copy(update={"steps": inside})
    if not isinstance(step, FollowPath) or step.file is not None:
        return step
    known = set(view.fleet.axis_names)
    slow = set[str]()
    for name in dict.fromkeys(controller_of(axis) for axis in step.axes if axis in known):
        with suppress(BusError):
            if max((await view.query_info(name)).orders) < 3:
                slow |= {axis for axis in step.axes if controller_of(axis) == name}
    if not slow or not known.issuperset(step.axes):
        return step
    units = {axis: view.fleet.axis(axis).unit for axis in step.axes}
    parts = split_path(step, slow, units, view.fleet.frames)
    if len(parts) == 1:
        return step
    if len(parts) > MAX_REPEATED:
        text = f"the path rests {len(parts)} times for {', '.join(sorted(slow))}; at most {MAX_REPEATED} are possible"
        raise Refusal("path-class", text, "write it as several paths")
    return Repeat(times=1, steps=list(parts), name=step.name)
