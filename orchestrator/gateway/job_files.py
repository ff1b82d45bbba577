"""Job files that arrive as text, or are templates of the fleet: their parameters, mistakes, forecast and drawing.

What is long is read, planned and drawn in another process: a program of 4 MB took the loop here 14 s, in which no stop
was answered.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from starlette.responses import Response

from orchestrator.bus.decoding import MAX_AT_ONCE
from orchestrator.client import Tutti
from orchestrator.clock.executor import Executor
from orchestrator.gateway.checked_job import CheckedJob, CheckedSource
from orchestrator.gateway.job_rests import check_rest, load_continued
from orchestrator.gateway.preview import draw_parts
from orchestrator.gateway.program_files import open_program
from orchestrator.gateway.replies import describe_problems, make_joined_response
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import FileError, FileProblem, LoadedFile, read_document, read_file
from orchestrator.model.jobs.forecast import JobForecast, StepProblem
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.parts import join_at_once
from orchestrator.model.templates.arriving import refuse_files
from orchestrator.model.templates.parameters import describe_parameter
from orchestrator.model.templates.template import FilledJob, ParameterSetting, Template
from orchestrator.plan.continuing.ended_job import EndedJob
from orchestrator.plan.forecast.present import look_at_axes

PATTERN = "*.job.yaml"
MAX_TEMPLATES = 200
MAX_DRY_RUN_STEPS = 200  # written ones; more are planned without asking the controllers: that takes 3 ms each
NAME = "job file"


class JobFiles:
    """The job files in `folder`, and those that arrive. folder: None: there are none."""

    def __init__(self, folder: Path | None, execute: Executor, check: Executor) -> None:
        """execute: for what takes a moment. check: for long texts, and for paths, whose plans take seconds."""
        self._folder, self._execute, self._check = folder, execute, check

    def list_templates(self) -> list[dict[str, Any]]:
        """All job files of the folder, with their parameters; those that cannot be read have `problem`."""
        paths = [] if self._folder is None else sorted(self._folder.glob(PATTERN))
        return [_describe_template(path) for path in paths[:MAX_TEMPLATES]]

    async def check_job(self, tutti: Tutti, body: Mapping[str, Any]) -> Response:
        """Check a job file or a program: problems with their lines, parameters, the job, what it will do, and its
        drawing.

        Raises `Refusal` for a body that is not as it should be, a template that is not there, and a text whose check
        takes too much.
        """
        ended_job = await load_continued(tutti, body)
        if ended_job is not None:
            return await self._check_rest(tutti, ended_job, body)
        source: CheckedSource
        if "program" in body:
            values = {name: str(setting.value) for name, setting in _read_values(body.get("values", {})).items()}
            source = await open_program(tutti, body, values)
        else:
            source = JobText(self._folder, body)
        reader = self._check if source.size > MAX_AT_ONCE else self._execute
        checked_job = await reader(source.check)
        answer: dict[str, Any] = {"problems": [], "forecast": None, **checked_job.plain}
        if not checked_job.whole:
            return make_joined_response(answer | {"job": None, "preview": None}, {})
        forecast, preview = await self._look_ahead(tutti, checked_job)
        if forecast.problems:
            answer["problems"] = describe_problems(await reader(source.locate, forecast.problems))
        answer["forecast"] = _describe_forecast(forecast)
        return make_joined_response(answer, {"job": checked_job.job, "preview": preview})

    async def _check_rest(self, tutti: Tutti, ended_job: EndedJob, body: Mapping[str, Any]) -> Response:
        plain, checked_rest = await check_rest(self._execute, ended_job, body)
        if checked_rest is not None:
            plain |= {"program": checked_rest.plain}
            if checked_rest.job is not None:
                return await self.show_job(tutti, checked_rest.job, {"parameters": [], **plain})
        answer: dict[str, Any] = {"problems": [], "parameters": [], "job": None, "forecast": None, "preview": None}
        return make_joined_response(answer | plain, {})

    async def show_job(self, tutti: Tutti, job: Job, plain: Mapping[str, Any]) -> Response:
        """What a job will do now, as `check_job` says it of its file. plain: more fields of the answer."""
        checked_job = await self._execute(CheckedJob.of, job)
        forecast, preview = await self._look_ahead(tutti, checked_job)
        problems = describe_problems(map(_place_problem, forecast.problems))
        answer = {**plain, "problems": problems, "forecast": _describe_forecast(forecast)}
        return make_joined_response(answer, {"job": checked_job.job, "preview": preview})

    async def _look_ahead(self, tutti: Tutti, checked: CheckedJob) -> tuple[JobForecast, bytes]:
        """The forecast, with what each controller would be sent if it is not too long, and the drawing as JSON."""
        forecast = JobForecast()
        if checked.steps <= MAX_DRY_RUN_STEPS:
            forecast = await tutti.dry_run(await self._execute(join_at_once, checked.whole))
        fleet, positions = await tutti.load_fleet(), await tutti.list_positions()
        axes = look_at_axes(fleet, await tutti.status())
        draw = self._check if checked.is_long else self._execute
        return forecast, await draw(draw_parts, fleet, positions, axes, checked.whole)


@dataclass(frozen=True, slots=True)
class JobText:
    """A job file that arrives, or the name of a template in `folder`, with the values of its parameters."""

    folder: Path | None
    body: Mapping[str, Any]

    @property
    def size(self) -> int:
        """The characters of the text."""
        text = self.body.get("text")
        return len(text) if isinstance(text, str) else 0

    def check(self) -> CheckedJob:
        """Parameters, mistakes, and without any, the job. Raises `Refusal`."""
        parameters: list[dict[str, Any]] = []
        try:
            template = Template(self._read_file())
            parameters = _describe_parameters(template)
            filled_job = self._fill(template)
        except FileError as error:
            return CheckedJob({"parameters": parameters, "problems": describe_problems(error.problems)})
        return CheckedJob.of(filled_job.job, {"parameters": parameters})

    def locate(self, problems: Sequence[StepProblem]) -> list[FileProblem]:
        """Problems of the forecast, at their places in the file."""
        filled_job = self._fill(Template(self._read_file()))
        return [filled_job.problem(problem.place, problem.describe()) for problem in problems]

    def _fill(self, template: Template) -> FilledJob:
        filled_job = template.fill_settings(_read_values(self.body.get("values", {})))
        refuse_files(filled_job)
        return filled_job

    def _read_file(self) -> LoadedFile:
        text, template = self.body.get("text"), self.body.get("template")
        if isinstance(text, str) and template is None:
            return read_document(text, NAME)
        if not isinstance(template, str) or text is not None:
            raise Refusal("bad-request", "give either `text`, a job file, or `template`, the name of one", "")
        names = {} if self.folder is None else {path.name: path for path in self.folder.glob(PATTERN)}
        if template not in names:
            template_list = ", ".join(sorted(names)[:20]) or "none"
            raise Refusal(
                "no-file", f"there is no template {template[:100]!r}; there are: {template_list}", "choose one of them"
            )
        return read_file(names[template])


def _describe_template(path: Path) -> dict[str, Any]:
    """A template as the page lists it. Its button is there also when the job has a mistake: the page says which."""
    plain: dict[str, Any] = {"name": path.name.removesuffix(PATTERN[1:]), "file": path.name}
    plain |= {"parameters": [], "button": None, "problem": None}
    try:
        template = Template(read_file(path))
        plain |= {"button": None if template.button is None else template.button.to_plain()}
        template.check()
        return plain | {"parameters": _describe_parameters(template)}
    except FileError as error:
        return plain | {"problem": str(error.problems[0])}


def _describe_parameters(template: Template) -> list[dict[str, Any]]:
    return [{"name": name, **describe_parameter(parameter)} for name, parameter in template.parameters.items()]


def _read_values(values: object) -> dict[str, ParameterSetting]:
    given_values = cast(Mapping[str, object], values) if isinstance(values, dict) else {"": 0}
    if not all(isinstance(value, str) for value in given_values.values()):
        raise Refusal("bad-request", "`values` must be an object of texts", 'for example {"width": "20 mm"}')
    return {name: ParameterSetting(value, "the form", written=True) for name, value in given_values.items() if value}


def _place_problem(problem: StepProblem) -> FileProblem:
    return FileProblem(NAME, 0, ".".join(map(str, problem.place)), problem.describe())


def _describe_forecast(forecast: JobForecast) -> dict[str, Any]:
    return forecast.to_plain() | {"least_s": forecast.least_s, "most_s": forecast.most_s}
