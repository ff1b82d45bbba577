"""The speed of a move as people write it: a fraction of the limits, a speed with its unit, or one for each axis."""

from collections.abc import Mapping, Sequence
from math import inf
from typing import Annotated, Any, Literal, cast

from pydantic import BeforeValidator, WithJsonSchema

from orchestrator.model.numbers import MAX_NUMBER, split_number
from orchestrator.model.units import check_rate

MANUAL: Literal["manual"] = "manual"
"""The speed of what a person asks for one at a time: `manual_speed` of each axis."""
EXAMPLES = '0.5, "50 %", "5 mm/s", {gantry.x: 5 mm/s} or manual'


def read_speed(value: object, owner: str) -> float | str:
    """One speed: a fraction above 0 to 1, or text with a unit of speed. Raises `ValueError`."""
    fraction: float | None = None
    if isinstance(value, int | float) and not isinstance(value, bool):
        fraction = float(value) if abs(value) <= MAX_NUMBER else inf
    elif isinstance(value, str):
        number, unit = split_number(value) or ("", "")
        if unit and unit != "%":
            if float(number) <= 0:
                raise ValueError(f"{owner} is {value}; a speed is above 0")
            check_rate(value, 1)
            return value
        if unit:
            fraction = float(number) / 100
    if fraction is None:
        raise ValueError(f"{owner} is {value!r}; write e.g. {EXAMPLES}")
    if not 0 < fraction <= 1:
        text = f"{owner} is {value}, and a number without a unit is a fraction of the limits, above 0 to 1"
        raise ValueError(f'{text}; with a unit it is a speed: "{value} mm/s"')
    return fraction


def _read_speeds(value: Any) -> Any:
    if value == MANUAL:
        return value
    if isinstance(value, Mapping):
        speeds = cast("Mapping[object, object]", value)
        if not speeds:
            raise ValueError(f"speed names no axis; write e.g. {EXAMPLES}")
        return {str(axis): read_speed(speed, f"speed of {axis}") for axis, speed in speeds.items()}
    return read_speed(value, "speed")


Speed = Annotated[
    float | str | dict[str, float | str],
    BeforeValidator(_read_speeds),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "exclusiveMinimum": 0, "maximum": 1},
                {"type": "string"},
                {"type": "object", "additionalProperties": {"anyOf": [{"type": "number"}, {"type": "string"}]}},
            ]
        }
    ),
]
"""A fraction of the limits (0.5, `"50 %"`), a speed (`"5 mm/s"`), one of both by axis, or `manual`."""


def scale_speed(speed: float | str | Mapping[str, float | str], rate: float) -> float | str | dict[str, float | str]:
    """A speed times `rate`, above 0 to 1. `manual` is scaled by axis before."""
    if isinstance(speed, Mapping):
        return {axis: _scale_one(value, rate) for axis, value in speed.items()}
    return _scale_one(speed, rate)


def _scale_one(speed: float | str, rate: float) -> float | str:
    if not isinstance(speed, str):
        return speed * rate
    number, unit = split_number(speed) or ("0", "")
    return f"{float(number) * rate:.9g} {unit}"


def describe_speed(speed: float | str | Mapping[str, float | str]) -> str:
    """A speed with its unit: `50 %`, `5 mm/s`, `gantry.x=5 mm/s`."""
    if isinstance(speed, Mapping):
        return " ".join(f"{axis}={describe_speed(value)}" for axis, value in speed.items())
    return speed if isinstance(speed, str) else f"{100 * speed:.6g} %"


def join_speeds(*parts: tuple["Speed", Sequence[str]]) -> "Speed | None":
    """The speed of one move for several, each with its speed and its axes; None where there is none: a speed along a
    line is not that of its axes, and `manual` stands for all axes."""
    first = parts[0][0]
    if not isinstance(first, str | dict) or first == MANUAL:
        are_alike = all(speed == first for speed, _ in parts)
        if are_alike or first == MANUAL:
            return first if are_alike else None
    by_axis: dict[str, float | str] = {}
    for speed, axes in parts:
        if speed == MANUAL or (isinstance(speed, str) and len(axes) > 1):
            return None
        by_axis |= speed if isinstance(speed, dict) else dict.fromkeys(axes, speed)
    return by_axis
