"""Programs in G-code that arrive as text: what has to be chosen for them, their mistakes, their job and its drawing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from orchestrator.client import Tutti
from orchestrator.gateway.checked_job import CheckedJob
from orchestrator.gateway.preview import look_at_axes
from orchestrator.gateway.program_drawing import draw_program, list_extents
from orchestrator.gateway.replies import describe_problems
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.forecast import AxisForecast, StepProblem
from orchestrator.model.jobs.files import FileError, FileProblem
from orchestrator.model.units import Unit, convert_units, find_dimension, parse_quantity
from orchestrator.plan.programs.program_job import ProgramJob, make_program_job, require_unchanged
from orchestrator.plan.programs.settings import (
    FROM_LINE,
    PROGRAM,
    ZEROS,
    ProgramText,
    describe_fields,
    read_settings,
)
from orchestrator.plan.programs.standing import LastMotion, find_standing_line
from orchestrator.plan.programs.traces import trace_paths

MAX_SHOWN_PROBLEMS = 50
BY_PLACE = "by where the axes stand now, as the job kept no record of its last move: see whether it is right"


async def open_program(tutti: Tutti, body: Mapping[str, Any], values: Mapping[str, str]) -> "ProgramCheck":
    """A program with what it is checked with. Raises `Refusal`."""
    program = _read_program(body)
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
        fields = describe_fields(self.program, self.fleet, _list_places(self), self.values)
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
        fields = describe_fields(self.program, self.fleet, _list_places(self), self.values)
        program = self._make_job(fields if self.end is None else _take_over(self, fields, self.end))
        return [_locate_problem(program, problem) for problem in problems]

    def _make_job(self, fields: list[dict[str, Any]]) -> ProgramJob:
        """Raises `FileError`."""
        settings = read_settings(self.program, fields, self.values, _list_zeros(self))
        if self.end is not None:
            require_unchanged(self.program, settings, self.end.report.parameters_used)
        return make_program_job(self.program, settings, self.fleet)


def _locate_problem(program: ProgramJob, problem: StepProblem) -> FileProblem:
    text = problem.describe()
    number = next((part for part in problem.place if isinstance(part, int)), 0)
    places = program.imported.places
    if number >= len(places) or not places[number]:
        return FileProblem(program.program.name, 0, "", text)
    lines = places[number]
    piece = _find_piece(text)
    line = lines[piece - 1].line if 0 < piece <= len(lines) else min(lines).line
    return FileProblem(program.program.name, line, "", text)


def _find_piece(text: str) -> int:
    """The number of the piece that a refusal of the planner names; 0: it names none."""
    _, word, remaining_job = text.partition("piece ")
    digits = remaining_job.split(" ")[0].rstrip(":,;")
    return int(digits) if word and digits.isdecimal() else 0


def _read_program(body: Mapping[str, Any]) -> ProgramText:
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
    used = end.report.parameters_used
    fields = [{**field, "default": used.get(field["name"], field["default"])} for field in fields]
    settings = read_settings(check.program, fields, {}, _list_zeros(check))
    require_unchanged(check.program, settings, used)
    program = make_program_job(check.program, settings, check.fleet)
    standing = find_standing_line(program, end, check.fleet)
    text = "where it stood" if standing.is_recorded else BY_PLACE
    line = {"default": str(standing.line), "description": text}
    return [{**field, **line} if field["name"] == FROM_LINE else field for field in fields]


def _list_places(check: ProgramCheck) -> dict[str, float]:
    """Where the linear axes stand, mm."""
    units = {name: Unit(check.fleet.axis(name).unit) for name in check.axes}
    return {
        name: float(convert_units(axis.motor + axis.offset, units[name], Unit.MM))
        for name, axis in check.axes.items()
        if find_dimension(units[name]) == "length"
    }


def _list_zeros(check: ProgramCheck) -> dict[str, float]:
    return {name: float(axis.offset) for name, axis in check.axes.items()}


def _describe(check: ProgramCheck, program: ProgramJob, fields: list[dict[str, Any]]) -> CheckedJob:
    traces = trace_paths(program.job, program.paths)
    details: dict[str, Any] = {
        "lines": len(check.program.lines),
        "from_line": program.settings.from_line,
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
    if _stands_at(check, program.approach):
        return CheckedJob.of(remaining_job, plain)
    places = ", ".join(f"{name} to {target}" for name, target in program.approach.items())
    details["approach"] = f"all axes go straight and together: {places}"
    return CheckedJob.of(move, plain, program.job)


def _stands_at(check: ProgramCheck, places: Mapping[str, str]) -> bool:
    """Whether all axes are where a move would take them, to a count."""
    for name, target in places.items():
        axis, forecast = check.fleet.axis(name), check.axes.get(name)
        goal = parse_quantity(target, axis.unit, name)
        if forecast is None or abs(goal - forecast.motor - forecast.offset) * axis.counts_per_unit > 1:
            return False
    return True
