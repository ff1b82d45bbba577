"""The controller's part of the fleet file in the unit's own terms: axis numbers, steps, limits in steps per second."""

from fractions import Fraction
from math import ceil, floor
from typing import Literal

from adapters.ppsmc.options import Options
from adapters.ppsmc.replies import Bits
from adapters.ppsmc.trapezoid import Bounds
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.units import Unit, UnitError, convert

AXES = range(1, 17)  # L2449
PORT_BITS = range(8)  # inputs and outputs have the numbers of their bits (L3550)
METHODS = ("default", "org", "ref", "index", "switch", "slowdown", "limit", "here")
MOST_DECIMALS = 8  # L412
_FASTEST_HZ = 2_457_000  # L2866
# Without `start_rate` the motor starts at no more than this part of its speed limit.
_SMALL_START = 0.01


def motor(axis: Axis) -> int:
    return int(axis.motors[0])


def motors(config: Controller) -> dict[str, int]:
    """Axis numbers of the unit by axis name."""
    return {name: motor(axis) for name, axis in config.axes.items()}


def bounds(axis: Axis) -> Bounds:
    """Limits in steps."""
    scale = float(axis.scale)
    start = axis.start_rate
    low, high = (start.min, start.max) if start is not None else (0.0, axis.limits.velocity * _SMALL_START)
    return Bounds(
        speed=min(_FASTEST_HZ, axis.limits.velocity * scale * (1 + 1e-9)),
        acceleration=axis.limits.acceleration * scale,
        start_min=max(1, ceil(low * scale)),
        start_max=max(1, floor(high * scale)),
    )


def expected_gear(axis: Axis) -> Fraction | None:
    """Steps per mm or deg that `gnum` / `gden` must give; None: the axis is in counts."""
    for base in (Unit.MM, Unit.DEG):
        try:
            return axis.scale / convert(Fraction(1), axis.unit, base)
        except UnitError:
            continue
    return None


def decimals(gear: Fraction) -> int:
    """How many decimals tell one step from the next."""
    wanted = 1
    while wanted < MOST_DECIMALS and gear > 10**wanted:
        wanted += 1
    return wanted


def written(steps: int, gear: Fraction) -> str:
    """A position in the unit's distance, with as many decimals as it needs to be this step and no other."""
    exact = Fraction(steps) / gear
    places, scaled = 1, round(exact * 10)
    while places < 12 and abs(Fraction(scaled, 10**places) * gear - steps) > Fraction(1, 10):
        places += 1
        scaled = round(exact * 10**places)
    digits = str(abs(scaled)).rjust(places + 1, "0")
    return f"{'-' if scaled < 0 else ''}{digits[:-places]}.{digits[-places:]}"


def steps(text: str, gear: Fraction) -> int:
    """The step at a position that the unit has given."""
    return round(Fraction(text) * gear)


def grain(text: str, gear: Fraction) -> float:
    """How close that is, in steps: by its last decimal, and by the rounding to a step."""
    decimals = len(text.partition(".")[2])
    return 1.0 + float(gear) * 0.1**decimals


def limit_of(state: int) -> Literal["none", "forward", "reverse", "both"]:
    """The limit switches in the bits of ?s."""
    forward, reverse = bool(state & Bits.LIMIT_FORWARD), bool(state & Bits.LIMIT_REVERSE)
    if forward and reverse:
        return "both"
    return "forward" if forward else "reverse" if reverse else "none"


def check(config: Controller, options: Options) -> None:
    """Offline check of the fleet file. Raises `ValueError`."""
    if config.shares:
        raise ValueError("link.unit: an SMC has no address, and a port for itself; leave it out")
    if config.link.kind == "udp":
        raise ValueError("link.kind: udp is not supported; allowed: tcp, serial")
    for name, axis in config.axes.items():
        if not axis.motors[0].isdecimal() or int(axis.motors[0]) not in AXES:
            raise ValueError(f"axes.{name}.motors: {axis.motors[0]!r} is no axis of the unit; allowed: '1' to '16'")
        if axis.homing.method not in METHODS:
            raise ValueError(
                f"axes.{name}.homing.method: {axis.homing.method!r} is unknown; allowed: {', '.join(METHODS)}"
            )
        if axis.homing.method == "ref" and axis.homing.direction != "negative":
            raise ValueError(f"axes.{name}.homing.direction: method ref searches in negative direction; use org")
        limits = bounds(axis)
        if limits.speed < 1:
            raise ValueError(
                f"axes.{name}.limits.velocity: {axis.limits.velocity:g} {axis.unit}/s is below the unit's lowest "
                f"speed of one step per second"
            )
        if limits.start_min > limits.start_max or limits.start_min > limits.speed:
            raise ValueError(
                f"axes.{name}.start_rate: no whole number of steps per second lies between its min and its max, "
                f"and below limits.velocity; allowed: 1 to {floor(limits.speed)} steps per second"
            )
    for field, names in (("loop", list(options.loop)), ("encoders", options.encoders)):
        for name in names:
            if name not in config.axes:
                raise ValueError(f"options.{field}: no axis {name}; there are {', '.join(config.axes)}")
    for kind, points in (("inputs", config.inputs), ("outputs", config.outputs)):
        if points and not options.io_port:
            raise ValueError(
                f"{kind}: the i/o port is an option of the unit; set `options.io_port: true` if it is there"
            )
        for name, point in points.items():
            if point.number not in PORT_BITS:
                raise ValueError(f"{kind}.{name}.number: {point.number} does not exist; allowed: bits 0 to 7")
