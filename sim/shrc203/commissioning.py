"""The set-up of a simulated SHRC-203 for a fleet file: the pulse lengths of its stages (L807-L811, L2520)."""

from collections.abc import Mapping
from typing import Any

from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.units import Unit
from sim.core.commissioning import search_distance
from sim.shrc203.options import DIVISIONS

_NM_PER_UNIT = {Unit.M: 1e9, Unit.CM: 1e7, Unit.MM: 1e6, Unit.UM: 1e3, Unit.NM: 1.0, Unit.INCH: 25.4e6}
_MOST_BASE_RATE = 1_000_000
_USUAL_PLS = 1000  # from power-up to the origin, of a simulator without further settings


def make_options(config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
    """BASE RATE and DIVIDE of all stages. expected: the adapter's options; `nm_per_pulse` precedes the scale."""
    options: dict[str, Any] = {}
    if not {"base_rate", "divide"} & config.simulate.options.keys():
        options |= _pulse_lengths(config, expected)
    slow = {
        axis.motors[0]: -search_distance(axis)
        for axis in config.axes.values()
        if search_distance(axis) * axis.homing.timeout_s < _USUAL_PLS
    }
    if slow:
        options["origin_pls"] = {"1": -_USUAL_PLS, "2": -_USUAL_PLS, "3": -_USUAL_PLS, **slow}
    return options


def _pulse_lengths(config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
    rates: dict[str, int] = {}
    divide = 2000
    for axis in config.axes.values():
        nm = expected.get("nm_per_pulse") or _pulse_nm(axis)
        # One pulse is BASE RATE x 10 / DIVIDE nm.
        fitting = [
            division
            for division in sorted(DIVISIONS)
            if nm and _is_whole(nm * division / 10) and nm * division / 10 <= _MOST_BASE_RATE
        ]
        if nm and fitting:
            divide = fitting[0] if not rates else divide
            rates[axis.motors[0]] = round(nm * divide / 10)
    if not rates:
        return {}
    common = set(rates.values())
    return {"divide": divide, "base_rate": common.pop() if len(common) == 1 else rates}


def _pulse_nm(axis: Axis) -> float | None:
    nm = _NM_PER_UNIT.get(axis.unit)
    return None if nm is None else nm / float(axis.scale)


def _is_whole(value: float) -> bool:
    return value >= 1 and abs(value - round(value)) < 1e-6
