"""References to parameters in the text of a value: `${name}`, `-${name}`, and `$${` for the text `${` itself."""

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from orchestrator.model.templates.parameters import PARAMETER_NAME

MARK = "${"
_NAME = re.compile(PARAMETER_NAME)
_WHOLE = re.compile(r"(-?)\$\{([^{}]*)\}")
_PART = re.compile(r"\$\$\{|\$\{([^{}]*)(\}?)")


class Reference(NamedTuple):
    """A reference as it is written. closed: its brace is."""

    name: str
    closed: bool = True

    @property
    def is_well_formed(self) -> bool:
        return self.closed and _NAME.fullmatch(self.name) is not None

    def __str__(self) -> str:
        return f"{MARK}{self.name}{'}' if self.closed else ''}"


def find_references(text: str) -> Iterator[Reference]:
    """All references in a text, well formed or not."""
    for match in _PART.finditer(text):
        if match[0] != "$${":
            yield Reference(match[1], bool(match[2]))


def find_whole(text: str) -> tuple[str, bool] | None:
    """The parameter that the whole text stands for, and whether it has a minus; None for any other text."""
    match = _WHOLE.fullmatch(text)
    return None if match is None else (match[2], bool(match[1]))


def replace_references(text: str, text_of: Callable[[str], str]) -> str:
    """The text with the value of each parameter, and `${` for `$${`."""
    return _PART.sub(lambda match: MARK if match[0] == "$${" else text_of(match[1]), text)
