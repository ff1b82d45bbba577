"""Fields of a step in words."""

import json
import re
from typing import Any, cast

from orchestrator.model.names import ALL_AXES
from orchestrator.model.numbers import format_ns, parse_duration
from orchestrator.model.steps.speed import describe_speed
from orchestrator.model.steps.triggers import Trigger

_NANOSECONDS = re.compile(r"\d+ ns")  # the JSON form of a duration


def describe_trigger(trigger: Trigger) -> str:
    """A trigger: `lab.shutter every 0.5 mm of gantry.x`."""
    places = f"every {trigger.every}" if trigger.at is None else f"at {len(trigger.at)} places"
    return f"{trigger.output} {places}" + (f" of {trigger.of}" if trigger.of else "")


def describe_field(key: str, value: dict[str, object] | list[str] | str | float | None) -> str:
    """A field and its value, a speed with its unit: `speed=50 %`."""
    if key == "speed" and isinstance(value, float | str | dict):
        return f"speed={describe_speed(cast(Any, value))}"
    if isinstance(value, dict):
        if list(value) == [ALL_AXES]:
            return f"{key} {value[ALL_AXES]}"
        return f"{key} " + " ".join(f"{name}={_format_value(item)}" for name, item in value.items())
    if isinstance(value, list):
        return f"{key} " + " ".join(value)
    return f"{key}={_format_value(value)}"


def _format_value(value: object) -> str:
    if isinstance(value, list):
        return ",".join(map(_format_value, value))  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
    if isinstance(value, str):
        return format_ns(parse_duration(value)) if _NANOSECONDS.fullmatch(value) else value
    return json.dumps(value)
