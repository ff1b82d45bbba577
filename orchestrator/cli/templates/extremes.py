"""A check of a template at the ends of its parameters' ranges, one parameter at a time."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet
    from orchestrator.model.templates.template import ParameterSetting, Template

MAX_STEPS = 5_000  # that are run forward for it in all: a second


def check_extremes(
    template: "Template", settings: "Mapping[str, ParameterSetting]", fleet: "Fleet | None", repeat: int = 1
) -> list[str]:
    """What fails with another value that bounds and choices allow, in words; with nothing to compare with, the form
    alone is checked. It ends after `MAX_STEPS`, which is stated."""
    from orchestrator.model.files import FileError
    from orchestrator.plan.forecast import forecast_job

    notes: list[str] = []
    steps = 0
    for words, further in template.list_extremes(settings):
        try:
            filled = template.fill_settings(further)
        except FileError as error:
            notes += [f"with {words}: {error.problems[0]}"]
            continue
        if fleet is None:
            continue
        steps += len(filled.job.steps) * repeat
        if steps > MAX_STEPS:
            return [*notes, f"not checked with {words}, nor with the values after it: the job is too long"]
        problems = forecast_job(fleet, filled.job.steps, repeat).problems
        if problems:
            first = problems[0]
            notes.append(f"with {words}: {filled.problem(first.place, first.text)}")
    return notes
