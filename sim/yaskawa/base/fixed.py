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


def clamp(raw: int) -> int:
    """`raw` held inside the range of the dialect."""
    return MAXIMUM if raw > MAXIMUM else MINIMUM if raw < MINIMUM else raw


def of(value: float) -> int:
    """The nearest fixed-point value of a real number."""
    if value != value or value in (float("inf"), float("-inf")):
        raise CommandError(6)
    return clamp(round(value * ONE))


def whole(value: int) -> int:
    """Fixed point of an integer."""
    return value * ONE


def truncated(raw: int) -> int:
    """The integer part, toward zero: what integer commands make of a fraction."""
    return raw >> 16 if raw >= 0 else -(-raw >> 16)


def multiply(a: int, b: int) -> int:
    """Product, cut to 1/65536."""
    product = a * b
    return clamp(product >> 16 if product >= 0 else -(-product >> 16))


def divide(a: int, b: int) -> int:
    """Quotient, cut to 1/65536. Division by zero is an operand error."""
    if b == 0:
        raise CommandError(4)
    quotient = (abs(a) << 16) // abs(b)
    return clamp(quotient if (a < 0) == (b < 0) else -quotient)


def literal(text: str) -> int:
    """A decimal or `$` hexadecimal literal without sign."""
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


def of_string(text: str) -> int:
    """The 48 bits of a string of up to 6 characters."""
    if len(text) > STRING_LENGTH:
        raise CommandError(52)
    bits = int.from_bytes(text.encode("latin-1").ljust(STRING_LENGTH, b"\0"), "big")
    return bits - (1 << 48) if bits >= 1 << 47 else bits


def to_string(raw: int, length: int = STRING_LENGTH) -> str:
    """The characters that the 48 bits of `raw` stand for, at most `length`, without trailing NULs."""
    bits = (raw & ((1 << 48) - 1)).to_bytes(STRING_LENGTH, "big")
    return bits[:length].rstrip(b"\0").decode("latin-1")


def wrapped(counts: int) -> int:
    """A position in 32 bits: it wraps beyond +/-2^31 counts."""
    return (counts + 0x80000000 & 0xFFFFFFFF) - 0x80000000


def rounded(value: float) -> int:
    """The nearest integer, halves upward."""
    return floor(value + 0.5)
