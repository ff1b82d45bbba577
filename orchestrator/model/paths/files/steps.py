"""Paths of jobs that are in files of other programs, read in the place of their steps.

A file that stops on its way becomes several steps; they are a repeat of one pass, so that what
is said about a step of the job still names the step that was written.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.model.jobs.files import FileError, FileProblem, validate_value
from orchestrator.model.jobs.job import Job
from orchestrator.model.paths.files.base.imported import ImportedSteps
from orchestrator.model.paths.files.reading import GCODE, GcodeStart, read_path_file
from orchestrator.model.paths.origin import PathOrigin
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.repeat import MAX_REPEATED, Repeat
from orchestrator.model.steps.tree import find_paths
from orchestrator.model.units import Unit, UnitError, parse_quantity, parse_rate

# What the step of the job says about each path of its file.
_SHARED = ("frame", "tolerance", "acceleration", "jerk", "record", "start_class", "align", "max_start_skew")
MAX_JOB_BYTES = 12_000_000  # of a job as it is sent; the coordinator takes 13 MB


def read_path_steps(job: Job, folder: Path | None = None) -> Job:
    """The job with the pieces of all files in the place of their names. folder: of relative names.

    Raises `FileError` with every mistake of a file, by line and column; nothing of it is taken then.
    """
    files = {id(step): _read_file(step, step.file, folder) for step in find_paths(job.steps) if step.file is not None}
    if not files:
        return job
    new_job = job.model_copy(update={"steps": [step.replace_steps(files) for step in job.steps]})
    size = len(new_job.to_json())
    if size > MAX_JOB_BYTES:
        text = f"with its files of paths the job has {size / 1e6:.1f} MB; at most {MAX_JOB_BYTES / 1e6:g} MB are sent"
        raise FileError([FileProblem(job.name, 1, "", f"{text}: split the program into several jobs")])
    return new_job


def _read_file(step: FollowPath, file: str, folder: Path | None) -> Step:
    """The steps that a file makes: one, or a repeat of one pass."""
    path = Path(file) if folder is None else folder / file
    begin = GcodeStart(_find_places(step, path), step.gcode, folder=path.parent)
    contents = read_path_file(path, dict(zip(step.names or step.axes, step.axes, strict=True)), begin)
    if len(contents.steps) > MAX_REPEATED:
        text = f"stops {len(contents.steps)} times; at most {MAX_REPEATED} times are possible"
        raise FileError([FileProblem(str(path), 1, "", f"{text}: split the program")])
    moves_freely = any(plain_step["do"] in ("move", "probe") for plain_step in contents.steps)
    if moves_freely and step.frame is not None:
        text = "it probes, and what it moves then are the axes themselves; leave `frame` of its step out"
        raise FileError([FileProblem(str(path), 1, "", text)])
    fields = [_complete_fields(step, contents, number) for number in range(len(contents.steps))]
    job, problems = validate_value({"schema": "tutti.job/1", "name": "file", "steps": fields}, Job)
    if job is None:
        number, *places = problems[0].place[1:] or (0,)
        text = f"its path {int(number) + 1} is not valid: {'.'.join(map(str, places))} {problems[0].text}"
        raise FileError([FileProblem(str(path), 1, "", text)])
    steps: list[Step] = []
    notes = contents.notes
    for number, plain_step in enumerate(job.steps):
        steps.append(plain_step.with_origin(PathOrigin(str(path), contents.find_places(number), notes)))
        notes = [] if plain_step.follows_path else notes
    return steps[0] if len(steps) == 1 else Repeat(times=1, steps=steps, name=step.name)


def _complete_fields(step: FollowPath, contents: ImportedSteps, number: int) -> dict[str, Any]:
    """A step of a file with what the step of the job says about it."""
    plain_step = contents.steps[number]
    if plain_step["do"] == "path":
        return {**_add_fields(step, plain_step), "name": step.name, **contents.make_source(number)}
    if plain_step["do"] in ("move", "probe") and step.speed is not None:
        own = plain_step.get("speed")
        cap = step.speed if isinstance(step.speed, str) else f"{step.speed:g} mm/s"
        return {**plain_step, "speed": cap if own is None else _choose_lower([cap, own])}
    return plain_step


def _find_places(step: FollowPath, path: Path) -> dict[str, float]:
    """Where the axes of G-code stand before it, mm, by letter."""
    if not step.start or path.suffix.lower() not in GCODE:
        return {}
    pairs = zip(step.names or step.axes, step.start, strict=True)
    try:
        return {name.upper(): float(parse_quantity(value, Unit.MM, name)) for name, value in pairs}
    except UnitError as error:
        raise FileError([FileProblem(str(path), 1, "", f"`start` of its step: {error}")]) from None


def _add_fields(step: FollowPath, each: dict[str, Any]) -> dict[str, Any]:
    """A path of a file with what its step says. The lower one of two speeds holds."""
    fields_said = step.model_dump(mode="json", exclude_defaults=True, by_alias=True)
    fields = {
        **each,
        **{name: fields_said[name] for name in _SHARED if name in fields_said},
        "tolerance": fields_said["tolerance"],
    }
    if "corner" in fields_said:
        fields["corner"] = fields_said["corner"]
    if step.speed is not None:
        own = each.get("speed")
        fields["speed"] = step.speed if own is None else _choose_lower([step.speed, own])
    return fields


def _choose_lower(speeds: Sequence[float | str]) -> float | str:
    """The lowest of speeds; one that has no sense is refused with the path."""
    try:
        values = [parse_rate(speed, Unit.MM, 1) if isinstance(speed, str) else speed for speed in speeds]
    except UnitError:
        return speeds[0]
    return speeds[values.index(min(values))]
