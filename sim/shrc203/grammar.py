"""Pieces of the command language: axis letters, numbers, units."""

import re
from collections.abc import Sequence
from fractions import Fraction

from orchestrator.model.errors import TuttiError
from sim.shrc203.axis import StageAxis
from sim.shrc203.options import DIVISIONS

MAX_PULSES = 999_999_999
"""Largest movement amount and coordinate, pls (L3057)."""
MAX_SPEED = 1_000_000
"""Largest speed, pls/s (L3151)."""
MAX_RAMP_MS = 1000
"""Longest acceleration time, ms (L3157)."""

GROUPS: dict[str, tuple[int, ...]] = {
    "1": (0,),
    "2": (1,),
    "3": (2,),
    "A": (0, 1),
    "B": (0, 2),
    "C": (1, 2),
    "D": (0, 1, 2),
}
"""Axis letters and their axis indices; W, or nothing where allowed, is all controllable axes."""

NUMBER = r"\d+(?:\.\d+)?"
TRIPLE = re.compile(rf"S({NUMBER})F({NUMBER})R(\d+)")
_NM_PER_UNIT = {"N": 1, "U": 1_000, "M": 1_000_000}


class CommandRefused(TuttiError):
    """The command is answered NG."""


def parse_integer(text: str, low: int, high: int) -> int:
    """Parse `text` as a plain decimal integer in [low, high]; a sign only where `low` is negative."""
    digits = text[1:] if text[:1] in ("-", "+") and low < 0 else text
    if not (digits.isascii() and digits.isdigit()) or len(digits) > 12:
        raise CommandRefused
    value = int(text)
    if not low <= value <= high:
        raise CommandRefused
    return value


def parse_division(text: str) -> int:
    """Parse a division number of the motor driver (L2548)."""
    value = parse_integer(text, 1, 8000)
    if value not in DIVISIONS:
        raise CommandRefused
    return value


def round_nearest(value: Fraction) -> int:
    """Round to the nearest integer, halves away from zero (decision 36)."""
    magnitude = (2 * abs(value.numerator) + value.denominator) // (2 * value.denominator)
    return magnitude if value >= 0 else -magnitude


def pulse_size(axis: StageAxis, unit: str) -> Fraction:
    """Return one pulse in `unit` (N, U, M or D; P and F: 1). D exists on rotary stages only."""
    if unit in "PF":
        return Fraction(1)
    if unit == "D":
        if axis.deg_per_pulse is None:
            raise CommandRefused
        return axis.deg_per_pulse
    return axis.nm_per_pulse / _NM_PER_UNIT[unit]


def parse_pulses(axis: StageAxis, unit: str, number: str, maximum: int = MAX_PULSES) -> int:
    """Convert an amount (no sign) in `unit` to pulses. Pulses themselves are whole."""
    if unit in "PF":
        return parse_integer(number, 0, maximum)
    if len(number) > 24:
        raise CommandRefused
    value = round_nearest(Fraction(number) / pulse_size(axis, unit))
    if value > maximum:
        raise CommandRefused
    return value


def parse_speed(axis: StageAxis, unit: str, number: str) -> int:
    """Convert a speed in `unit` per second to pls/s, 1 to 1,000,000; a converted one is at least 1 (decision 36)."""
    if unit in "PF":
        return parse_integer(number, 1, MAX_SPEED)
    if Fraction(number) == 0:
        raise CommandRefused
    return max(1, parse_pulses(axis, unit, number, MAX_SPEED))


def format_decimal(value: Fraction, decimals: int | None = None) -> str:
    """Format a plain decimal; up to nine decimals without trailing zeros, or exactly `decimals`."""
    places = 9 if decimals is None else decimals
    number = round_nearest(abs(value) * 10**places)
    sign = "-" if value < 0 and number else ""
    integer, fraction = divmod(number, 10**places)
    text = f"{fraction:0{places}d}" if places else ""
    if decimals is None:
        text = text.rstrip("0")
    return f"{sign}{integer}.{text}" if text else f"{sign}{integer}"


def format_in_unit(axis: StageAxis, unit: str, value: int) -> str:
    """Format pulses (or pls/s) in `unit`, without letter, minus sign only (decision 15)."""
    return str(value) if unit in "PF" else format_decimal(value * pulse_size(axis, unit))


def split_repeated(pattern: re.Pattern[str], text: str, count: int) -> list[re.Match[str]]:
    """Match `text` as exactly `count` repetitions of `pattern`, one after the other."""
    matches: list[re.Match[str]] = []
    at = 0
    for _ in range(count):
        match = pattern.match(text, at)
        if match is None or match.end() == at:
            raise CommandRefused
        matches.append(match)
        at = match.end()
    if at != len(text):
        raise CommandRefused
    return matches


def axis_letter(axes: Sequence[StageAxis]) -> str:
    """Return the axis letter of these axes, as the replies of ?:K and ?:E name them."""
    indices = tuple(axis.index for axis in axes)
    return next(letter for letter, group in GROUPS.items() if group == indices)
