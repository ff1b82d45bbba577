"""A program beside the axes as they are: presets of its fields, where it stood, and whether the axes are there."""

from collections.abc import Mapping, Sequence
from typing import Any

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.model.units import Unit, convert_units, find_dimension, parse_quantity
from orchestrator.plan.programs.program_job import make_program_job, require_unchanged
from orchestrator.plan.programs.settings import FROM_LINE, ProgramText, read_settings
from orchestrator.plan.programs.standing import LastMotion, StandingLine, find_standing_line


def list_places(fleet: Fleet, axes: Mapping[str, AxisForecast]) -> dict[str, float]:
    """Where the linear axes stand, mm."""
    units = {name: Unit(fleet.axis(name).unit) for name in axes}
    return {
        name: float(convert_units(axis.motor + axis.offset, units[name], Unit.MM))
        for name, axis in axes.items()
        if find_dimension(units[name]) == "length"
    }


def list_zeros(axes: Mapping[str, AxisForecast]) -> dict[str, float]:
    """User minus motor position of each axis, in its unit."""
    return {name: float(axis.offset) for name, axis in axes.items()}


def take_over(
    program: ProgramText, fields: Sequence[Mapping[str, Any]], end: LastMotion, fleet: Fleet
) -> tuple[list[dict[str, Any]], StandingLine]:
    """The fields with the values of the job that has stopped, and the line at which it stood. Raises `FileError` with
    what has changed since."""
    used = end.report.parameters_used
    taken_fields = [{**field, "default": used.get(field["name"], field["default"])} for field in fields]
    settings = read_settings(program, taken_fields, {}, list_zeros(end.axes))
    require_unchanged(program, settings, used)
    standing = find_standing_line(make_program_job(program, settings, fleet), end, fleet)
    line = {"default": str(standing.line)}
    return [{**field, **line} if field["name"] == FROM_LINE else field for field in taken_fields], standing


def stand_at(places: Mapping[str, str], axes: Mapping[str, AxisForecast], fleet: Fleet) -> bool:
    """Whether all axes are where a move would take them, to a count."""
    for name, target in places.items():
        axis, forecast = fleet.axis(name), axes.get(name)
        goal = parse_quantity(target, axis.unit, name)
        if forecast is None or abs(goal - forecast.motor - forecast.offset) * axis.scale > 1:
            return False
    return True
