"""Names of axes, inputs and outputs: `controller.name`; and of positions: one word, where a target stands."""

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema

from orchestrator.model.units import check_axis_unit, check_quantity

ALL_AXES = "*"
"""In the targets of a move: all axes of a named position. `to: sample` is `{"*": "sample"}`."""

POSITION_NAME = r"[a-z][a-z0-9_-]{0,63}"
_POSITION_NAME = re.compile(POSITION_NAME)
_VALUES = {"inf", "infinity", "nan", "null", "true", "false", "yes", "no", "on", "off"}


def is_position_name(value: object) -> bool:
    """Whether `value` can be the name of a position; what reads as a value cannot."""
    return isinstance(value, str) and _POSITION_NAME.fullmatch(value) is not None and value not in _VALUES


def split_name(name: str) -> tuple[str, str]:
    """Split `controller.name` into controller and name; the name is empty for a controller alone."""
    controller, _, local = name.partition(".")
    return controller, local


def controller_of(name: str) -> str:
    """The controller of `controller.name`."""
    return name.partition(".")[0]


_NUMBER_OR_TEXT: dict[str, Any] = {"anyOf": [{"type": "number"}, {"type": "string"}]}


def _check_target(value: object) -> object:
    return value if is_position_name(value) else check_axis_unit(check_quantity(value))


Target = Annotated[int | float | str, BeforeValidator(_check_target), WithJsonSchema(_NUMBER_OR_TEXT)]
"""A quantity; or the name of a position, which stands for its value for that axis."""


def _read_whole_position(to: object) -> object:
    """`to: sample` stands for all axes of that position."""
    return {ALL_AXES: to} if is_position_name(to) else to


_MEASURED: dict[str, Any] = {
    "type": "object",
    "properties": {
        "of": {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]},
        "plus": _NUMBER_OR_TEXT,
        "between": {"type": "array", "items": _NUMBER_OR_TEXT},
    },
    "required": ["of"],
}
_TARGETS_BY_AXIS: dict[str, Any] = {
    "type": "object",
    "additionalProperties": {"anyOf": [*_NUMBER_OR_TEXT["anyOf"], _MEASURED]},
}

MoveTarget = Annotated[
    dict[str, Target],
    BeforeValidator(_read_whole_position),
    WithJsonSchema({"anyOf": [_TARGETS_BY_AXIS, {"type": "string"}], "default": {}}),
]
"""Targets by axis; or the name of a position alone, for all its axes. What probes measure is read apart from them."""

AxisTargets = Annotated[dict[str, Target], WithJsonSchema({**_TARGETS_BY_AXIS, "default": {}})]
"""Targets by axis, in the same way."""
