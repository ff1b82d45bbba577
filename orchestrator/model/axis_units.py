"""The fields of an axis that have a unit: its range, and those that files may give with one, `velocity: "200 mm/s"`."""

from collections.abc import Mapping
from fractions import Fraction
from functools import lru_cache
from typing import Any, cast

from orchestrator.model.base import Model
from orchestrator.model.problems import Problem
from orchestrator.model.units import Quantity, Unit, UnitError, parse_quantity, parse_rate


class SoftLimits(Model):
    """The range of absolute positions that commands may reach, ends included."""

    min: Quantity
    max: Quantity

    def in_unit(self, unit: Unit) -> tuple[Fraction, Fraction]:
        """Both ends as exact numbers of a unit. Raises `UnitError`."""
        return _parse_ends(self.min, self.max, unit)


@lru_cache(maxsize=10_000)
def _parse_ends(low: Quantity, high: Quantity, unit: Unit) -> tuple[Fraction, Fraction]:
    """They are needed with every state of virtual axes."""
    return parse_quantity(low, unit), parse_quantity(high, unit)


# field: power of seconds in its unit (1: per second)
_RATES: dict[tuple[str, ...], int] = {
    ("limits", "velocity"): 1,
    ("limits", "acceleration"): 2,
    ("limits", "jerk"): 3,
    ("homing", "speed"): 1,
    ("homing", "search_speed"): 1,
    ("jog", "speed"): 1,
    ("jog", "slow_speed"): 1,
    ("jog", "deviation"): 0,
    ("start_rate", "min"): 1,
    ("start_rate", "max"): 1,
    ("backlash", "amount"): 0,
    ("backlash", "speed"): 1,
    ("backlash", "overrun"): 0,
    ("in_position_window",): 0,
    ("following_error",): 0,
    ("max_deviation",): 0,
    ("may_rack",): 0,
    ("square",): 0,
}
_VALID = 1.0  # stands for a value that is reported, so that the other fields are checked too


def convert_rates(data: Any) -> tuple[Any, list[Problem]]:
    """Convert text with a unit to numbers in the axis's unit; also return what could not be converted.

    data: an axis as a file gives it, otherwise it is returned as it is.
    """
    if not isinstance(data, Mapping):
        return data, []
    axis = cast(Mapping[str, Any], data)
    try:
        unit = Unit(axis.get("unit", ""))
    except ValueError:
        unit = None  # reported by the field itself
    new_axis, problems = dict(axis), list[Problem]()
    for path, order in _RATES.items():
        block = new_axis if len(path) == 1 else new_axis.get(path[0])
        if not isinstance(block, Mapping):
            continue
        found_block = cast(Mapping[str, Any], block).get(path[-1])
        if not isinstance(found_block, str):
            continue
        value = _VALID
        try:
            value = value if unit is None else parse_rate(found_block, unit, order)
        except UnitError as error:
            problems.append(Problem(path, str(error), found_block))
        if len(path) == 1:
            new_axis[path[0]] = value
        else:
            new_axis[path[0]] = {**cast(Mapping[str, Any], block), path[-1]: value}
    return new_axis, problems
