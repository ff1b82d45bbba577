"""Units of axes: a closed list, converted exactly.

A factor is the unit's size in the base unit of its dimension (mm, deg, count), as a rational, so that a thousand
relative moves back and forth end on the same count. The radian is the one inexact size: pi is taken as the nearest
double once, and is exact from then on.
"""

import math
import re
from enum import StrEnum
from fractions import Fraction
from typing import Annotated

from pydantic import BeforeValidator, Field, WithJsonSchema

from orchestrator.model.errors import TuttiError


class Unit(StrEnum):
    """The units of axes and values."""

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

MAX_QUANTITY_LENGTH = 60  # maximum characters of a quantity
MAX_QUANTITY = 1e15  # in any unit; its counts can still be computed for any axis


class UnitError(TuttiError, ValueError):
    """A value that is not a number, or whose unit does not fit. The message lists what is allowed."""


def convert_units(value: Fraction, of: Unit, to: Unit) -> Fraction:
    """Convert `value` from unit `of` to unit `to`. Raises `UnitError` if their dimensions differ."""
    dimension, size = _SIZE[of]
    wanted, unit_size = _SIZE[to]
    if dimension != wanted:
        fitting = ", ".join(unit for unit, (name, _) in _SIZE.items() if name == wanted)
        raise UnitError(f"{of} is a unit of {dimension}, and the axis is in {to}; use one of: {fitting}")
    return value * size / unit_size


def parse_quantity(value: int | float | str, unit: Unit) -> Fraction:
    """Convert a number in the axis's own unit, or text with a convertible unit (`"12.5 um"`), to an exact number of
    `unit`.

    Raises `UnitError`.
    """
    if not isinstance(value, str):
        return Fraction(str(value))
    found = _QUANTITY.match(value)
    if not found:
        raise UnitError(f'{value!r} is not a quantity; write a number, or a number and a unit, e.g. "12.5 {unit}"')
    number, name = found.groups()
    if not name:
        return Fraction(number)
    try:
        given = Unit(name.replace("µ", "u"))
    except ValueError:
        raise UnitError(f"unknown unit {name!r}; known units: {', '.join(Unit)}") from None
    return convert_units(Fraction(number), given, unit)


def _check_quantity(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError('write a number in the axis\'s unit, or text with a unit such as "12.5 um"')
    found = _QUANTITY.match(value[:MAX_QUANTITY_LENGTH]) if isinstance(value, str) else None
    if isinstance(value, str) and (found is None or len(value) > MAX_QUANTITY_LENGTH):
        raise ValueError(
            f'{value[:MAX_QUANTITY_LENGTH]!r} is not a quantity; write a number, or a number and a unit, e.g. "12.5 um"'
        )
    # An integer can exceed the range of a float.
    if abs(float(found[1]) if found else value) > MAX_QUANTITY:  # pyright: ignore[reportArgumentType]
        raise ValueError(f"{value!r} is out of range; the largest number is {MAX_QUANTITY:g}")
    return value


Quantity = Annotated[
    int | float | str,
    BeforeValidator(_check_quantity),
    Field(description='A number in the axis\'s own unit, or text with a convertible unit, e.g. "12.5 um".'),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
]
"""A value for an axis whose unit is known only together with the fleet: convert it with `parse_quantity`."""
