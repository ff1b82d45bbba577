"""The fleet file's part in the controller's own terms: motors, pulses, limits in pulses per second."""

from collections.abc import Iterator
from math import ceil, floor
from typing import Literal

from adapters.shrc203.shapes.trapezoid import ShrcBounds
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.units import Unit

METHODS = {"default": "", "mark": "0", "mini": "1", "middle": "2", "orgs": "3", "normal": "4"}  # L2739-L2790
INPUTS = OUTPUTS = range(1, 7)  # L1607-L1643
TRIGGER_NUMBER = 7  # the trigger output (L5366) in the fleet file
_MM_PER_UNIT = {Unit.M: 1e3, Unit.CM: 10.0, Unit.MM: 1.0, Unit.UM: 1e-3, Unit.NM: 1e-6, Unit.INCH: 25.4}
# Without `start_rate` the motor starts at no more than this fraction of its speed limit.
_SMALL_START = 0.01


def motor_number(axis: Axis) -> int:
    return int(axis.motors[0])


def motor_numbers(config: Controller) -> dict[str, int]:
    """Return motor numbers by axis name."""
    return {name: motor_number(axis) for name, axis in config.axes.items()}


def axis_bounds(axis: Axis) -> ShrcBounds:
    """Return an axis's limits in pulses."""
    scale = float(axis.scale)
    speed = axis.limits.velocity * scale * (1 + 1e-9)
    start = axis.start_rate
    low, high = (start.min, start.max) if start is not None else (0.0, axis.limits.velocity * _SMALL_START)
    return ShrcBounds(
        speed=speed,
        acceleration=axis.limits.acceleration * scale,
        start_min=max(1, ceil(low * scale)),
        start_max=max(1, floor(high * scale)),
    )


def expected_nm(axis: Axis, given: float | None) -> float | None:
    """Return the required length of one pulse, nm: from the option, or from the scale of an axis with a unit of length;
    None: unknown."""
    if given is not None:
        return given
    mm = _MM_PER_UNIT.get(axis.unit)
    return None if mm is None else 1e6 * mm / float(axis.scale)


def homing_triple(axis: Axis) -> tuple[int, int, int]:
    """Return S, F (pls/s) and the smallest R (ms) for the origin return."""
    limits, homing, scale = axis_bounds(axis), axis.homing, float(axis.scale)
    f = floor((homing.speed if homing.speed is not None else axis.limits.velocity / 10) * scale)
    f = max(1, min(f, floor(limits.speed)))
    s = max(1, min(f, floor(homing.search_speed * scale) if homing.search_speed is not None else limits.start_min))
    return s, f, max(1, min(1000, ceil((f - s) / limits.acceleration * 1000)))


def limit_of(word: int, cw: str) -> Literal["none", "forward", "reverse", "both"]:
    """Return the active limit sensors of a status word (bits 20 and 21, L553-L556)."""
    on_cw, on_ccw = bool(word & 1 << 19), bool(word & 1 << 20)
    if on_cw and on_ccw:
        return "both"
    if not (on_cw or on_ccw):
        return "none"
    return "forward" if on_cw == (cw == "forward") else "reverse"


def find_problems(config: Controller) -> Iterator[str]:
    """Every mistake in the fleet file that can be found offline."""
    if config.shares_port:
        yield "link.address: an SHRC-203 has no address, and needs a port of its own; remove it"
    for name, axis in config.axes.items():
        if axis.motors[0] not in ("1", "2", "3"):
            yield f"axes.{name}.motors: {axis.motors[0]!r} is not a motor; allowed: '1', '2', '3'"
        if axis.homing.method not in METHODS:
            yield (f"axes.{name}.homing.method: {axis.homing.method!r} is unknown; allowed: {', '.join(METHODS)}")
        if axis.limits.velocity * float(axis.scale) < 1:
            yield (
                f"axes.{name}.limits.velocity: {axis.limits.velocity:g} {axis.unit}/s is below the controller's "
                f"lowest speed of one pulse per second"
            )
        limits = axis_bounds(axis)
        if limits.start_min > limits.start_max or limits.start_min > limits.speed:
            yield (
                f"axes.{name}.start_rate: no whole number of pulses per second lies between its min and its max, "
                f"and below limits.velocity; allowed: 1 to {floor(limits.speed)} pulses per second"
            )
    for name, point in config.inputs.items():
        if point.number not in INPUTS:
            yield f"inputs.{name}.number: {point.number} does not exist; allowed: 1 to 6"
    yield from _find_output_problems(config)
    if config.link.kind == "serial" and config.link.data_bits != 8:
        yield f"link.data_bits: {config.link.data_bits} is not supported; allowed: 8"


def _find_output_problems(config: Controller) -> Iterator[str]:
    brakes = {axis.brake.output for axis in config.axes.values() if axis.brake is not None}
    for name, point in config.outputs.items():
        field = f"outputs.{name}.number"
        if point.number == TRIGGER_NUMBER and (point.safe is not None or name in brakes):
            yield f"{field}: {TRIGGER_NUMBER} is the trigger output, which gives pulses only; no brake, and no `safe`"
        elif point.number not in (*OUTPUTS, TRIGGER_NUMBER):
            yield f"{field}: {point.number} does not exist; allowed: 1 to 6, and {TRIGGER_NUMBER}, the trigger output"
