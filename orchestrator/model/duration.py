"""Durations in files: text with a unit; whole nanoseconds in the program."""

import re
from decimal import Decimal
from typing import Annotated

from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema

_NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000, "min": 60_000_000_000, "h": 3_600_000_000_000}
_TEXT = re.compile(r"^\s*(\d+\.?\d*|\.\d+)\s*(ns|us|µs|ms|s|min|h)\s*$")


def parse_duration(value: object) -> int:
    """Parse `"10 ms"`, `"1.5 s"` or `"2 min"` to nanoseconds. A bare number is refused: its unit is ambiguous."""
    found = _TEXT.match(value) if isinstance(value, str) else None
    if not found:
        raise ValueError(
            f'{value!r} is not a duration; write a number and a unit (ns, us, ms, s, min, h), e.g. "10 ms"'
        )
    number, unit = found.groups()
    return int(Decimal(number) * _NS[unit.replace("µ", "u")])


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
    Field(ge=0, le=24 * 3600 * 10**9),
    PlainSerializer(lambda duration_ns: f"{duration_ns} ns"),
    WithJsonSchema({"type": "string", "pattern": _TEXT.pattern}),
]
"""A span of time: `"10 ms"` in a file, nanoseconds in the program."""
