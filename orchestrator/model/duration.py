"""Durations in files: text with a unit; whole nanoseconds in the program."""

import re
from decimal import Decimal
from typing import Annotated

from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema

from orchestrator.model.numbers import MAX_TEXT, suggest_number

_NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000, "min": 60_000_000_000, "h": 3_600_000_000_000}
_TEXT = re.compile(r"^\s*(\d+\.?\d*|\.\d+)\s*(ns|us|µs|ms|s|min|h)\s*$")

MAX_DURATION_NS = 24 * _NS["h"]


def parse_duration(value: object) -> int:
    """Parse `"10 ms"`, `"1.5 s"` or `"2 min"` to nanoseconds. A bare number is refused: its unit is ambiguous.

    Raises `ValueError`, also for negative durations and those above 24 h.
    """
    match = _TEXT.match(value) if isinstance(value, str) and len(value) <= MAX_TEXT else None
    if not match:
        text = value[:MAX_TEXT] if isinstance(value, str) else value
        hint = suggest_number(value) if isinstance(value, str) else ""
        hint = f" ({hint})" if hint else ""
        raise ValueError(
            f'{text!r} is not a duration; write a number and a unit (ns, us, ms, s, min, h), e.g. "10 ms"{hint}'
        )
    number, unit = match.groups()
    duration_ns = int(Decimal(number) * _NS[unit.replace("µ", "u")])
    if duration_ns > MAX_DURATION_NS:
        raise ValueError(f"{value} is too long; a duration is at most 24 h")
    return duration_ns


def format_ns(duration_ns: float) -> str:
    """Format a duration with three significant digits in the fitting unit, e.g. `1.25 ms`."""
    size = abs(duration_ns)
    for unit in ("s", "ms", "us"):
        if size >= _NS[unit]:
            return f"{duration_ns / _NS[unit]:.4g} {unit}"
    return f"{duration_ns:.0f} ns"


Duration = Annotated[
    int,
    BeforeValidator(parse_duration),
    Field(ge=0, le=MAX_DURATION_NS),
    PlainSerializer(lambda duration_ns: f"{duration_ns} ns"),
    WithJsonSchema({"type": "string", "pattern": _TEXT.pattern}),
]
"""A span of time: `"10 ms"` in a file, nanoseconds in the program."""
