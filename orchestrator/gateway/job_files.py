"""Job files that arrive as text, or are templates of the fleet: their parameters, mistakes, forecast and drawing."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

from orchestrator.client import Tutti
from orchestrator.clock.executor import Executor
from orchestrator.gateway.job_rests import check_rest, load_continued
from orchestrator.gateway.preview import draw_job
from orchestrator.gateway.program_files import check_program, locate_in_program
from orchestrator.gateway.replies import describe_problems
from orchestrator.model.errors import Refusal
from orchestrator.model.forecast import JobForecast, StepProblem
from orchestrator.model.jobs.files import FileError, FileProblem, LoadedFile, read_document, read_file
from orchestrator.model.jobs.job import Job
from orchestrator.model.templates.parameters import describe_parameter
from orchestrator.model.templates.template import FilledJob, ParameterSetting, Template
from orchestrator.plan.continuing.ended_job import EndedJob
from orchestrator.plan.forecast.present import look_at_axes

PATTERN = "*.job.yaml"
MAX_TEMPLATES = 200
MAX_CHECKED_STEPS = 10_000
MAX_DRY_RUN_STEPS = 200  # written ones; more are planned without asking the controllers: that takes 3 ms each
NAME = "job file"

LocateProblem = Callable[[StepProblem], FileProblem]


class JobFiles:
    """The job files in `folder`, and those that arrive. folder: None: there are none."""

    def __init__(self, folder: Path | None, execute: Executor) -> None:
        self._folder, self._execute = folder, execute

    def list_templates(self) -> list[dict[str, Any]]:
        """All job files of the folder, with their parameters; those that cannot be read have `problem`."""
        paths = [] if self._folder is None else sorted(self._folder.glob(PATTERN))
        return [_describe_template(path) for path in paths[:MAX_TEMPLATES]]

    async def check_job(self, tutti: Tutti, body: Mapping[str, Any]) -> dict[str, Any]:
        """Check a job file or a program: problems with their lines, parameters, the job, what it will do, and its
        drawing.

        Raises `Refusal` for a body that is not as it should be, and a template that is not there.
        """
        answer: dict[str, Any] = {"problems": [], "parameters": [], "job": None, "forecast": None, "preview": None}
        ended_job = await load_continued(tutti, body)
        if ended_job is not None:
            return answer | await self._check_rest(tutti, ended_job, body)
        if "program" in body:
            return answer | await self._check_program(tutti, body)
        parameters, problems, filled_job = await self._execute(self._fill_job, body)
        answer |= {"parameters": parameters, "problems": describe_problems(problems)}
        if filled_job is None:
            return answer
        locate = partial(_locate_problem, filled_job)
        return answer | await self.forecast_job(tutti, filled_job.job, locate)

    async def _check_program(self, tutti: Tutti, body: Mapping[str, Any]) -> dict[str, Any]:
        settings = _read_values(body.get("values", {}))
        values = {name: str(setting.value) for name, setting in settings.items()}
        answer, checked_program = await check_program(tutti, self._execute, body, values)
        if checked_program is None:
            return answer
        program = checked_program.program
        forecast = await self.forecast_job(
            tutti,
            checked_program.whole,
            lambda problem: locate_in_program(program, problem.place, _join_remedy(problem)),
        )
        return {**answer, **forecast, "job": checked_program.job.to_plain(), "program": checked_program.plain}

    async def _check_rest(self, tutti: Tutti, ended_job: EndedJob, body: Mapping[str, Any]) -> dict[str, Any]:
        answer, checked_rest = await check_rest(self._execute, ended_job, body)
        if checked_rest is None:
            return answer
        if checked_rest.job is not None:
            answer = await self.forecast_job(tutti, checked_rest.job)
        return {**answer, "program": checked_rest.plain}

    async def forecast_job(self, tutti: Tutti, job: Job, locate: LocateProblem | None = None) -> dict[str, Any]:
        """What a job will do now: its forecast, with what each controller would be sent if it is not too long, and its
        drawing. locate: where a problem stands in a file; None: there is none."""
        forecast, problems = JobForecast(), list[FileProblem]()
        if len(job.steps) <= MAX_DRY_RUN_STEPS:
            forecast = await tutti.dry_run(job)
            problems = [(locate or _place_problem)(problem) for problem in forecast.problems]
        fleet, positions = await tutti.load_fleet(), await tutti.list_positions()
        axes = look_at_axes(fleet, await tutti.status())
        return {
            "job": job.to_plain(),
            "problems": describe_problems(problems),
            "forecast": forecast.to_plain() | {"least_s": forecast.least_s, "most_s": forecast.most_s},
            "preview": await draw_job(fleet, positions, axes, job),
        }

    def _fill_job(
        self, body: Mapping[str, Any]
    ) -> tuple[list[dict[str, Any]], Sequence[FileProblem], FilledJob | None]:
        """Parameters, mistakes, and without any, the job. In a thread: a long file takes seconds."""
        parameters: list[dict[str, Any]] = []
        try:
            template = Template(self._read_file(body))
            parameters = _describe_parameters(template)
            filled_settings = template.fill_settings(_read_values(body.get("values", {})))
            _refuse_files(filled_settings)
        except FileError as error:
            return parameters, error.problems, None
        return parameters, [], filled_settings

    def _read_file(self, body: Mapping[str, Any]) -> LoadedFile:
        text, template = body.get("text"), body.get("template")
        if isinstance(text, str) and template is None:
            return read_document(text, NAME)
        if not isinstance(template, str) or text is not None:
            raise Refusal("bad-request", "give either `text`, a job file, or `template`, the name of one", "")
        names = {} if self._folder is None else {path.name: path for path in self._folder.glob(PATTERN)}
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


def _refuse_files(filled: FilledJob) -> None:
    """A job from elsewhere must not name files of this machine. Raises `FileError`."""
    problems = [
        filled.problem(("steps", number), "points in a file, or in a scanspec: submit it with `tutti submit FILE`")
        for number, written_step in enumerate(filled.job.steps)
        for step in written_step.iterate_written()
        if step.has_unread_points
    ]
    if problems:
        raise FileError(problems)


def _locate_problem(filled: FilledJob, problem: StepProblem) -> FileProblem:
    return filled.problem(problem.place, _join_remedy(problem))


def _place_problem(problem: StepProblem) -> FileProblem:
    return FileProblem(NAME, 0, ".".join(map(str, problem.place)), _join_remedy(problem))


def _join_remedy(problem: StepProblem) -> str:
    return f"{problem.text}; {problem.remedy}" if problem.remedy else problem.text
