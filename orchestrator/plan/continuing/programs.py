"""The rest of a job that was made of a program or another file: its files are compared, and it goes on at its line."""

from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.rest import JobRest
from orchestrator.model.paths.source import PathSource
from orchestrator.model.steps.tree import find_paths
from orchestrator.plan.continuing.ended_job import EndedJob, find_last_step
from orchestrator.plan.continuing.files import JobFile
from orchestrator.plan.continuing.rest import (
    BY_PRESENT,
    describe_rest,
    find_first_places,
    find_job_rest,
    find_way,
    make_move,
)
from orchestrator.plan.programs.present import list_places, list_zeros, take_over
from orchestrator.plan.programs.program_job import make_program_job
from orchestrator.plan.programs.settings import DIGEST, PROGRAM, ProgramText, describe_fields, read_settings
from orchestrator.plan.programs.standing import LastMotion


def find_rest(ended: EndedJob, file: JobFile | None) -> JobRest:
    """What is left of a job. file: that it was made of. Raises `Refusal` with why it cannot go on, and `FileError` with
    what has changed."""
    used = ended.report.parameters_used
    if DIGEST in used:
        return _find_program_rest(ended, _require_file(file, used[PROGRAM], ended).program)
    source = _find_source(ended)
    if source is not None:
        _require_file(file, source.file, ended).require_same(source.file, source.digests)
    elif file is not None:
        raise Refusal("no-program", f"job {ended.report.job_id} was not made of a file", "leave the file out")
    return find_job_rest(ended)


def _find_source(ended: EndedJob) -> PathSource | None:
    """What the path was made of at which a job stood, or that is left next; None: no file. Raises `Refusal`."""
    remaining_steps = ended.order.list_remaining(find_last_step(ended).place.index)
    paths = find_paths(remaining_step.step for remaining_step in remaining_steps)
    source = paths[0].source if paths else None
    return source if source is not None and source.digests else None


def _require_file(file: JobFile | None, name: str, ended: EndedJob) -> JobFile:
    """The file that a job was made of. Raises `Refusal` without one."""
    if file is None:
        job_id = ended.report.job_id
        text = f"job {job_id} was made of the file {name!r}, which is compared with what ran"
        raise Refusal("needs-file", text, f"give it: `tutti job continue {job_id} {name}`")
    return file


def _find_program_rest(ended: EndedJob, program: ProgramText) -> JobRest:
    """The rest of a program from its line on, which runs again from its start, with the modes of the lines before."""
    fleet, axes = ended.fleet, ended.axes
    last = find_last_step(ended)
    fields = describe_fields(program, fleet, list_places(fleet, axes), {})
    fields, standing = take_over(program, fields, LastMotion(ended.report, ended.recording, axes), fleet)
    program_job = make_program_job(program, read_settings(program, fields, {}, list_zeros(axes)), fleet)
    job = program_job.split_approach()[1] if program_job.approach else program_job.job
    job_rest = describe_rest(ended, last.place, [], job.steps)
    way = find_way(ended, find_first_places(ended, program_job.job.steps))
    place_text = f"line {standing.line} of {program.name}" + ("" if standing.is_recorded else f", {BY_PRESENT}")
    return job_rest.model_copy(
        update={
            "place": place_text,
            "line": standing.line,
            "is_recorded": standing.is_recorded,
            "confirm": [*job_rest.confirm, *program_job.list_confirmations()],
            "way": way,
            "move": make_move(job, way),
            "job": job,
        }
    )
