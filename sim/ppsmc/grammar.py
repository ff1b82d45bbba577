"""Words of the command language: numbers, axes and names (sections 2 and 16, decision 24)."""

import re
from fractions import Fraction

_DECIMAL = re.compile(r"[+-]?(?:\d{1,20}\.?\d{0,20}|\.\d{1,20})")
_INTEGER = re.compile(r"[+-]?\d{1,20}")
_NAME = re.compile(r"(\?|\*)?([a-z_]*)(.*)", re.IGNORECASE | re.DOTALL)
_AXIS = re.compile(r"(\d{1,3})")
_COLON = re.compile(r"[ \t]*:[ \t]*")


class Refused(Exception):
    """A command that is not carried out. Says why; the client sees it with echo 1 and 2 only."""


def split_name(line: str) -> tuple[str, str]:
    """Name (lower case, with a leading `?` or `*`) and the rest of a command line."""
    match = _NAME.fullmatch(line)
    assert match is not None
    rest = _COLON.sub(":", match[3].strip(), count=1)
    return (match[1] or "") + match[2].lower(), rest


def decimal(text: str) -> Fraction:
    """A decimal number, exactly. Raises `Refused`."""
    text = text.strip()
    if not _DECIMAL.fullmatch(text):
        raise Refused(f"'{text}' is not a number")
    return Fraction(text.rstrip(".") if text.endswith(".") else text)


def integer(text: str, low: int, high: int) -> int:
    """An integer from `low` to `high`. Raises `Refused`."""
    text = text.strip()
    if not _INTEGER.fullmatch(text):
        raise Refused(f"'{text}' is not an integer")
    value = int(text)
    if not low <= value <= high:
        raise Refused(f"value {text} out of range")
    return value


def leading_axis(rest: str) -> tuple[int | None, str]:
    """The axis number at the start of `rest`, if any, and what follows it."""
    match = _AXIS.match(rest)
    return (int(match[1]), rest[match.end() :]) if match else (None, rest)


def after_colon(rest: str) -> str:
    """What follows the obligatory colon. Raises `Refused`."""
    if not rest.startswith(":"):
        raise Refused("':' missing")
    return rest[1:].strip()


def nothing(rest: str) -> None:
    """Raises `Refused` if anything follows a command without argument."""
    if rest:
        raise Refused(f"'{rest}' not expected")


def direction(text: str) -> int:
    """`+` or `-`. Raises `Refused`."""
    if text not in ("+", "-"):
        raise Refused("direction missing")
    return 1 if text == "+" else -1


def rounded(value: Fraction) -> int:
    """To the nearest integer, halves away from zero."""
    return _divided(value.numerator, value.denominator)


def _divided(over: int, under: int) -> int:
    """over / under, under > 0, to the nearest integer, halves away from zero."""
    whole = (2 * abs(over) + under) // (2 * under)
    return whole if over >= 0 else -whole


def plain(value: Fraction, decimals: int = 12, zeros: bool = False) -> str:
    """As text with at most `decimals` decimals, and trailing zeros removed unless `zeros` (decision 6)."""
    scaled = _divided(value.numerator * 10**decimals, value.denominator)
    digits = str(abs(scaled)).rjust(decimals + 1, "0")
    whole, part = digits[:-decimals], digits[-decimals:]
    if not zeros:
        part = part.rstrip("0")
    return ("-" if scaled < 0 else "") + whole + ("." + part if part else "")
