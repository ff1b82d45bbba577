"""A check of a template at the ends of its parameters' ranges, one parameter at a time."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orchestrator.client.points import PointSummaries
    from orchestrator.model.fleet import Fleet
    from orchestrator.model.templates.template import FilledJob, ParameterSetting, Template

MAX_STEPS = 5_000  # that are run forward for it in all: a second


def list_misfits(template: "Template", settings: "Mapping[str, ParameterSetting]") -> list[str]:
    """Where the form of the job is wrong with another value that bounds and choices allow, in words."""
    return [
        f"with {words}: {result}" for words, result in _fill_extremes(template, settings) if isinstance(result, str)
    ]


def check_extremes(
    template: "Template",
    settings: "Mapping[str, ParameterSetting]",
    fleet: "Fleet",
    summaries: "PointSummaries",
    repeat: int = 1,
) -> list[str]:
    """What fails with another value that bounds and choices allow, in words. It ends after `MAX_STEPS`, which is
    stated. summaries: of the points of scans."""
    from orchestrator.model.errors import Refusal
    from orchestrator.model.jobs.files import FileError
    from orchestrator.model.steps.tree import iterate_steps
    from orchestrator.plan.forecast.job import forecast_job

    notes: list[str] = []
    steps = 0
    for words, result in _fill_extremes(template, settings):
        if isinstance(result, str):
            notes.append(f"with {words}: {result}")
            continue
        steps += sum(1 for _ in iterate_steps(result.job.steps)) * repeat
        if steps > MAX_STEPS:
            return [*notes, f"not checked with {words}, nor with the values after it: the job is too long"]
        try:
            problems = forecast_job(fleet, summaries.place_summaries(result.job).steps, repeat).problems
        except FileError as error:
            notes.append(f"with {words}: {error.problems[0]}")
        except Refusal as error:
            notes.append(f"with {words}: {error.text}")
        else:
            notes += [f"with {words}: {result.problem(problem.place, problem.text)}" for problem in problems[:1]]
    return notes


def _fill_extremes(
    template: "Template", settings: "Mapping[str, ParameterSetting]"
) -> "Iterator[tuple[str, FilledJob | str]]":
    """The jobs of all extremes, each with its value in words; for one that cannot be made, what is wrong."""
    from orchestrator.model.jobs.files import FileError

    for words, further_settings in template.list_extremes(settings):
        try:
            yield words, template.fill_settings(further_settings)
        except FileError as error:
            yield words, str(error.problems[0])
