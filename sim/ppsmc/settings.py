"""Configuration of one axis (section 12.1): names, ranges, defaults, and how values are written and read."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from fractions import Fraction

from sim.ppsmc.grammar import Refused, decimal, integer, plain
from sim.ppsmc.path import Profile

Value = int | Fraction | str


@dataclass(slots=True)
class Settings:
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
    def gear(self) -> Fraction:
        """Motor steps per unit of distance (L871)."""
        return self.gnum / self.gden

    @property
    def profile(self) -> Profile:
        """The configured speed profile of goto, move, tbg, fast and spin."""
        return Profile(float(self.frun), float(self.ffast), self.acc * 1000.0, self.dec * 1000.0)

    def copy(self) -> "Settings":
        return replace(self)

    def take(self, other: "Settings", names: tuple[str, ...]) -> None:
        """Take the values of `names` from `other`."""
        for name in names:
            setattr(self, name, getattr(other, name))

    def written(self, name: str) -> str:
        """The value of `name` as text."""
        value: Value = getattr(self, name)
        return plain(value) if isinstance(value, Fraction) else str(value)


ALTERNATIVE = ("gnum", "gden", "frun", "ffast", "acc", "dec", "macc", "mdec")
"""What `update1` saves and `chconf` switches: gear and speed profile (L1296-L1298)."""

NAMES = tuple(field.name for field in fields(Settings))

Reader = Callable[[str, int], Value]
"""Reads the text of a value; the second argument is fmax, Hz. Raises `Refused`."""


def _whole(low: int, high: int) -> Reader:
    return lambda text, _: integer(text, low, high)


def _one_of(*allowed: int) -> Reader:
    def read(text: str, _: int) -> int:
        value = integer(text, min(allowed), max(allowed))
        if value not in allowed:
            raise Refused(f"value {text} out of range")
        return value

    return read


def _ramp(text: str, _: int) -> int:
    """1-1000 Hz/ms; decimals are rounded (decision 21)."""
    value = decimal(text)
    if not 1 <= value <= 1000:
        raise Refused(f"value {text} out of range")
    return round(value)


def _speed(text: str, fmax: int) -> int:
    """1 to fmax Hz."""
    value = decimal(text)
    if not 1 <= value <= fmax:
        raise Refused(f"value {text} out of range")
    return round(value)


def _range(low: Fraction | None = None, high: Fraction | None = None, above: Fraction | None = None) -> Reader:
    def read(text: str, _: int) -> Fraction:
        value = decimal(text)
        too_low = (low is not None and value < low) or (above is not None and value <= above)
        if too_low or (high is not None and value > high):
            raise Refused(f"value {text} out of range")
        return value

    return read


def _text(most: int) -> Reader:
    def read(text: str, _: int) -> str:
        if len(text) > most:
            raise Refused(f"text longer than {most} characters")
        return text

    return read


_ZERO, _ONE = Fraction(0), Fraction(1)

READERS: dict[str, Reader] = {
    "acc": _ramp,
    "alias": _text(3),
    "bln": _range(-_ONE, _ONE),
    "blp": _range(-_ONE, _ONE),
    "cf": _range(Fraction(99, 100), Fraction(101, 100)),
    "conf": _whole(0, 1),
    "dcpl": _whole(1, 8),
    "dec": _ramp,
    "ecl": _whole(0, 1),
    "ect": _whole(0, 3),
    "edev": _range(low=_ZERO),
    "edir": _whole(0, 1),
    "emips": _whole(-1, 255),
    "eres": _range(above=_ZERO),
    "esh": _whole(0, 1),
    "esm": _one_of(1, 2, 4),
    "est": _whole(0, 2),
    "ffast": _speed,
    "fn": _text(32),
    "frun": _speed,
    "gden": _range(above=_ZERO),
    "gnum": _range(above=_ZERO),
    "hsdm": _whole(0, 1),
    "macc": _ramp,
    "mdec": _ramp,
    "mdir": _whole(0, 1),
    "mpr": _whole(1, 10),
    "prst": _range(above=_ZERO),
    "prt": _range(low=_ZERO),
    "rofs": _range(),
    "sdm": _whole(0, 1),
    "unit": _text(3),
}
"""How the value of each configuration command is read (L217-L1276, L4529)."""

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


def configure(settings: Settings, name: str, text: str, fmax: int) -> None:
    """Set the value of configuration command `name`. Raises `Refused`."""
    value = READERS[name](text, fmax)
    if name == "edev" and isinstance(value, Fraction) and value < settings.eres:
        raise Refused("edev below the resolution of the encoder")
    setattr(settings, name, value)
    if name == "conf":
        settings.unit = "mm" if value else "deg"
