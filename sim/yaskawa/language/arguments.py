"""Arguments of commands: axis letters, fields by position, one axis by letter (L2111-L2169, L12242-L12311)."""

from collections.abc import Callable
from typing import Final

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.context import CommandContext, Evaluator
from sim.yaskawa.language.expressions import compile_expression

QUERY: Final = "?"
LETTERS: Final = "XYZWEFGH"
"""Letters of all axes that a model of the family can have; the axes of a controller are checked when a command runs."""
_SAME: Final = {"A": "X", "B": "Y", "C": "Z", "D": "W"}

Field = Evaluator | str | None
"""Content of one field: an expression, `QUERY`, or nothing."""


def canonical_axis(letter: str) -> str:
    """Return the canonical name of an axis: A B C D are X Y Z W (L2111)."""
    return _SAME.get(letter, letter)


def split_fields(text: str, separator: str = ",") -> list[str]:
    """Split `text` at separators outside quotes and brackets."""
    parts: list[str] = []
    start = depth = 0
    in_quotes = False
    for position, character in enumerate(text):
        if character == '"':
            in_quotes = not in_quotes
        elif in_quotes:
            continue
        elif character in "([{":
            depth += 1
        elif character in ")]}":
            depth -= 1
        elif character == separator and depth <= 0:
            parts.append(text[start:position])
            start = position + 1
    parts.append(text[start:])
    return parts


def parse_axes(text: str, allowed: str = LETTERS) -> tuple[str, ...]:
    """Parse the designators in a list of letters, `~a` kept as it is; none given gives an empty tuple."""
    operators: list[str] = []
    position = 0
    while position < len(text):
        if text[position] == "~" and position + 1 < len(text):
            operators.append(text[position : position + 2])
            position += 2
            continue
        name = canonical_axis(text[position])
        if name not in allowed:
            raise CommandError(28 if name in "ST" else 4)
        operators.append(name)
        position += 1
    return tuple(operators)


def queried_axes(text: str) -> tuple[str, ...]:
    """Return the axes that fields of `?` name; 4 when a field contains anything else."""
    marks = split_fields(text)
    if len(marks) > len(LETTERS) or any(mark not in ("", "?") for mark in marks):
        raise CommandError(4)
    return tuple(LETTERS[index] for index, mark in enumerate(marks) if mark)


def parse_field(text: str) -> Field:
    if not text:
        return None
    return QUERY if text == "?" else compile_expression(text)


def parse_fields(text: str, max_fields: int = len(LETTERS)) -> list[Field]:
    """Parse fields by position."""
    parts = split_fields(text)
    if len(parts) > max_fields:
        raise CommandError(4)
    return [parse_field(part) for part in parts]


def parse_form(text: str, letters: str = LETTERS) -> list[tuple[str, Field]]:
    """Parse one of the four forms of an axis parameter: pairs of designator (`*` for all) and field."""
    if text[:1] == "~" and text[2:3] == "=":
        return [(text[:2], parse_field(text[3:]))]
    if text[1:2] == "=":
        name = canonical_axis(text[0])
        if name != "*" and name not in letters + "N":
            raise CommandError(4)
        return [(name, parse_field(text[2:]))]
    fields = parse_fields(text, len(letters))
    return [(letters[index], field) for index, field in enumerate(fields) if field is not None]


def compile_values(fields: list[Field]) -> Callable[[CommandContext], list[int | None]]:
    """Compile the fields to their values at run time; interrogation is not valid there."""
    evaluators: list[Evaluator | None] = []
    for field in fields:
        if isinstance(field, str):
            raise CommandError(51)
        evaluators.append(field)
    return lambda c: [None if evaluator is None else evaluator(c) for evaluator in evaluators]
