"""Jobs that go on from where they stood, as the page shows them: the way back, then what is switched and left."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from orchestrator.client import Tutti
from orchestrator.client.continuing import load_ended_job
from orchestrator.clock.executor import Executor
from orchestrator.gateway.program_drawing import draw_program
from orchestrator.gateway.program_files import RUN_SURE, RUN_TITLE, WAY_SURE, read_program
from orchestrator.gateway.replies import describe_problems
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import FileError
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.rest import JobRest
from orchestrator.plan.continuing.ended_job import EndedJob
from orchestrator.plan.continuing.files import JobFile
from orchestrator.plan.continuing.programs import find_rest
from orchestrator.plan.programs.settings import DIGEST

CONTINUES = "continues"


@dataclass(frozen=True, slots=True)
class CheckedRest:
    """job: what would be submitted next, and is forecast; None: the rest of a scan, which `retry` runs. plain: what the
    page shows beside it."""

    job: Job | None
    plain: dict[str, Any]


async def load_continued(tutti: Tutti, body: Mapping[str, Any]) -> EndedJob | None:
    """The job that a request continues; None: none, or one that was made of a program on the page, whose settings are
    the form's. Raises `Refusal`."""
    job_id = body.get(CONTINUES)
    if job_id is None:
        return None
    if not isinstance(job_id, str):
        raise Refusal("bad-request", f"`{CONTINUES}` must be the id of a job", "see /v1/jobs")
    ended_job = await load_ended_job(tutti, job_id)
    return None if DIGEST in ended_job.report.parameters_used and "program" in body else ended_job


async def check_rest(
    execute: Executor, ended_job: EndedJob, body: Mapping[str, Any]
) -> tuple[dict[str, Any], CheckedRest | None]:
    """The problems of a rest, and without any, what would be submitted. Raises `Refusal`."""
    file = JobFile(read_program(body)) if "program" in body else None
    try:
        job_rest = await execute(find_rest, ended_job, file)
    except FileError as error:
        return {"problems": describe_problems(error.problems)}, None
    return {}, _describe(job_rest, ended_job.report.repeat)


def _describe(job_rest: JobRest, repeat: int) -> CheckedRest:
    """One confirmation after the other: the move back, the outputs of a scan, the rest. repeat: of the job."""
    switches = [f"{output} is switched {'on' if level else 'off'}" for output, level in job_rest.outputs.items()]
    approach, job = "", job_rest.job
    title, sure, act = RUN_TITLE, RUN_SURE, ""
    if job_rest.move is not None:
        places = ", ".join(f"{way.axis} to {way.to:.9g} {way.unit}" for way in job_rest.way)
        approach, job = f"all axes go straight and together: {places}", job_rest.move
        title, sure, act = f"First back: {job_rest.place}", WAY_SURE, "Move back"
    elif job_rest.switch is not None:
        approach, job = "; ".join(switches), job_rest.switch
        act = "Switch outputs"
    terms: dict[str, Any] = {} if approach else {CONTINUES: job_rest.continues}
    retry = None
    if job is None:
        retry = {"job_id": job_rest.continues, "from_step": job_rest.retry_step, "from_point": job_rest.point}
        terms["repeat"] = repeat
    plain = {
        "title": title,
        "sure": sure,
        "act": act,
        "terms": terms,
        "line": job_rest.line,
        "values": {},
        "approach": approach,
        "confirm": [f"{job_rest.name} stood at {job_rest.place}", *job_rest.confirm, *switches],
        "notes": [],
        "extents": [],
        "drawing": draw_program([], []),
        "retry": retry,
    }
    return CheckedRest(job, plain)
