"""Numbers and durations as people write them in files: with the unit that is expected, or explained."""

import re
from collections.abc import Mapping
from decimal import Decimal
from fractions import Fraction
from typing import Annotated

from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema

MAX_NUMBER = 1e12  # of any number in a file, in its unit
MAX_TEXT = 60  # characters of a number with its unit

_WITH_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,2})?)\s*([^\d\s.,:_+-][^\s,:_]*)?\s*", re.ASCII)
_SEXAGESIMAL = re.compile(r"[-+]?\d+(:[0-5]?\d)+(\.\d*)?")
_GROUPED = re.compile(r"[-+]?\d[\d_]*_[\d_]*(\.[\d_]*)?")
_DECIMAL_COMMA = re.compile(r"([-+]?\d+),(\d+)(\s*\S*)")
_YES = {"yes": "true", "on": "true", "y": "true", "no": "false", "off": "false", "n": "false"}


def split_number(text: str) -> tuple[str, str] | None:
    """Split text such as `"200 mm/s"` into its number and its unit, which may be empty; None if it is neither."""
    match = _WITH_UNIT.fullmatch(text[:MAX_TEXT])
    return None if match is None or len(text) > MAX_TEXT else (match[1], match[2] or "")


_ODD_SPACES = {
    "\t": ("a tab", "a space"),
    "\u00a0": ("a non-breaking space", "a plain one"),
    "\u202f": ("a narrow non-breaking space", "a plain one"),
}
_ODD_MINUSES = {
    "\u2212": ("a minus sign of typography", "-, the hyphen of the keyboard"),
    "\u2013": ("a dash", "-, the hyphen of the keyboard"),
}


def name_odd_sign(text: str, *, spaces: bool = True) -> str:
    """What to write instead of a sign that looks like another one, such as the minus of a text program; empty if there
    is none. spaces: whether a space of another kind is at fault, too."""
    for sign, (name, replacement) in (_ODD_MINUSES | (_ODD_SPACES if spaces else {})).items():
        if sign in text:
            return f"it has {name} (U+{ord(sign):04X}); write {replacement}"
    return ""


def suggest_number(text: str) -> str:
    """What to write instead of `text`, where a number is expected; empty if nothing is obvious."""
    if (odd_sign := name_odd_sign(text, spaces=False)) != "":
        return odd_sign
    text = text.strip()[:MAX_TEXT]
    if _SEXAGESIMAL.fullmatch(text):
        total, sign = Fraction(0), -1 if text.startswith("-") else 1
        for part in text.lstrip("+-").split(":"):
            total = total * 60 + Fraction(part)
        return f"if {float(sign * total):g} is meant, write {float(sign * total):g}"
    if _GROUPED.fullmatch(text):
        return f"write {text.replace('_', '')}"
    if (comma := _DECIMAL_COMMA.fullmatch(text)) is not None:
        return f"write the number with a point: {comma[1]}.{comma[2]}{comma[3]}"
    if split_number(text) is not None:
        return f"write it without quotes: {text}" if text[-1].isdigit() else ""
    return ""


def suggest_flag(text: str) -> str:
    """What to write instead of `text`, where true or false is expected."""
    return f"write {_YES.get(text.strip().lower(), 'true or false')}"


def accept_units(sizes: Mapping[str, Fraction]) -> BeforeValidator:
    """Accept text with one of the units of `sizes`, each by its size in the field's own unit, beside a plain number."""
    units = ", ".join(sizes)

    def convert(value: object) -> object:
        if not isinstance(value, str):
            return value
        parts = split_number(value)
        if parts is None or parts[1] not in sizes:
            hint = suggest_number(value) if parts is None or not parts[1] else ""
            example = f'write a number, or a number with its unit, e.g. "10 {next(iter(sizes))}" (units: {units})'
            raise ValueError(f"found {value[:MAX_TEXT]!r}; {hint or example}")
        return float(Fraction(parts[0]) * sizes[parts[1]])

    return BeforeValidator(convert)


_NUMBER_OR_TEXT = WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]})
SECONDS = {
    "s": Fraction(1),
    "ms": Fraction(1, 1000),
    "us": Fraction(1, 10**6),
    "min": Fraction(60),
    "h": Fraction(3600),
}

Positive = Annotated[float, Field(gt=0, le=MAX_NUMBER)]

UnitNumber = Annotated[Positive, _NUMBER_OR_TEXT]
"""A number in the unit of its axis; text with a unit is converted by the axis."""

SignedNumber = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER), _NUMBER_OR_TEXT]
"""The same, of both signs."""

Part = Annotated[float, accept_units({"%": Fraction(1, 100)}), Field(gt=0, le=1), _NUMBER_OR_TEXT]
"""A fraction, above 0 to 1; in a file also `"50%"`."""

Seconds = Annotated[float, accept_units(SECONDS), _NUMBER_OR_TEXT]
"""Seconds; in a file also text with a unit, `"500 ms"`."""

Hertz = Annotated[float, accept_units({"Hz": Fraction(1), "kHz": Fraction(1000)}), _NUMBER_OR_TEXT]
"""Hz; in a file also text with the unit, `"10 Hz"`."""


# Durations

_SIZES_NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000, "min": 60_000_000_000, "h": 3_600_000_000_000}
_DURATION = re.compile(r"^\s*(\d+\.?\d*|\.\d+)\s*(ns|us|µs|ms|s|min|h)\s*$")

MAX_DURATION_NS = 24 * _SIZES_NS["h"]


def parse_duration(value: object) -> int:
    """Parse `"10 ms"`, `"1.5 s"` or `"2 min"` to nanoseconds. A bare number is refused: its unit is ambiguous.

    Raises `ValueError`, also for negative durations and those above 24 h.
    """
    match = _DURATION.match(value) if isinstance(value, str) and len(value) <= MAX_TEXT else None
    if not match:
        text = value[:MAX_TEXT] if isinstance(value, str) else value
        hint = suggest_number(value) if isinstance(value, str) else ""
        hint = f" ({hint})" if hint else ""
        raise ValueError(
            f'{text!r} is not a duration; write a number and a unit (ns, us, ms, s, min, h), e.g. "10 ms"{hint}'
        )
    number, unit = match.groups()
    duration_ns = int(Decimal(number) * _SIZES_NS[unit.replace("µ", "u")])
    if duration_ns > MAX_DURATION_NS:
        raise ValueError(f"{value} is too long; a duration is at most 24 h")
    return duration_ns


def format_ns(duration_ns: float) -> str:
    """Format a duration with three significant digits in the fitting unit, e.g. `1.25 ms`."""
    size = abs(duration_ns)
    for unit in ("s", "ms", "us"):
        if size >= _SIZES_NS[unit]:
            return f"{duration_ns / _SIZES_NS[unit]:.4g} {unit}"
    return f"{duration_ns:.0f} ns"


Duration = Annotated[
    int,
    BeforeValidator(parse_duration),
    Field(ge=0, le=MAX_DURATION_NS),
    PlainSerializer(lambda duration_ns: f"{duration_ns} ns"),
    WithJsonSchema({"type": "string", "pattern": _DURATION.pattern}),
]
"""A span of time: `"10 ms"` in a file, nanoseconds in the program."""
