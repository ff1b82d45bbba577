"""Forms of replies and what they say. Layouts are those of the manual where it has them, else of units in the field."""

import re
from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class Form:
    """What a reply must look like. many: it may be any number of lines."""

    words: str
    pattern: re.Pattern[str]
    many: bool = False

    def fits(self, text: str) -> bool:
        return self.pattern.fullmatch(text) is not None


class Query(NamedTuple):
    """A query and the form of its reply."""

    text: str
    form: Form


def _form(words: str, pattern: str, many: bool = False) -> Form:
    return Form(words, re.compile(pattern, re.IGNORECASE), many)


NUMBER = _form("a number", r"-?\d{1,10}")
PORT = _form("a byte", r"\d{1,3}")
STATUS = _form("`<axis>:<state>;` for each axis", r"(?:\d{1,2}:\d{1,10};)+")
POSITIONS = _form("`<axis>:<position>;` for each axis", r"(?:\d{1,2}:(?:osc|[+-]?\d{0,12}\.?\d{1,12}[^;:\d]{0,3});)+")
ERRORS = _form("`<axis>:<number> <text>` for each axis", r"\d{1,2}:\d{1,6}(?: .*)?", many=True)
TARGETS = _form("`<axis>:<target>;` for each axis", r"(?:\d{1,2}:[ar]?[+-]?\d{0,12}\.?\d{1,12};?)+")
SETTINGS = _form("`<name><axis>:<value>` lines", r"#.*|[a-z_]{1,10}\d{1,2}\s*:.*", many=True)
VERSION = _form("the version", r".*\bsmc\b.*")
PROGRAM = _form("program lines", r"(?!-?\d+$).+", many=True)  # no command of a program is a number alone

ASK_STATUS = Query("?s", STATUS)
ASK_POSITIONS = Query("?p", POSITIONS)
ASK_ENCODERS = Query("?e", POSITIONS)
ASK_ERRORS = Query("?err", ERRORS)
ASK_TARGETS = Query("?tb", TARGETS)
ASK_SETTINGS = Query("?conf", SETTINGS)
ASK_VERSION = Query("?v", VERSION)
ASK_PROGRAM = Query("?pgm", PROGRAM)
ASK_INPUTS = Query("?in", PORT)
ASK_OUTPUTS = Query("?out", PORT)
ASK_USER_STATUS = Query("?us", NUMBER)

_NUMBER_FIRST = re.compile(r"[+-]?\d*\.?\d+")


class Bits:
    """Bits of ?s (L4296-L4308, L1406)."""

    READY = 1
    REFERENCED = 2
    LIMIT_REVERSE = 4
    LIMIT_FORWARD = 8
    PROGRAM = 64
    IDLE = 128
    OSCILLATING = 256
    ENCODER_ERROR = 512
    BLOCKED = 16384


def entries(text: str) -> dict[int, str]:
    """`1:a;2:b;` by axis."""
    pairs = (item.split(":", 1) for item in text.split(";") if item.strip())
    return {int(number): value.strip() for number, value in pairs}


def states(text: str) -> dict[int, int]:
    """The bits of ?s by axis."""
    return {number: int(value) for number, value in entries(text).items()}


def number_in(text: str) -> str | None:
    """The number at the beginning, without the unit that `pqrf1` appends (L1101); None for `osc` (L4230)."""
    found = _NUMBER_FIRST.match(text)
    return None if found is None else found[0]


def errors(lines: list[str]) -> dict[int, tuple[int, str]]:
    """Number and text of the last error by axis; 0 is none."""
    found: dict[int, tuple[int, str]] = {}
    for line in lines:
        axis, _, rest = line.partition(":")
        number, _, text = rest.partition(" ")
        found[int(axis)] = (int(number), text.strip())
    return found


def settings(lines: list[str]) -> dict[int, dict[str, str]]:
    """Values of ?conf by axis and name."""
    found: dict[int, dict[str, str]] = {}
    for line in lines:
        match = re.fullmatch(r"([a-z_]+)(\d+)\s*:\s*(.*)", line, re.IGNORECASE)
        if match is not None:
            found.setdefault(int(match[2]), {})[match[1].lower()] = match[3].strip()
    return found
