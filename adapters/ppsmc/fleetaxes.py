"""The fleet file's part in the controller's own terms: axis numbers, steps, limits in steps per second."""

from collections.abc import Iterator
from fractions import Fraction
from math import ceil, floor
from typing import Literal

from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.replies import StatusBits
from adapters.ppsmc.trapezoid import PpSmcBounds
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.units import Unit, UnitError, convert_units

AXES = range(1, 17)  # L2449
PORT_BITS = range(8)  # inputs and outputs have the numbers of their bits (L3550)
METHODS = ("default", "org", "ref", "index", "switch", "slowdown", "limit", "here")
MOST_DECIMALS = 8  # L412
_FASTEST_HZ = 2_457_000  # L2866
# Without `start_rate` the motor starts at no more than this fraction of its speed limit.
_SMALL_START = 0.01


def axis_number(axis: Axis) -> int:
    return int(axis.motors[0])


def axis_numbers(config: Controller) -> dict[str, int]:
    """Return axis numbers of the controller by axis name."""
    return {name: axis_number(axis) for name, axis in config.axes.items()}


def axis_names(config: Controller) -> dict[int, str]:
    """Return axis names by axis number of the controller."""
    return {axis_number(axis): name for name, axis in config.axes.items()}


def axis_bounds(axis: Axis) -> PpSmcBounds:
    """Return an axis's limits in steps."""
    scale = float(axis.scale)
    start = axis.start_rate
    low, high = (start.min, start.max) if start is not None else (0.0, axis.limits.velocity * _SMALL_START)
    return PpSmcBounds(
        speed=min(_FASTEST_HZ, axis.limits.velocity * scale * (1 + 1e-9)),
        acceleration=axis.limits.acceleration * scale,
        start_min=max(1, ceil(low * scale)),
        start_max=max(1, floor(high * scale)),
    )


def expected_gear(axis: Axis) -> Fraction | None:
    """Return the steps per mm or deg that `gnum` / `gden` must give; None: the axis is in counts."""
    for base in (Unit.MM, Unit.DEG):
        try:
            return axis.scale / convert_units(Fraction(1), axis.unit, base)
        except UnitError:
            continue
    return None


def gear_decimals(gear: Fraction) -> int:
    """Return how many decimals distinguish neighbouring steps."""
    decimals = 1
    while decimals < MOST_DECIMALS and gear > 10**decimals:
        decimals += 1
    return decimals


def format_position(steps: int, gear: Fraction) -> str:
    """Format a position in the controller's distance unit, with as many decimals as it needs to denote exactly this
    step."""
    exact = Fraction(steps) / gear
    places, scaled_position = 1, round(exact * 10)
    while places < 12 and abs(Fraction(scaled_position, 10**places) * gear - steps) > Fraction(1, 10):
        places += 1
        scaled_position = round(exact * 10**places)
    digits = str(abs(scaled_position)).rjust(places + 1, "0")
    return f"{'-' if scaled_position < 0 else ''}{digits[:-places]}.{digits[-places:]}"


def parse_steps(text: str, gear: Fraction) -> int:
    """Return the step at a position that the controller has reported."""
    return round(Fraction(text) * gear)


def position_resolution(text: str, gear: Fraction) -> float:
    """Return the resolution of that position, in steps: from its last decimal, and the rounding to a step."""
    decimals = len(text.partition(".")[2])
    return 1.0 + float(gear) * 0.1**decimals


def limit_of(state: int) -> Literal["none", "forward", "reverse", "both"]:
    """Return the active limit switches in the bits of ?s."""
    forward, reverse = bool(state & StatusBits.LIMIT_FORWARD), bool(state & StatusBits.LIMIT_REVERSE)
    if forward and reverse:
        return "both"
    return "forward" if forward else "reverse" if reverse else "none"


def find_problems(config: Controller, options: PpSmcOptions) -> Iterator[str]:
    """Every mistake in the fleet file that can be found offline."""
    if config.shares_port:
        yield "link.address: an SMC has no address, and needs a port of its own; remove it"
    if config.link.kind == "udp":
        yield "link.kind: udp is not supported; allowed: tcp, serial"
    for name, axis in config.axes.items():
        yield from _find_axis_problems(name, axis)
    for field, names in (("loop", list(options.loop)), ("encoders", options.encoders)):
        for name in names:
            if name not in config.axes:
                yield f"options.{field}: no axis {name}; axes are {', '.join(config.axes)}"
    yield from _find_point_problems(config, options)


def _find_axis_problems(name: str, axis: Axis) -> Iterator[str]:
    if not axis.motors[0].isdecimal() or int(axis.motors[0]) not in AXES:
        yield (f"axes.{name}.motors: {axis.motors[0]!r} is not an axis of the controller; allowed: '1' to '16'")
    if axis.homing.method not in METHODS:
        yield f"axes.{name}.homing.method: {axis.homing.method!r} is unknown; allowed: {', '.join(METHODS)}"
    if axis.homing.method == "ref" and axis.homing_sign > 0:
        yield f"axes.{name}.homing.direction: method ref searches towards lower step counts only; use org"
    limits = axis_bounds(axis)
    if limits.speed < 1:
        yield (
            f"axes.{name}.limits.velocity: {axis.limits.velocity:g} {axis.unit}/s is below the "
            "controller's lowest speed of one step per second"
        )
    if limits.start_min > limits.start_max or limits.start_min > limits.speed:
        yield (
            f"axes.{name}.start_rate: no whole number of steps per second lies between its min and its max, "
            f"and below limits.velocity; allowed: 1 to {floor(limits.speed)} steps per second"
        )


def _find_point_problems(config: Controller, options: PpSmcOptions) -> Iterator[str]:
    for kind, points in (("inputs", config.inputs), ("outputs", config.outputs)):
        if points and not options.io_port:
            yield (
                f"{kind}: the i/o port is an option of the controller; set `options.io_port: true` if it is installed"
            )
        for name, point in points.items():
            if point.number not in PORT_BITS:
                yield f"{kind}.{name}.number: {point.number} does not exist; allowed: bits 0 to 7"
