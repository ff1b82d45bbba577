"""Words of the command language: numbers, axes and names (sections 2 and 16, decision 24)."""

import re
from fractions import Fraction

from orchestrator.model.errors import TuttiError

_DECIMAL = re.compile(r"[+-]?(?:\d{1,20}\.?\d{0,20}|\.\d{1,20})")
_INTEGER = re.compile(r"[+-]?\d{1,20}")
_NAME = re.compile(r"(\?|\*)?([a-z_]*)(.*)", re.IGNORECASE | re.DOTALL)
_AXIS = re.compile(r"(\d{1,3})")
_COLON = re.compile(r"[ \t]*:[ \t]*")


class InputRefused(TuttiError):
    """A command that is not carried out, with the reason; the client receives it with echo 1 and 2 only."""


def split_name(line: str) -> tuple[str, str]:
    """Split a command line into its name (lower case, with a leading `?` or `*`) and the rest."""
    match = _NAME.fullmatch(line)
    assert match is not None
    arguments = _COLON.sub(":", match[3].strip(), count=1)
    return (match[1] or "") + match[2].lower(), arguments


def parse_decimal(text: str) -> Fraction:
    """Parse a decimal number, exactly. Raises `InputRefused`."""
    text = text.strip()
    if not _DECIMAL.fullmatch(text):
        raise InputRefused(f"'{text}' is not a number")
    return Fraction(text.rstrip(".") if text.endswith(".") else text)


def parse_integer(text: str, low: int, high: int) -> int:
    """Parse an integer from `low` to `high`. Raises `InputRefused`."""
    text = text.strip()
    if not _INTEGER.fullmatch(text):
        raise InputRefused(f"'{text}' is not an integer")
    value = int(text)
    if not low <= value <= high:
        raise InputRefused(f"value {text} out of range")
    return value


def split_axis(rest: str) -> tuple[int | None, str]:
    """Return the axis number at the start of `rest`, if any, and the remaining text."""
    match = _AXIS.match(rest)
    return (int(match[1]), rest[match.end() :]) if match else (None, rest)


def text_after_colon(rest: str) -> str:
    """Return the text after the mandatory colon. Raises `InputRefused`."""
    if not rest.startswith(":"):
        raise InputRefused("':' missing")
    return rest[1:].strip()


def require_end(rest: str) -> None:
    """Raise `InputRefused` if any text follows a command without argument."""
    if rest:
        raise InputRefused(f"'{rest}' not expected")


def parse_direction(text: str) -> int:
    """Parse `+` or `-`. Raises `InputRefused`."""
    if text not in ("+", "-"):
        raise InputRefused("direction missing")
    return 1 if text == "+" else -1


def round_nearest(value: Fraction) -> int:
    """Round to the nearest integer, halves away from zero."""
    return _divide_rounded(value.numerator, value.denominator)


def _divide_rounded(over: int, under: int) -> int:
    """Divide over / under, under > 0, rounded to the nearest integer, halves away from zero."""
    quotient = (2 * abs(over) + under) // (2 * under)
    return quotient if over >= 0 else -quotient


def format_decimal(value: Fraction, decimals: int = 12, *, zeros: bool = False) -> str:
    """Format with at most `decimals` decimals, and trailing zeros removed unless `zeros` (decision 6)."""
    number = _divide_rounded(value.numerator * 10**decimals, value.denominator)
    digits = str(abs(number)).rjust(decimals + 1, "0")
    integer, part = digits[:-decimals], digits[-decimals:]
    if not zeros:
        part = part.rstrip("0")
    return ("-" if number < 0 else "") + integer + ("." + part if part else "")
