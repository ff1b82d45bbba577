"""Jobs that have ended on their way go on from the place where they stood."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.client.fleet import FleetRequests
from orchestrator.client.jobs import SubmittedJob
from orchestrator.client.positions import PositionRequests
from orchestrator.client.steps import StepRequests
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.rest import JobRest
from orchestrator.model.jobs.service import PointsRead, ReadPoints
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import FINISHED_STATES, PointRecord
from orchestrator.model.state import ControllerState
from orchestrator.model.steps.kinds import MOTION_STEPS
from orchestrator.model.steps.order import StepPlace

if TYPE_CHECKING:
    from orchestrator.plan.continuing.ended_job import EndedJob


class RestRequests(StepRequests, PositionRequests, FleetRequests):
    """Continue jobs that an e-stop, a stop, a cancel or a failed step has ended."""

    async def find_rest(self, job_id: str, file: Path | str | None = None) -> JobRest:
        """What is left of a job that has ended, and the way back to where it stood; nothing moves.

        file: that the job was made of, such as a program in G-code; it is compared with what ran. Raises `Refusal`, as
        with code `not-ended`, `nothing-left`, `needs-file`, `zero-changed`, and `FileError` with what has changed.
        """
        # What plans paths takes a while to load.
        from orchestrator.model.paths.files.reading import read_path_text
        from orchestrator.plan.continuing.files import JobFile
        from orchestrator.plan.continuing.programs import find_rest
        from orchestrator.plan.programs.settings import ProgramText

        path = None if file is None else Path(file)
        job_file = None if path is None else JobFile(ProgramText(path.name, read_path_text(path)), path.parent)
        return find_rest(await load_ended_job(self, job_id), job_file)

    async def continue_job(
        self, rest: JobRest, terms: QueueTerms | None = None, *, client_key: str | None = None
    ) -> SubmittedJob:
        """Submit the rest of a job as a new job, whose terms name the old one. Its axes must stand where `rest` begins:
        run `rest.move` before, if there is one. What `rest.outputs` names is switched first. Raises `Refusal`,
        `JobFailed`."""
        terms = (terms or QueueTerms()).model_copy(update={"continues": rest.continues})
        if rest.job is not None:
            entry = await self.enqueue_job(rest.job, client_key, terms)
            return SubmittedJob(entry.id, self, entry)
        if rest.switch is not None:
            await self.run(rest.switch)
        shown_job = await self.show_job(rest.continues)
        kept_repeat = 1 if shown_job.entry is None else shown_job.entry.terms.repeat
        first = rest.retry_step, rest.point or 1
        terms = terms.model_copy(update={"repeat": kept_repeat})
        retried_job = await self.retry_job(rest.continues, first, terms=terms, client_key=client_key)
        return SubmittedJob(retried_job.job_id, self, retried_job.entry)


async def load_ended_job(requests: RestRequests, job_id: str) -> "EndedJob":
    """What `find_rest` takes the place of a job from. Raises `Refusal`."""
    from orchestrator.model.positions.resolve import PositionResolver
    from orchestrator.plan.continuing.ended_job import EndedJob, find_last_step
    from orchestrator.plan.forecast.present import look_at_axes

    shown_job = await requests.show_job(job_id)
    job, report = shown_job.job, shown_job.report
    if job is None or report is None or report.state not in FINISHED_STATES:
        text = f"job {job_id} has not ended"
        raise Refusal("not-ended", text, "resume it if it is paused: `tutti job resume`; or cancel it first")
    fleet, states = await requests.load_fleet(), await requests.status()
    resolver = PositionResolver(fleet, await requests.list_positions(), keep_unknown=True)
    last = report.steps[-1] if report.steps else None
    has_moved = last is not None and last.do in MOTION_STEPS
    ended_job = EndedJob(
        job=job.model_copy(update={"steps": resolver.resolve_steps(job.steps)}),
        report=report,
        recording=await requests.load_recording(job_id, last.index) if last is not None and has_moved else None,
        point=None,
        fleet=fleet,
        axes=look_at_axes(fleet, states),
        outputs=_list_outputs(states),
        rests=[entry for entry in (await requests.list_jobs()).jobs if entry.terms.continues == job_id],
    )
    return replace(ended_job, point=await _load_point(requests, job_id, find_last_step(ended_job).place))


async def _load_point(requests: RestRequests, job_id: str, place: StepPlace) -> PointRecord | None:
    """What was recorded of the point at which a job stood; None: it was at none, or nothing was recorded of it."""
    if place.point is None:
        return None
    fields = requests.request_fields()
    request = ReadPoints(**fields, job_id=job_id, after_step=place.first, after_point=place.point, limit=1)
    points = (await requests.request_service("points", request, PointsRead)).points
    return points[0] if points else None


def _list_outputs(states: Mapping[str, ControllerState]) -> dict[str, bool]:
    """The levels of all outputs, by `controller.output`; those of silent controllers are unknown."""
    return {
        f"{name}.{output}": level
        for name, state in states.items()
        if state.mode != "offline"
        for output, level in state.outputs.items()
    }
