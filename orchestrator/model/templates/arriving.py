"""Job files that arrive as text from elsewhere."""

from orchestrator.model.jobs.files import FileError, read_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.templates.template import FilledJob, Template


def read_job(text: str) -> Job:
    """The job in the text of a job file, with the defaults of its parameters. It comes from elsewhere, so that it names
    no files of this computer. Raises `FileError` with every mistake."""
    filled_job = Template(read_document(text, "job")).fill_settings({})
    refuse_files(filled_job)
    return filled_job.job


def refuse_files(filled: FilledJob) -> None:
    """Refuse a job from elsewhere that names files of this computer. Raises `FileError`."""
    problems = [
        filled.problem(("steps", number), "points in a file, or in a scanspec: submit it with `tutti submit FILE`")
        for number, written_step in enumerate(filled.job.steps)
        for step in written_step.iterate_written()
        if step.has_unread_points
    ]
    if problems:
        raise FileError(problems)
