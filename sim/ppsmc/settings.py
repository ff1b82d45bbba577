"""Configuration of one axis (section 12.1): names, ranges, defaults, and the text form of values."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from fractions import Fraction

from sim.ppsmc.grammar import InputRefused, format_decimal, parse_decimal, parse_integer
from sim.ppsmc.path import SpeedProfile

Value = int | Fraction | str


@dataclass(slots=True)
class AxisSettings:
    """Values of one axis, by command name. Ramps are Hz/ms, speeds Hz; distances are in the axis's unit.

    Defaults are decision 23; those of the closed loop are decisions of this simulator.
    """

    acc: int = 10
    alias: str = ""
    bln: Fraction = Fraction(0)
    blp: Fraction = Fraction(0)
    cf: Fraction = Fraction(1)
    conf: int = 0
    dcpl: int = 4
    dec: int = 10
    ecl: int = 0
    ect: int = 1
    edev: Fraction = Fraction(1, 1000)
    edir: int = 0
    emips: int = -1
    eres: Fraction = Fraction(1, 1000)
    esh: int = 0
    esm: int = 1
    est: int = 0
    ffast: int = 1000
    fn: str = ""
    frun: int = 200
    gden: Fraction = Fraction(1)
    gnum: Fraction = Fraction(1)
    hsdm: int = 0
    macc: int = 10
    mdec: int = 10
    mdir: int = 0
    mpr: int = 3
    prst: Fraction = Fraction(1, 10)
    prt: Fraction = Fraction(1)
    rofs: Fraction = Fraction(0)
    sdm: int = 1
    twen: int = 0
    unit: str = "deg"

    @property
    def steps_per_unit(self) -> Fraction:
        """Motor steps per unit of distance (L871)."""
        return self.gnum / self.gden

    @property
    def speed_profile(self) -> SpeedProfile:
        """The configured speed profile of goto, move, tbg, fast and spin."""
        return SpeedProfile(float(self.frun), float(self.ffast), self.acc * 1000.0, self.dec * 1000.0)

    def copy_settings(self) -> "AxisSettings":
        return replace(self)

    def take_values(self, other: "AxisSettings", names: tuple[str, ...]) -> None:
        """Copy the values of `names` from `other`."""
        for name in names:
            setattr(self, name, getattr(other, name))

    def format_value(self, name: str) -> str:
        """Format the value of `name`."""
        value: Value = getattr(self, name)
        return format_decimal(value) if isinstance(value, Fraction) else str(value)


ALTERNATIVE = ("gnum", "gden", "frun", "ffast", "acc", "dec", "macc", "mdec")
"""Parameters that `update1` saves and `chconf` switches: gear and speed profile (L1296-L1298)."""

NAMES = tuple(field.name for field in fields(AxisSettings))

Reader = Callable[[str, int], Value]
"""Parses the text of a value; the second argument is fmax, Hz. Raises `InputRefused`."""


def _integer_reader(low: int, high: int) -> Reader:
    return lambda text, _: parse_integer(text, low, high)


def _choice_reader(*allowed: int) -> Reader:
    def read_choice(text: str, _: int) -> int:
        value = parse_integer(text, min(allowed), max(allowed))
        if value not in allowed:
            raise InputRefused(f"value {text} out of range")
        return value

    return read_choice


def _read_ramp(text: str, _: int) -> int:
    """Parse 1-1000 Hz/ms; decimals are rounded (decision 21)."""
    value = parse_decimal(text)
    if not 1 <= value <= 1000:
        raise InputRefused(f"value {text} out of range")
    return round(value)


def _read_speed(text: str, fmax: int) -> int:
    """Parse 1 to fmax Hz."""
    value = parse_decimal(text)
    if not 1 <= value <= fmax:
        raise InputRefused(f"value {text} out of range")
    return round(value)


def _range_reader(low: Fraction | None = None, high: Fraction | None = None, above: Fraction | None = None) -> Reader:
    def read_decimal(text: str, _: int) -> Fraction:
        value = parse_decimal(text)
        too_low = (low is not None and value < low) or (above is not None and value <= above)
        if too_low or (high is not None and value > high):
            raise InputRefused(f"value {text} out of range")
        return value

    return read_decimal


def _text_reader(max_length: int) -> Reader:
    def read_text(text: str, _: int) -> str:
        if len(text) > max_length:
            raise InputRefused(f"text longer than {max_length} characters")
        return text

    return read_text


_ZERO, _ONE = Fraction(0), Fraction(1)

READERS: dict[str, Reader] = {
    "acc": _read_ramp,
    "alias": _text_reader(3),
    "bln": _range_reader(-_ONE, _ONE),
    "blp": _range_reader(-_ONE, _ONE),
    "cf": _range_reader(Fraction(99, 100), Fraction(101, 100)),
    "conf": _integer_reader(0, 1),
    "dcpl": _integer_reader(1, 8),
    "dec": _read_ramp,
    "ecl": _integer_reader(0, 1),
    "ect": _integer_reader(0, 3),
    "edev": _range_reader(low=_ZERO),
    "edir": _integer_reader(0, 1),
    "emips": _integer_reader(-1, 255),
    "eres": _range_reader(above=_ZERO),
    "esh": _integer_reader(0, 1),
    "esm": _choice_reader(1, 2, 4),
    "est": _integer_reader(0, 2),
    "ffast": _read_speed,
    "fn": _text_reader(32),
    "frun": _read_speed,
    "gden": _range_reader(above=_ZERO),
    "gnum": _range_reader(above=_ZERO),
    "hsdm": _integer_reader(0, 1),
    "macc": _read_ramp,
    "mdec": _read_ramp,
    "mdir": _integer_reader(0, 1),
    "mpr": _integer_reader(1, 10),
    "prst": _range_reader(above=_ZERO),
    "prt": _range_reader(low=_ZERO),
    "rofs": _range_reader(),
    "sdm": _integer_reader(0, 1),
    "unit": _text_reader(3),
}
"""Parser of each configuration command's value (L217-L1276, L4529)."""

ALIASES = {
    "def": "conf",
    "vfast": "ffast",
    "vrun": "frun",
    "gn": "gden",
    "gz": "gnum",
    "mdi": "mdir",
    "mdl": "mdir",
    "nofs": "rofs",
    "eshw": "esh",
}
"""Second names (section 12.1)."""


def set_parameter(settings: AxisSettings, name: str, text: str, fmax: int) -> None:
    """Set the value of configuration command `name`. Raises `InputRefused`."""
    value = READERS[name](text, fmax)
    if name == "edev" and isinstance(value, Fraction) and value < settings.eres:
        raise InputRefused("edev below the resolution of the encoder")
    setattr(settings, name, value)
    if name == "conf":
        settings.unit = "mm" if value else "deg"
