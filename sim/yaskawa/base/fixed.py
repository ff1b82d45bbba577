"""Numbers of the dialect: 48-bit fixed point, 32 integer bits and 16 fraction bits (L15711, L15617).

A value is a Python `int` in units of 1/65536. A string of up to 6 characters is the same 48 bits,
first character highest (L15743).
"""

from math import floor

from sim.yaskawa.base.errors import CommandError

ONE = 65536
MAXIMUM = (1 << 47) - 1
MINIMUM = -(1 << 47)
STRING_LENGTH = 6


def clamp_range(raw: int) -> int:
    """Limit `raw` to the range of the dialect."""
    return MAXIMUM if raw > MAXIMUM else MINIMUM if raw < MINIMUM else raw


def from_real(value: float) -> int:
    """Return the nearest fixed-point value of a real number."""
    if value != value or value in (float("inf"), float("-inf")):
        raise CommandError(6)
    return clamp_range(round(value * ONE))


def from_integer(value: int) -> int:
    """Return the fixed-point value of an integer."""
    return value * ONE


def to_integer(raw: int) -> int:
    """Return the integer part, toward zero: the value that integer commands use of a fraction."""
    return raw >> 16 if raw >= 0 else -(-raw >> 16)


def multiply_fixed(a: int, b: int) -> int:
    """Multiply; the product is cut to 1/65536."""
    product = a * b
    return clamp_range(product >> 16 if product >= 0 else -(-product >> 16))


def divide_fixed(a: int, b: int) -> int:
    """Divide; the quotient is cut to 1/65536. Division by zero is an operand error."""
    if b == 0:
        raise CommandError(4)
    quotient = (abs(a) << 16) // abs(b)
    return clamp_range(quotient if (a < 0) == (b < 0) else -quotient)


def parse_literal(text: str) -> int:
    """Parse a decimal or `$` hexadecimal literal without sign."""
    if text.startswith("$"):
        head, _, tail = text[1:].partition(".")
        raw = int(head or "0", 16) << 16
        if tail:
            raw += int((tail + "0000")[:4], 16)
        if raw >= 1 << 48:
            raise CommandError(6)
        return raw - (1 << 48) if raw >= 1 << 47 else raw
    head, _, tail = text.partition(".")
    raw = int(head or "0") * ONE
    if tail:
        raw += int(tail) * ONE // 10 ** len(tail)
    if raw > MAXIMUM + 1:
        raise CommandError(6)
    return raw


def from_string(text: str) -> int:
    """Pack a string of up to 6 characters into 48 bits."""
    if len(text) > STRING_LENGTH:
        raise CommandError(52)
    bits = int.from_bytes(text.encode("latin-1").ljust(STRING_LENGTH, b"\0"), "big")
    return bits - (1 << 48) if bits >= 1 << 47 else bits


def to_string(raw: int, length: int = STRING_LENGTH) -> str:
    """Return the characters in the 48 bits of `raw`, at most `length`, without trailing NULs."""
    bits = (raw & ((1 << 48) - 1)).to_bytes(STRING_LENGTH, "big")
    return bits[:length].rstrip(b"\0").decode("latin-1")


def wrap_counts(counts: int) -> int:
    """Wrap a position to 32 bits, beyond +/-2^31 counts."""
    return (counts + 0x80000000 & 0xFFFFFFFF) - 0x80000000


def round_half_up(value: float) -> int:
    """Round to the nearest integer, halves upward."""
    return floor(value + 0.5)
