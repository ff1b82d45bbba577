"""Describe a step of a job in one line."""

import json

from orchestrator.model.duration import format_ns, parse_duration
from orchestrator.model.job import Step
from orchestrator.model.names import ALL_AXES


def describe_step(step: Step) -> str:
    """Describe what its file says, without defaults: `move to gantry.x=120 stage.u=6, speed=0.5`."""
    said = step.model_dump(mode="json", exclude_defaults=True, exclude={"do", "name"})
    what = ", ".join(_describe_field(key, value) for key, value in said.items())
    return " ".join(part for part in (step.do, step.name and f"'{step.name}'", what) if part)


def _describe_field(key: str, value: dict[str, object] | list[str] | str | float | None) -> str:
    if isinstance(value, dict):
        if list(value) == [ALL_AXES]:
            return f"{key} {value[ALL_AXES]}"
        return f"{key} " + " ".join(f"{name}={_format_value(each)}" for name, each in value.items())
    if isinstance(value, list):
        return f"{key} " + " ".join(value)
    if isinstance(value, str) and value.endswith(" ns"):
        return f"{key}={format_ns(parse_duration(value))}"
    return f"{key}={_format_value(value)}"


def _format_value(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
