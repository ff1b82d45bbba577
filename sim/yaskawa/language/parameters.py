"""Parameters of axes: one table for setting, querying (`?`) and reading (`_XX`) them."""

from dataclasses import dataclass

from sim.yaskawa.base import fixed
from sim.yaskawa.base.formats import NumberFormat


@dataclass(frozen=True, slots=True)
class AxisParameter:
    """A parameter of an axis, raw values of 1/65536.

    quantum: step, values are cut to it toward zero.
    format: of the answer to `?`, None for PF.
    moving: may be set while its axis moves.
    magnitude: a negative value counts as positive.
    virtual: axis N has it.
    asked: accepts `?`.
    nearest: the value is rounded to the nearest step instead.
    """

    low: int
    high: int
    default: int
    quantum: int = fixed.ONE
    format: NumberFormat | None = None
    moving: bool = True
    magnitude: bool = False
    virtual: bool = False
    asked: bool = True
    nearest: bool = False

    def accept_value(self, raw: int) -> int | None:
        """Return the stored value, or None when it is out of range."""
        if self.magnitude:
            raw = abs(raw)
        if not self.low <= raw <= self.high:
            return None
        size = abs(raw) + (self.quantum // 2 if self.nearest else 0)
        kept_size = size // self.quantum * self.quantum
        return kept_size if raw >= 0 else -kept_size


def make_parameter(
    low: float, high: float, default: float, step: float = 1.0, shape: str = "", **flags: bool
) -> AxisParameter:
    """Make a parameter from real numbers; `shape` is the format `m.n`."""
    layout = None
    if shape:
        digits, decimals = shape.split(".")
        layout = NumberFormat(int(digits), int(decimals))
    return AxisParameter(
        fixed.from_real(low),
        fixed.from_real(high),
        fixed.from_real(default),
        max(fixed.from_real(step), 1),
        layout,
        **flags,
    )


FINE = 1 / fixed.ONE
LARGEST, LEAST = 2147483647, -2147483648

SMC4000: dict[str, AxisParameter] = {
    "AC": make_parameter(1024, 67107840, 256000, 1024, "8.0", virtual=True),  # L2288
    "DC": make_parameter(1024, 67107840, 256000, 1024, "8.0", virtual=True),  # L4028
    "SP": make_parameter(0, 12000000, 25000, 2, magnitude=True, virtual=True),  # L10027
    "JG": make_parameter(-12000000, 12000000, 25000, 2, virtual=True),  # L6363
    "PR": make_parameter(LEAST, LARGEST, 0, moving=False, virtual=True),  # L8388
    "PA": make_parameter(LEAST, LARGEST, 0, moving=False, virtual=True),  # L8205
    "IT": make_parameter(0.004, 1, 1, 1 / 256, "1.4", virtual=True, nearest=True),  # L6316, L6358
    "KS": make_parameter(0.5, 16, 1.313, 1 / 32, "4.3"),  # L6655
    "LT": make_parameter(LEAST, LARGEST, 0),  # L7138
    "TW": make_parameter(-1, 32766, 32766),  # L11047
    "EM": make_parameter(LEAST, LARGEST, 0, virtual=True),  # L4694
    "GR": make_parameter(-127.9999, 127.9999, 0, FINE, "3.4", virtual=True),  # L5535
    "BL": make_parameter(LEAST, LARGEST, LEAST),  # L3180
    "FL": make_parameter(LEAST, LARGEST, LARGEST),  # L5279
    "CE": make_parameter(0, 15, 0, shape="2.0"),  # L3490, L3534
    "DV": make_parameter(0, 1, 0, shape="1.0"),  # L4332
    "ER": make_parameter(0, 32767, 16384),  # L4957
    "FA": make_parameter(0, 8191, 0, 0.25, "4.0"),  # L5112
    "FV": make_parameter(0, 8192, 0, shape="4.0"),  # L5373
    "IL": make_parameter(-10, 10, 10, FINE, "1.4"),  # L6049
    "KD": make_parameter(0, 4095.875, 10, 0.125, "4.2"),  # L6523
    "KI": make_parameter(0, 2047.875, 0, 0.125, "4.0"),  # L6569
    "KP": make_parameter(0, 1023.875, 1, 0.125, "4.2"),  # L6617
    "MT": make_parameter(-2.5, 2.5, 1, 0.5, "1.1", moving=False),  # L7678
    "NB": make_parameter(0, 250, 0.5, FINE, "3.1"),  # L7832
    "NF": make_parameter(0, 250, 0, FINE, "3.1"),  # L7871
    "NZ": make_parameter(0, 250, 0.5, FINE, "3.1"),  # L7955
    "OE": make_parameter(0, 1, 0, shape="1.0"),  # L8024
    "OF": make_parameter(-9.9988, 9.9988, 0, FINE, "1.4"),  # L8067
    "PL": make_parameter(0, 0.9999, 0, FINE, "1.4"),  # L8335
    "TK": make_parameter(0, 9.9988, 0, FINE, "1.4"),  # L10649
    "TL": make_parameter(0, 9.9988, 9.9988, FINE, "1.4"),  # L10687
}
