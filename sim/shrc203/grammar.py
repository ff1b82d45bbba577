"""Pieces of the command language: axis letters, numbers, units."""

import re
from collections.abc import Sequence
from fractions import Fraction

from sim.shrc203.axis import Axis
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
"""Axis letters and the indices they stand for; W, or nothing where allowed, is all controllable axes."""

NUMBER = r"\d+(?:\.\d+)?"
TRIPLE = re.compile(rf"S({NUMBER})F({NUMBER})R(\d+)")
_NM_PER_UNIT = {"N": 1, "U": 1_000, "M": 1_000_000}


class Refused(Exception):
    """The command is answered NG."""


def integer(text: str, low: int, high: int) -> int:
    """`text` as a plain decimal integer in [low, high]; a sign only where `low` is negative."""
    digits = text[1:] if text[:1] in ("-", "+") and low < 0 else text
    if not (digits.isascii() and digits.isdigit()) or len(digits) > 12:
        raise Refused
    value = int(text)
    if not low <= value <= high:
        raise Refused
    return value


def division(text: str) -> int:
    """A division number of the motor driver (L2548)."""
    value = integer(text, 1, 8000)
    if value not in DIVISIONS:
        raise Refused
    return value


def nearest(value: Fraction) -> int:
    """Nearest integer, halves away from zero (decision 36)."""
    magnitude = (2 * abs(value.numerator) + value.denominator) // (2 * value.denominator)
    return magnitude if value >= 0 else -magnitude


def size(axis: Axis, unit: str) -> Fraction:
    """One pulse in `unit` (N, U, M or D; P and F: 1). D exists on rotary stages only."""
    if unit in "PF":
        return Fraction(1)
    if unit == "D":
        if axis.deg_per_pulse is None:
            raise Refused
        return axis.deg_per_pulse
    return axis.nm_per_pulse / _NM_PER_UNIT[unit]


def pulses(axis: Axis, unit: str, number: str, maximum: int = MAX_PULSES) -> int:
    """An amount (no sign) in `unit` as pulses. Pulses themselves are whole."""
    if unit in "PF":
        return integer(number, 0, maximum)
    if len(number) > 24:
        raise Refused
    value = nearest(Fraction(number) / size(axis, unit))
    if value > maximum:
        raise Refused
    return value


def speed(axis: Axis, unit: str, number: str) -> int:
    """A speed in `unit` per second as pls/s, 1 to 1,000,000; a converted one is at least 1 (decision 36)."""
    if unit in "PF":
        return integer(number, 1, MAX_SPEED)
    if Fraction(number) == 0:
        raise Refused
    return max(1, pulses(axis, unit, number, MAX_SPEED))


def decimal(value: Fraction, decimals: int | None = None) -> str:
    """Plain decimal; up to nine decimals without trailing zeros, or exactly `decimals`."""
    places = 9 if decimals is None else decimals
    scaled = nearest(abs(value) * 10**places)
    sign = "-" if value < 0 and scaled else ""
    whole, rest = divmod(scaled, 10**places)
    text = f"{rest:0{places}d}" if places else ""
    if decimals is None:
        text = text.rstrip("0")
    return f"{sign}{whole}.{text}" if text else f"{sign}{whole}"


def in_unit(axis: Axis, unit: str, value: int) -> str:
    """Pulses (or pls/s) in `unit`, without letter, minus sign only (decision 15)."""
    return str(value) if unit in "PF" else decimal(value * size(axis, unit))


def split_repeated(pattern: re.Pattern[str], text: str, count: int) -> list[re.Match[str]]:
    """`text` as exactly `count` repetitions of `pattern`, one after the other."""
    found: list[re.Match[str]] = []
    at = 0
    for _ in range(count):
        match = pattern.match(text, at)
        if match is None or match.end() == at:
            raise Refused
        found.append(match)
        at = match.end()
    if at != len(text):
        raise Refused
    return found


def letter_of(axes: Sequence[Axis]) -> str:
    """The axis letter of these axes, as the replies of ?:K and ?:E name them."""
    indices = tuple(axis.index for axis in axes)
    return next(letter for letter, group in GROUPS.items() if group == indices)
