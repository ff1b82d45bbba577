"""Programs in G-code that arrive as text: what has to be chosen for them, their mistakes, their job and its drawing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from orchestrator.client import Tutti
from orchestrator.gateway.checked_job import CheckedJob
from orchestrator.gateway.program_drawing import draw_program, list_extents
from orchestrator.gateway.replies import describe_problems
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, FileProblem
from orchestrator.model.jobs.forecast import AxisForecast, StepProblem
from orchestrator.model.paths.origin import Place
from orchestrator.plan.forecast.present import look_at_axes
from orchestrator.plan.path.traces import trace_paths
from orchestrator.plan.programs.present import list_places, list_zeros, stand_at, take_over
from orchestrator.plan.programs.program_job import ProgramJob, make_program_job, require_unchanged
from orchestrator.plan.programs.settings import (
    FROM_LINE,
    PROGRAM,
    ZEROS,
    ProgramText,
    describe_fields,
    read_settings,
)
from orchestrator.plan.programs.standing import LastMotion

MAX_SHOWN_PROBLEMS = 50
RUN_TITLE, RUN_SURE = "Before it runs", "All of this is so"
WAY_SURE = "The way is free"
BY_PLACE = "by where the axes stand now, as the job kept no record of its last move: see whether it is right"


async def open_program(tutti: Tutti, body: Mapping[str, Any], values: Mapping[str, str]) -> "ProgramCheck":
    """A program with what it is checked with. Raises `Refusal`."""
    program = read_program(body)
    fleet = await tutti.load_fleet()
    axes = look_at_axes(fleet, await tutti.status())
    end = await _load_end(tutti, body.get("continues"), axes)
    return ProgramCheck(program, values, fleet, axes, end)


@dataclass(frozen=True, slots=True)
class ProgramCheck:
    """A program, and what it is checked with. values: of its form. end: of the job that it continues."""

    program: ProgramText
    values: Mapping[str, str]
    fleet: Fleet
    axes: Mapping[str, AxisForecast]
    end: LastMotion | None

    @property
    def size(self) -> int:
        """The characters of the program."""
        return len(self.program.text)

    def check(self) -> CheckedJob:
        """What has to be chosen, mistakes, and without any, the job with what the page shows beside it."""
        fields = describe_fields(self.program, self.fleet, list_places(self.fleet, self.axes), self.values)
        try:
            if self.end is not None:
                fields = _take_over(self, fields, self.end)
            program = self._make_job(fields)
        except FileError as error:
            problems = describe_problems(error.problems[:MAX_SHOWN_PROBLEMS])
            return CheckedJob({"parameters": fields, "problems": problems})
        return _describe(self, program, fields)

    def locate(self, problems: Sequence[StepProblem]) -> list[FileProblem]:
        """Problems of the forecast, at the lines of the steps that they are in."""
        fields = describe_fields(self.program, self.fleet, list_places(self.fleet, self.axes), self.values)
        program = self._make_job(fields if self.end is None else _take_over(self, fields, self.end))
        return [_locate_problem(program, problem) for problem in problems]

    def _make_job(self, fields: list[dict[str, Any]]) -> ProgramJob:
        """Raises `FileError`."""
        settings = read_settings(self.program, fields, self.values, list_zeros(self.axes))
        if self.end is not None:
            require_unchanged(self.program, settings, self.end.report.parameters_used)
        return make_program_job(self.program, settings, self.fleet)


def _locate_problem(program: ProgramJob, problem: StepProblem) -> FileProblem:
    text = problem.describe()
    number = next((part for part in problem.place if isinstance(part, int)), 0)
    lines: Sequence[Place] = program.imported.find_places(number) if number < len(program.imported.steps) else []
    if not lines:
        return FileProblem(program.program.name, 0, "", text)
    piece = _find_piece(text)
    line = lines[piece - 1].line if 0 < piece <= len(lines) else min(lines).line
    return FileProblem(program.program.name, line, "", text)


def _find_piece(text: str) -> int:
    """The number of the piece that a refusal of the planner names; 0: it names none."""
    _, word, remaining_job = text.partition("piece ")
    digits = remaining_job.split(" ")[0].rstrip(":,;")
    return int(digits) if word and digits.isdecimal() else 0


def read_program(body: Mapping[str, Any]) -> ProgramText:
    program = body.get("program")
    fields = cast(dict[str, object], program) if isinstance(program, dict) else {}
    name, text = fields.get("name"), fields.get("text")
    if not isinstance(name, str) or not name or not isinstance(text, str) or "text" in body or "template" in body:
        raise Refusal("bad-request", "`program` must be an object with `name` and `text`", "give no job file beside it")
    return ProgramText(name[:100], text)


async def _load_end(tutti: Tutti, job_id: object, axes: Mapping[str, AxisForecast]) -> LastMotion | None:
    if job_id is None:
        return None
    if not isinstance(job_id, str):
        raise Refusal("bad-request", "`continues` must be the id of a job", "see /v1/jobs")
    report = (await tutti.show_job(job_id)).report
    if report is None or PROGRAM not in report.parameters_used:
        text = f"job {job_id[:80]} has not ended, or was not made of a program"
        raise Refusal("bad-request", text, "choose a job with `program` in its parameters")
    recording = await tutti.load_recording(job_id, report.steps[-1].index) if report.steps else None
    return LastMotion(report, recording, axes)


def _take_over(check: ProgramCheck, fields: list[dict[str, Any]], end: LastMotion) -> list[dict[str, Any]]:
    """The fields with the values of the job that has stopped, and the line at which it stood. Raises `FileError`."""
    fields, standing = take_over(check.program, fields, end, check.fleet)
    text = "where it stood" if standing.is_recorded else BY_PLACE
    return [{**field, "description": text} if field["name"] == FROM_LINE else field for field in fields]


def _describe(check: ProgramCheck, program: ProgramJob, fields: list[dict[str, Any]]) -> CheckedJob:
    traces = trace_paths(program.job, program.paths)
    details: dict[str, Any] = {
        "line": program.settings.from_line,
        "title": RUN_TITLE,
        "sure": RUN_SURE,
        "act": "",
        "terms": {} if check.end is None else {"continues": check.end.report.job_id},
        "retry": None,
        "values": {name: text for name, text in program.settings.texts.items() if name != ZEROS},
        "approach": "",
        "confirm": program.list_confirmations(),
        "notes": program.imported.notes,
        "extents": list_extents(traces, list(program.settings.axes.values()), check.fleet, check.axes),
        "drawing": draw_program(traces, list(program.settings.axes)),
    }
    plain = {"parameters": fields, "program": details}
    if not program.approach:
        return CheckedJob.of(program.job, plain)
    move, remaining_job = program.split_approach()
    if stand_at(program.approach, check.axes, check.fleet):
        return CheckedJob.of(remaining_job, plain)
    places = ", ".join(f"{name} to {target}" for name, target in program.approach.items())
    line = program.settings.from_line
    details |= {"title": f"First to the start of line {line}", "sure": WAY_SURE, "act": f"Move to line {line}"}
    details |= {"approach": f"all axes go straight and together: {places}", "terms": {}}
    return CheckedJob.of(move, plain, program.job)
