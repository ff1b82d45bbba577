"""Units of axes: a closed list, converted exactly.

A factor is the unit's size in the base unit of its dimension (mm, deg, count), as a rational, so that a thousand
relative moves there and back end on the same count. The radian is the one inexact size: pi is taken as the
nearest double, once, and is exact from then on.
"""

import math
import re
from enum import StrEnum
from fractions import Fraction
from typing import Annotated

from pydantic import BeforeValidator, Field, WithJsonSchema


class Unit(StrEnum):
    """The units that an axis or a value can have."""

    M = "m"
    CM = "cm"
    MM = "mm"
    UM = "um"
    NM = "nm"
    INCH = "in"
    DEG = "deg"
    ARCMIN = "arcmin"
    ARCSEC = "arcsec"
    RAD = "rad"
    MRAD = "mrad"
    REV = "rev"
    COUNTS = "counts"


_DEG_PER_RAD = Fraction(180) / Fraction(math.pi)

_SIZE: dict[Unit, tuple[str, Fraction]] = {
    Unit.M: ("length", Fraction(1000)),
    Unit.CM: ("length", Fraction(10)),
    Unit.MM: ("length", Fraction(1)),
    Unit.UM: ("length", Fraction(1, 1000)),
    Unit.NM: ("length", Fraction(1, 1_000_000)),
    Unit.INCH: ("length", Fraction(254, 10)),
    Unit.DEG: ("angle", Fraction(1)),
    Unit.ARCMIN: ("angle", Fraction(1, 60)),
    Unit.ARCSEC: ("angle", Fraction(1, 3600)),
    Unit.RAD: ("angle", _DEG_PER_RAD),
    Unit.MRAD: ("angle", _DEG_PER_RAD / 1000),
    Unit.REV: ("angle", Fraction(360)),
    Unit.COUNTS: ("counts", Fraction(1)),
}

_QUANTITY = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,2})?)\s*([A-Za-zµ\"']*)\s*$")

LONGEST = 60  # characters of a quantity
LARGEST = 1e15  # of any unit: in counts of any axis it is still a number that can be calculated with


class UnitError(ValueError):
    """A value whose unit does not fit, or that is no number. The message says what is allowed."""


def convert(value: Fraction, of: Unit, to: Unit) -> Fraction:
    """`value` in unit `of`, expressed in unit `to`. Raises `UnitError` when one can not become the other."""
    dimension, size = _SIZE[of]
    wanted, unit_size = _SIZE[to]
    if dimension != wanted:
        fitting = ", ".join(unit for unit, (name, _) in _SIZE.items() if name == wanted)
        raise UnitError(f"{of} is a unit of {dimension}, and the axis is in {to}; use one of: {fitting}")
    return value * size / unit_size


def parse_quantity(value: int | float | str, unit: Unit) -> Fraction:
    """A number in the axis's own unit, or text with a convertible unit (`"12.5 um"`), as an exact number of `unit`.

    Raises `UnitError`.
    """
    if not isinstance(value, str):
        return Fraction(str(value))
    found = _QUANTITY.match(value)
    if not found:
        raise UnitError(f'{value!r} is no quantity; write a number, or a number and a unit, e.g. "12.5 {unit}"')
    number, name = found.groups()
    if not name:
        return Fraction(number)
    try:
        given = Unit(name.replace("µ", "u"))
    except ValueError:
        raise UnitError(f"unknown unit {name!r}; known units: {', '.join(Unit)}") from None
    return convert(Fraction(number), given, unit)


def _check_quantity(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError('write a number in the axis\'s unit, or text with a unit such as "12.5 um"')
    found = _QUANTITY.match(value[:LONGEST]) if isinstance(value, str) else None
    if isinstance(value, str) and (found is None or len(value) > LONGEST):
        raise ValueError(f'{value[:LONGEST]!r} is no quantity; write a number, or a number and a unit, e.g. "12.5 um"')
    # An integer may be beyond every float.
    if abs(float(found[1]) if found else value) > LARGEST:  # pyright: ignore[reportArgumentType]
        raise ValueError(f"{value!r} is beyond all machines; the largest number is {LARGEST:g}")
    return value


Quantity = Annotated[
    int | float | str,
    BeforeValidator(_check_quantity),
    Field(description='A number in the axis\'s own unit, or text with a convertible unit, e.g. "12.5 um".'),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
]
"""A value for an axis whose unit is known only together with the fleet: resolve it with `parse_quantity`."""
