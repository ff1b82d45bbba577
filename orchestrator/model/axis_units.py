"""The fields of an axis that files may give with a unit: `velocity: "200 mm/s"`."""

from collections.abc import Mapping
from typing import Any, cast

from orchestrator.model.problems import Problem
from orchestrator.model.units import Unit, UnitError, parse_rate

# field: power of seconds in its unit (1: per second)
_RATES: dict[tuple[str, ...], int] = {
    ("limits", "velocity"): 1,
    ("limits", "acceleration"): 2,
    ("limits", "jerk"): 3,
    ("homing", "speed"): 1,
    ("homing", "search_speed"): 1,
    ("jog", "speed"): 1,
    ("jog", "slow_speed"): 1,
    ("start_rate", "min"): 1,
    ("start_rate", "max"): 1,
    ("in_position_window",): 0,
    ("following_error",): 0,
    ("max_deviation",): 0,
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
    converted, problems = dict(axis), list[Problem]()
    for place, order in _RATES.items():
        block = converted if len(place) == 1 else converted.get(place[0])
        if not isinstance(block, Mapping):
            continue
        found_block = cast(Mapping[str, Any], block).get(place[-1])
        if not isinstance(found_block, str):
            continue
        value = _VALID
        try:
            value = value if unit is None else parse_rate(found_block, unit, order)
        except UnitError as error:
            problems.append(Problem(place, str(error), found_block))
        if len(place) == 1:
            converted[place[0]] = value
        else:
            converted[place[0]] = {**cast(Mapping[str, Any], block), place[-1]: value}
    return converted, problems
