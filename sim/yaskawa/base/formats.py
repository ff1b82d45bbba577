"""Formats of numbers: PF, VF, LZ and local formats (L8272-L8334, L11351-L11392, L16184-L16322)."""

from dataclasses import dataclass

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError


@dataclass(frozen=True, slots=True)
class NumberLayout:
    """Options of all formatted numbers: leading zeros (`LZ`), and whether a positive number has a blank in front."""

    strip_zeros: bool = False
    sign_column: bool = True


@dataclass(frozen=True, slots=True)
class NumberFormat:
    """`digits` before the point and `decimals` after it; `hexadecimal` with a `$` in front."""

    digits: int
    decimals: int
    hexadecimal: bool = False

    @classmethod
    def from_number(cls, raw: int) -> "NumberFormat":
        """Return the format `m.n` given as a number: -8..10 and 0..4 (L8308)."""
        negative, size = raw < 0, abs(raw)
        digits, decimals = size >> 16, fixed.round_half_up((size & 0xFFFF) * 10 / fixed.ONE)
        if digits > (8 if negative else 10) or decimals > 4:
            raise CommandError(6)
        return cls(digits, decimals, negative)

    @property
    def as_number(self) -> int:
        """Return the format as the operands `_PF` and `_VF` give it."""
        size = fixed.from_real(self.digits + self.decimals / 10)
        return -size if self.hexadecimal else size

    def format_value(self, raw: int, layout: NumberLayout) -> str:
        """Format `raw`; a number that does not fit is shown as nines (hexadecimal: the nearest end)."""
        if self.hexadecimal:
            return self._format_hex(raw, layout)
        number = fixed.round_half_up(abs(raw) * 10**self.decimals / fixed.ONE)
        limit = 10 ** (self.digits + self.decimals)
        number = min(number, limit - 1)
        text = str(number).rjust(self.digits + self.decimals, "0")
        point = len(text) - self.decimals
        head, tail = text[:point], text[point:]
        if layout.strip_zeros:
            head = head.lstrip("0") or "0"
        sign = "-" if raw < 0 else " " if layout.sign_column else ""
        return f"{sign}{head}.{tail}" if self.decimals else f"{sign}{head}"

    def _format_hex(self, raw: int, layout: NumberLayout) -> str:
        bits = 4 * self.digits
        lowest, highest = -(1 << bits) // 2 << 16, ((1 << bits) // 2 << 16) - 1
        raw = lowest if raw < lowest else highest if raw > highest else raw
        head = f"{(raw >> 16) & ((1 << bits) - 1):0{max(self.digits, 1)}X}"
        if layout.strip_zeros:
            head = head.lstrip("0") or "0"
        tail = f"{raw & 0xFFFF:04X}"[: self.decimals]
        return f"${head}.{tail}" if self.decimals else f"${head}"
