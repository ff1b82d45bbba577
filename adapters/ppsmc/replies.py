"""Reply formats and their parsing. Layouts are those of the manual where it has them, otherwise of controllers in the
field."""

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class PpSmcReplyFormat:
    """The format of a reply. many: it may be any number of lines."""

    words: str
    pattern: re.Pattern[str]
    many: bool = False

    def matches_text(self, text: str) -> bool:
        return self.pattern.fullmatch(text) is not None


class FormattedQuery(NamedTuple):
    """A query and the format of its reply."""

    text: str
    form: PpSmcReplyFormat


def _make_format(words: str, pattern: str, *, many: bool = False) -> PpSmcReplyFormat:
    return PpSmcReplyFormat(words, re.compile(pattern, re.IGNORECASE | re.ASCII), many)


NUMBER = _make_format("a number", r"-?\d{1,10}")
PORT = _make_format("a byte", r"0*(?:25[0-5]|2[0-4]\d|1?\d?\d)")
STATUS = _make_format("`<axis>:<state>;` for each axis", r"(?:\d{1,2}:\d{1,10};)+")
POSITIONS = _make_format(
    "`<axis>:<position>;` for each axis", r"(?:\d{1,2}:(?:osc|[+-]?\d{0,12}\.?\d{1,12}[^;:\d]{0,3});)+"
)
ERRORS = _make_format("`<axis>:<number> <text>` for each axis", r"\d{1,2}:\d{1,6}(?: .*)?", many=True)
TARGETS = _make_format("`<axis>:<target>;` for each axis", r"(?:\d{1,2}:[ar]?[+-]?\d{0,12}\.?\d{1,12};?)+")
SETTINGS = _make_format("`<name><axis>:<value>` lines", r"#.*|[a-z_]{1,10}\d{1,2}\s*:.*", many=True)
VERSION = _make_format("the version", r".*\bsmc\b.*")
PROGRAM = _make_format("program lines", r"(?!-?\d+$).+", many=True)  # no command of a program is only a number

ASK_STATUS = FormattedQuery("?s", STATUS)
ASK_POSITIONS = FormattedQuery("?p", POSITIONS)
ASK_ENCODERS = FormattedQuery("?e", POSITIONS)
ASK_ERRORS = FormattedQuery("?err", ERRORS)
ASK_TARGETS = FormattedQuery("?tb", TARGETS)
ASK_SETTINGS = FormattedQuery("?conf", SETTINGS)
ASK_VERSION = FormattedQuery("?v", VERSION)
ASK_PROGRAM = FormattedQuery("?pgm", PROGRAM)
ASK_INPUTS = FormattedQuery("?in", PORT)
ASK_OUTPUTS = FormattedQuery("?out", PORT)
ASK_USER_STATUS = FormattedQuery("?us", NUMBER)

_NUMBER_FIRST = re.compile(r"[+-]?\d{0,12}\.?\d{1,12}(?!\d|\.\d|e[+-]?\d)", re.ASCII | re.IGNORECASE)


class StatusBits:
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


def parse_entries(text: str) -> dict[int, str]:
    """Parse `1:a;2:b;`, by axis."""
    pairs = (item.split(":", 1) for item in text.split(";") if item.strip())
    return {int(number): value.strip() for number, value in pairs}


def parse_states(text: str) -> dict[int, int]:
    """Return the bits of ?s by axis."""
    return {number: int(value) for number, value in parse_entries(text).items()}


def leading_number(text: str) -> str | None:
    """Return the number at the beginning, without the unit that `pqrf1` appends (L1101); None for `osc` (L4230), and
    for a number with an exponent or more digits than the controller has: `1e999999999` would be computed for ever."""
    number_match = _NUMBER_FIRST.match(text)
    return None if number_match is None else number_match[0]


def parse_setting(text: str) -> Fraction | None:
    """Return the value of a setting that is a plain number; None for anything else."""
    return Fraction(text) if leading_number(text) == text else None


def parse_errors(lines: list[str]) -> dict[int, tuple[int, str]]:
    """Return number and text of the last error by axis; 0 is none."""
    errors: dict[int, tuple[int, str]] = {}
    for line in lines:
        axis, _, error_text = line.partition(":")
        number, _, text = error_text.partition(" ")
        errors[int(axis)] = (int(number), text.strip())
    return errors


def parse_settings(lines: list[str]) -> dict[int, dict[str, str]]:
    """Return the values of ?conf by axis and name."""
    settings: dict[int, dict[str, str]] = {}
    for line in lines:
        match = re.fullmatch(r"([a-z_]{1,10})([0-9]{1,2})\s*:\s*(.*)", line, re.IGNORECASE)
        if match is not None:
            settings.setdefault(int(match[2]), {})[match[1].lower()] = match[3].strip()
    return settings
