"""The job of an imported path: checked as `tutti job check` does, and written a piece a line."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from orchestrator.model.files.yaml_reader import YamlError
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, FileProblem, read_document, validate_value
from orchestrator.model.jobs.job import Job
from orchestrator.model.numbers import split_number
from orchestrator.model.paths.files.base.imported import ImportedSteps, make_job
from orchestrator.model.paths.origin import PathOrigin, Place
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.tree import find_paths
from orchestrator.model.units import Unit
from orchestrator.plan.forecast.job import forecast_job
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.resolve import ResolvedPath, resolve_path

MANY_PIECES = "more than a job file holds; keep the program, and name it in a step: `{do: path, file: …}`"


def make_checked_job(name: str, imported: ImportedSteps, tolerance: str, fleet: Fleet | None) -> str:
    """The text of the job file. fleet: whose axes and limits it is checked with; None: its form and its pieces alone.

    Raises `FileError` with the lines of the imported file.
    """
    steps = complete_steps(imported, {"tolerance": tolerance})
    job = make_imported_job(imported, make_job(name, steps))
    check_pieces(job, fleet)
    if fleet is not None:
        _check_forecast(job, fleet)
    text = write_job(name, steps)
    try:
        read_document(text, name)
    except (FileError, YamlError) as error:
        pieces = sum(len(step.get("pieces", ())) for step in steps)
        reason = f"{pieces} pieces are {MANY_PIECES}" if pieces > len(steps) else str(error)
        raise FileError([FileProblem(imported.file, 1, "", reason)]) from None
    return text


def complete_steps(imported: ImportedSteps, fields: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The steps, in which each path has `fields`, and the lines of its file as its name: progress and reports show
    it."""
    return [
        {**step, **fields, **_name_lines(places), **imported.make_source(number)} if step["do"] == "path" else step
        for number, (step, places) in enumerate(zip(imported.steps, imported.places, strict=True))
    ]


def make_imported_job(imported: ImportedSteps, plain: dict[str, Any]) -> Job:
    """The job of completed steps, with the places of its pieces. Raises `FileError` with lines of the file."""
    job, problems = validate_value(plain, Job)
    if job is None:
        raise FileError(
            FileProblem(
                imported.file, *_find_line(imported, problem.place), f"the job would not be valid: {problem.text}"
            )
            for problem in problems
        )
    steps = [
        step.with_origin(PathOrigin(imported.file, imported.find_places(number)))
        for number, step in enumerate(job.steps)
    ]
    return job.model_copy(update={"steps": steps})


def _name_lines(places: Sequence[Place]) -> dict[str, str]:
    """By its lines: a loop runs some of them again, and a cycle makes several pieces of one."""
    if not places:
        return {}
    first, last = min(places).line, max(places).line
    return {"name": f"line {first}" if first == last else f"lines {first} to {last}"}


def write_job(name: str, steps: list[dict[str, Any]]) -> str:
    """A job file: JSON, which is YAML, a step and a piece a line, which can be compared and edited."""
    lines = ",\n".join(f"  {_write_step(step)}" for step in steps)
    return f'{{"schema": "tutti.job/1", "name": {json.dumps(name)}, "steps": [\n{lines}\n]}}\n'


def _write_step(step: Mapping[str, Any]) -> str:
    if "pieces" not in step:
        return json.dumps(step, ensure_ascii=False)
    head = json.dumps({key: value for key, value in step.items() if key != "pieces"}, ensure_ascii=False)
    lines = ",\n".join(f"    {json.dumps(piece, ensure_ascii=False)}" for piece in step["pieces"])
    return f'{head[:-1]}, "pieces": [\n{lines}\n  ]}}'


def _find_line(imported: ImportedSteps, place: tuple[str | int, ...]) -> tuple[int, str]:
    """The line and the column of what a place in the job was made of."""
    if len(place) > 3 and place[2] == "pieces":
        places = imported.places[int(place[1])]
        number = int(place[3])
        if number < len(places):
            line, column = places[number]
            return line, f"column {column}" if column else ""
    return 1, ".".join(map(str, place[2:]))


def check_pieces(job: Job, fleet: Fleet | None) -> list[ResolvedPath]:
    """The paths of a job in numbers. Raises `FileError` if the planner would refuse a piece, whatever the limits of the
    axes."""
    return [_resolve_pieces(path, job.name, fleet) for path in find_paths(job.steps)]


def _resolve_pieces(path: FollowPath, job_name: str, fleet: Fleet | None) -> ResolvedPath:
    unit = _find_unit(path, fleet)
    axes = [PathAxis(name, unit, 1.0, 1.0, None, (float("-inf"), float("inf"))) for name in path.axes]
    try:
        return resolve_path(path, axes)
    except PathRefusal as error:
        origin = path.origin
        places: Sequence[Place] = [] if origin is None else origin.places
        number = (error.piece or 0) - 1
        line, column = places[number] if 0 <= number < len(places) else (1, 0)
        name = job_name if origin is None else origin.file
        problem = FileProblem(name, line, f"column {column}" if column else "", f"{error.text}: {error.remedy}")
        raise FileError([problem]) from None


def _find_unit(path: FollowPath, fleet: Fleet | None) -> Unit:
    """The unit of the axes: that of the fleet, or of the first value that has one."""
    if fleet is not None and path.axes[0] in fleet.axis_names:
        return fleet.axis(path.axes[0]).unit
    for value in path.start:
        parts = split_number(value) if isinstance(value, str) else None
        if parts is not None and parts[1] in list(Unit):
            return Unit(parts[1])
    return Unit.MM


def _check_forecast(job: Job, fleet: Fleet) -> None:
    forecast = forecast_job(fleet, job.steps, 1, lambda _: None)
    if forecast.problems:
        raise FileError(FileProblem("--fleet", 0, "", problem.text) for problem in forecast.problems)
