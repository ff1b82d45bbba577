"""Names of axes, inputs and outputs: `controller.name`; and of positions: one word."""

import re

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
    controller, _, rest = name.partition(".")
    return controller, rest


def controller_of(name: str) -> str:
    """The controller of `controller.name`."""
    return name.partition(".")[0]
