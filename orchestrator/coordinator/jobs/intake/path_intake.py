"""Paths with members that move from rest to rest only: they become paths one after the other when a job comes in."""

from contextlib import suppress

from orchestrator.bus.base import BusError
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.names import controller_of
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.repeat import MAX_REPEATED, Repeat
from orchestrator.model.steps.tree import find_paths
from orchestrator.plan.path_split import split_path


async def split_paths(services: JobServices, job: Job) -> Job:
    """The job with each path that has such members split, as a repeat of one pass, so that what is said about a step
    names the step that was written. Raises `Refusal`, code `path-class`, for a piece that hinders.

    A controller that does not answer is taken to follow any path; if it cannot, the path is refused when it runs.
    """
    paths = [step for step in find_paths(job.steps) if step.file is None]
    split = {id(path): parts for path in paths if (parts := await _split_path(services, path)) is not path}
    return job.model_copy(update={"steps": [step.replace_steps(split) for step in job.steps]}) if split else job


async def _split_path(services: JobServices, step: FollowPath) -> Step:
    view = services.view
    known_names = set(view.fleet.axis_names)
    slow = set[str]()
    for name in dict.fromkeys(controller_of(axis) for axis in step.axes if axis in known_names):
        with suppress(BusError):
            if max((await view.infos.query(name)).orders) < 3:
                slow |= {axis for axis in step.axes if controller_of(axis) == name}
    if not slow or not known_names.issuperset(step.axes):
        return step
    units = {axis: view.fleet.axis(axis).unit for axis in step.axes}
    parts = await services.motion.plan(split_path, step, slow, units, view.fleet.path_frames)
    if len(parts) == 1:
        return step
    if len(parts) > MAX_REPEATED:
        text = f"the path rests {len(parts)} times for {', '.join(sorted(slow))}; at most {MAX_REPEATED} are possible"
        raise Refusal("path-class", text, "write it as several paths")
    return Repeat(times=1, steps=list(parts), name=step.name)
