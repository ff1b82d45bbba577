"""Units of axes: a closed list, converted exactly.

A factor is the unit's size in the base unit of its dimension (mm, deg, eV, count), as a rational, so that a thousand
relative moves back and forth end on the same count. The radian is the one inexact size: pi is taken as the nearest
double once, and is exact from then on.
"""

import math
import re
from enum import StrEnum
from fractions import Fraction
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from orchestrator.model.errors import TuttiError
from orchestrator.model.numbers import MAX_TEXT, name_odd_sign, split_number, suggest_number


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
    EV = "eV"
    KEV = "keV"
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
    Unit.EV: ("energy", Fraction(1)),
    Unit.KEV: ("energy", Fraction(1000)),
    Unit.COUNTS: ("counts", Fraction(1)),
}

MAX_QUANTITY = 1e15  # in any unit; its counts can still be computed for any axis


class UnitError(TuttiError, ValueError):
    """A value that is not a number, or whose unit does not fit. The message lists what is allowed."""


def find_dimension(unit: Unit) -> str:
    """What a unit measures: `length`, `angle`, `energy` or `counts`."""
    return _SIZE[unit][0]


def find_si_size(unit: Unit) -> float | None:
    """The size of a unit of length or angle in metres or radians; None for another one."""
    base = {"length": Unit.M, "angle": Unit.RAD}.get(find_dimension(unit))
    return None if base is None else float(convert_units(Fraction(1), unit, base))


def convert_units(value: Fraction, of: Unit, to: Unit, owner: str = "the axis") -> Fraction:
    """Convert `value` from unit `of` to unit `to`. owner: what has that unit, for the message.

    Raises `UnitError` if their dimensions differ.
    """
    dimension, size = _SIZE[of]
    expected_dimension, unit_size = _SIZE[to]
    if dimension != expected_dimension:
        fitting = ", ".join(unit for unit, (name, _) in _SIZE.items() if name == expected_dimension)
        raise UnitError(f"{of} is a unit of {dimension}, and {owner} is in {to}; use one of: {fitting}")
    return value * size / unit_size


def parse_quantity(value: int | float | str, unit: Unit, owner: str = "the axis") -> Fraction:
    """Convert a number in the axis's own unit, or text with a convertible unit (`"12.5 um"`), to an exact number of
    `unit`. owner: what has that unit, for the message.

    Raises `UnitError`.
    """
    if not isinstance(value, str):
        return Fraction(str(value))
    parts = split_number(value)
    if parts is None:
        raise UnitError(_explain_quantity(value, unit))
    number, name = parts
    if not name:
        return Fraction(number)
    return convert_units(Fraction(number), _parse_unit(name), unit, owner)


def format_quantity(value: int | float | str, unit: Unit) -> str:
    """A quantity as text with its unit; a number without one is in `unit`."""
    parts = split_number(value) if isinstance(value, str) else (f"{value:.15g}", "")
    return str(value) if parts is None else f"{parts[0]} {parts[1] or unit}"


def parse_with_unit(text: float | str, like: str) -> Fraction:
    """Convert text with a unit to an exact number of the unit of the text `like`. Raises `UnitError`."""
    parts = split_number(like)
    if parts is None or not parts[1]:
        raise UnitError(f"{like[:MAX_TEXT]!r} has no unit; write a number without quotes, or add the unit")
    unit = _parse_unit(parts[1])
    number = split_number(text) if isinstance(text, str) else None
    if number is None or not number[1]:
        raise UnitError(f"{str(text)[:MAX_TEXT]!r} has no unit, and {like!r} has one; give both one")
    return parse_quantity(number[0] + number[1], unit)


_PER_TIME = re.compile(r"(.+?)/(s|min)(?:\^?([23])|([²³]))?")
_MARKS = {1: "", 2: "²", 3: "³"}


def parse_rate(text: str, unit: Unit, order: int) -> float:
    """Convert text such as `"200 mm/s"` to a number of `unit` per second (order 1), second² (2) or second³ (3).

    `rpm` and `/min` are understood. order 0: a length or an angle. Raises `UnitError`.
    """
    unit_text = f"{unit}/s{_MARKS[order]}" if order else unit
    parts = split_number(text)
    if parts is None:
        raise UnitError(_explain_quantity(text, unit_text))
    number, name = parts
    if not name:
        raise UnitError(f"found text {text[:MAX_TEXT]!r}; write the number without quotes: {number}")
    if order == 0:
        return float(convert_units(Fraction(number), _parse_unit(name), unit))
    match = _PER_TIME.fullmatch("rev/min" if name == "rpm" else name)
    if match is None or _order_of(match) != order:
        raise UnitError(f'{text[:MAX_TEXT]!r} is not in a unit of {unit_text}; write e.g. "{number} {unit_text}"')
    seconds = 60**order if match[2] == "min" else 1
    return float(convert_units(Fraction(number), _parse_unit(match[1]), unit) / seconds)


def check_rate(text: str, order: int) -> None:
    """Check that text such as `"5 mm/s"` is a number and a known unit per second (order 1), second² or second³.

    Raises `UnitError`. Whether the unit fits an axis is known only together with the fleet.
    """
    parts = split_number(text)
    if parts is None:
        raise UnitError(_explain_quantity(text, f"mm/s{_MARKS[order]}"))
    number, name = parts
    match = _PER_TIME.fullmatch("rev/min" if name == "rpm" else name)
    if match is None or _order_of(match) != order:
        raise UnitError(f'{text[:MAX_TEXT]!r} has no unit per time; write e.g. "{number} mm/s{_MARKS[order]}"')
    _parse_unit(match[1])


def _order_of(found: re.Match[str]) -> int:
    return int(found[3] or {"²": 2, "³": 3}.get(found[4], 1))


def _parse_unit(name: str) -> Unit:
    try:
        return Unit(name.replace("µ", "u").replace("μ", "u"))
    except ValueError:
        if (odd_sign := name_odd_sign(name)) != "":
            raise UnitError(f"unknown unit {name[:20]!r}; {odd_sign}") from None
        raise UnitError(f"unknown unit {name[:20]!r}; known units: {', '.join(Unit)}") from None


def _explain_quantity(text: str, unit: str) -> str:
    hint = suggest_number(text) or f'write a number, or a number and a unit, e.g. "12.5 {unit}"'
    return f"{text[:MAX_TEXT]!r} is not a quantity; {hint}"


def check_quantity(value: object) -> object:
    """Return a number, or text with a number and perhaps a unit, as it is. Raises `ValueError` for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError('write a number in the axis\'s unit, or text with a unit such as "12.5 um"')
    number: object = value
    if isinstance(value, str):
        parts = split_number(value)
        if parts is None:
            raise ValueError(_explain_quantity(value, "um"))
        number = float(parts[0])
    # An integer can exceed the range of a float. NaN is not below anything.
    if not abs(number) <= MAX_QUANTITY:  # pyright: ignore[reportArgumentType]
        raise ValueError(f"{str(value)[:MAX_TEXT]} is out of range; the largest number is {MAX_QUANTITY:g}")
    return value


Quantity = Annotated[
    int | float | str,
    BeforeValidator(check_quantity),
    Field(description='A number in the axis\'s own unit, or text with a convertible unit, e.g. "12.5 um".'),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
]
"""A value for an axis whose unit is known only together with the fleet: convert it with `parse_quantity`."""


def check_axis_unit(quantity: object) -> object:
    """Return a quantity as it is, if its unit, where it has one, is one of axes. Raises `UnitError`."""
    if isinstance(quantity, str) and (parts := split_number(quantity)) is not None and parts[1]:
        _parse_unit(parts[1])
    return quantity


AxisQuantity = Annotated[Quantity, AfterValidator(check_axis_unit)]
"""A position or a distance of an axis. That its unit fits the axis is known only together with the fleet."""
