"""A step of a job in one line."""

import json

from orchestrator.model.duration import format_ns, parse_duration
from orchestrator.model.job import Step
from orchestrator.model.report import StepReport


def step_text(step: Step, report: StepReport | None = None) -> str:
    """What its file says, without what is left to defaults, and how it went: `move to gantry.x=120: done`."""
    said = step.model_dump(mode="json", exclude_defaults=True, exclude={"do", "name"})
    what = ", ".join(_words(key, value) for key, value in said.items())
    text = " ".join(part for part in (step.do, step.name and f"'{step.name}'", what) if part)
    if report is None:
        return text
    return f"{text}: {report.state}" + (f" ({report.reason})" if report.reason else "")


def _words(key: str, value: dict[str, object] | list[str] | str | float | None) -> str:
    if isinstance(value, dict):
        return f"{key} " + " ".join(f"{name}={_plain(each)}" for name, each in value.items())
    if isinstance(value, list):
        return f"{key} " + " ".join(value)
    if isinstance(value, str) and value.endswith(" ns"):
        return f"{key}={format_ns(parse_duration(value))}"
    return f"{key}={_plain(value)}"


def _plain(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
