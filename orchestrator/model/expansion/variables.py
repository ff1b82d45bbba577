"""Variables `{name}` in the text of a fleet file."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from orchestrator.model.errors import TuttiError
from orchestrator.model.files.yaml_reader import YamlNode

VARIABLE_NAME = r"[a-z][a-z0-9_]{0,39}"
VARIABLE = rf"\{{({VARIABLE_NAME})([+-][0-9]{{1,9}})?\}}"
_PARTS = re.compile(rf"\{{\{{|\}}\}}|{VARIABLE}")
_NAME = re.compile(VARIABLE_NAME)


class VariableError(TuttiError, ValueError):
    """A variable that cannot be filled in."""


@dataclass(frozen=True, slots=True)
class Variable:
    """The value of a variable. text: as it is written, which stands inside other text: `0.50`."""

    value: int | float | bool | str
    text: str


Variables = Mapping[str, Variable]


def is_variable_name(text: str) -> bool:
    """Whether a variable may have this name."""
    return _NAME.fullmatch(text) is not None


def make_variable(node: YamlNode) -> Variable | None:
    """The variable with the value of a node; None for a value that is no number, text or truth value."""
    return None if node.children is not None or node.value is None else Variable(node.value, node.text)


def fill_text(text: str, variables: Variables, used: set[str]) -> Any:
    """`text` with its variables filled in; what is one variable alone keeps its type. used: gets the names.

    Raises `VariableError`.
    """
    whole_text = _PARTS.fullmatch(text)
    if whole_text is not None and whole_text[1]:
        return _find_value(whole_text, variables, used).value
    return _PARTS.sub(lambda part: _find_value(part, variables, used).text if part[1] else part[0][0], text)


def _find_value(part: re.Match[str], variables: Variables, used: set[str]) -> Variable:
    name, offset = part[1], part[2]
    variable = variables.get(name)
    if variable is None:
        known_names = ", ".join(variables) or "none"
        raise VariableError(f"there is no variable {name}; variables: {known_names} (a brace is written twice: {{{{)")
    used.add(name)
    if offset is None:
        return variable
    if type(variable.value) is not int:
        raise VariableError(f"{part[0]}: only a whole number can be added to, and {name} is {variable.text!r}")
    number = variable.value + int(offset)
    return Variable(number, str(number))
