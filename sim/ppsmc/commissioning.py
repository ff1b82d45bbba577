"""The set-up of a simulated SMC for a fleet file: axes, gears, reference switches, installed options."""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.units import Unit, UnitError, convert_units
from sim.core.commissioning import search_distance, span_counts


def make_options(config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
    """expected: the adapter's options, of which it takes the i/o port, the loops, the encoders and the gear check."""
    options: dict[str, Any] = {
        "axes": max(int(axis.motors[0]) for axis in config.axes.values()),
        "org_steps": {axis.motors[0]: _switch(axis) for axis in config.axes.values()},
    }
    if expected.get("check_gear"):
        gears = {axis.motors[0]: gear for axis in config.axes.values() if (gear := _gear(axis)) is not None}
        options["gears"] = {number: [gear.numerator, gear.denominator] for number, gear in gears.items()}
    if expected.get("io_port"):
        options["hardware"] = ["io_port"]
    if expected.get("encoders") or "closed" in dict(expected.get("loop") or {}).values():
        options |= {"encoder": True, "encoder_follows": True}
    return options


def _switch(axis: Axis) -> list[int]:
    """The ORG switch, on from a short distance in the direction of the search to the end of the travel."""
    near_end, far_end = search_distance(axis), search_distance(axis) + 2 * span_counts(axis)
    return [-far_end, -near_end] if axis.homing_sign < 0 else [near_end, far_end]


def _gear(axis: Axis) -> Fraction | None:
    """Steps per mm or degree (`gnum` / `gden`, L871); None for an axis in counts."""
    for base in (Unit.MM, Unit.DEG):
        try:
            return axis.scale / convert_units(Fraction(1), axis.unit, base)
        except UnitError:
            continue
    return None
