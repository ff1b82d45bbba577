"""The fleet file's part in the controller's own terms: its one motor, steps, rates, inputs and outputs."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor

from orchestrator.model.fleet import Axis, Controller, SerialLink

START_MIN, START_MAX = 16, 2000  # steps/s, L2260-L2264
TOP_MIN, TOP_MAX = 16, 15_000  # steps/s, L2265-L2269
RAMP_MAX = 10_000  # steps, L2270-L2279
POSITION_MAX = 8_388_607  # L2051-L2056
POINTS = range(1, 4)  # user inputs and outputs
LINE_ADDRESSES = range(1, 8)
BAUDS = (110, 150, 300, 600, 1200, 2400, 4800, 9600)
METHODS = ("default", "input1", "input2", "input3")
# Without `start_rate` the motor starts at no more than this fraction of its speed limit.
_SMALL_START = 0.01


@dataclass(frozen=True, slots=True)
class Smc30Bounds:
    """Limits of the controller's commands, in steps/s and steps/s²."""

    top: int
    acceleration: float
    start_min: int
    start_max: int


def only_axis(config: Controller) -> tuple[str, Axis]:
    """Return the one axis of a controller, with its name."""
    ((name, axis),) = config.axes.items()
    return name, axis


def line_address(config: Controller) -> int | None:
    """Return the address. None: the controller is alone on its line, and no address is sent."""
    return config.link.address if isinstance(config.link, SerialLink) else None


def axis_bounds(axis: Axis) -> Smc30Bounds:
    """Return an axis's limits in steps."""
    scale = float(axis.scale)
    start = axis.start_rate
    low, high = (start.min, start.max) if start is not None else (0.0, axis.limits.velocity * _SMALL_START)
    start_min = max(START_MIN, ceil(low * scale - 1e-9))
    return Smc30Bounds(
        top=min(TOP_MAX, floor(axis.limits.velocity * scale * (1 + 1e-9))),
        acceleration=axis.limits.acceleration * scale * (1 + 1e-9),
        start_min=start_min,
        start_max=max(min(START_MAX, floor(high * scale + 1e-9)), START_MIN if start is None else 0),
    )


def homing_rate(axis: Axis) -> int:
    """Return the rate of the reference search, steps/s: H runs at the start rate (L2083)."""
    speed = axis.homing.speed if axis.homing.speed is not None else axis.limits.velocity / 10
    return max(START_MIN, min(START_MAX, floor(speed * float(axis.scale))))


def find_problems(config: Controller) -> Iterator[str]:
    """Every mistake in the fleet file that can be found offline."""
    yield from _find_link_problems(config)
    yield from _find_axis_problems(config)
    for kind, points in (("inputs", config.inputs), ("outputs", config.outputs)):
        for point_name, point in points.items():
            if point.number not in POINTS:
                yield f"{kind}.{point_name}.number: {point.number} does not exist; allowed: 1 to 3"


def _find_axis_problems(config: Controller) -> Iterator[str]:
    if len(config.axes) != 1:
        yield f"axes: {len(config.axes)} are named ({', '.join(config.axes)}); an SMC30 has one motor"
        return
    name, axis = only_axis(config)
    if axis.motors[0] != "1":
        yield f"axes.{name}.motors: {axis.motors[0]!r} is not a motor; allowed: '1'"
    if axis.homing.method not in METHODS:
        yield f"axes.{name}.homing.method: {axis.homing.method!r} is unknown; allowed: {', '.join(METHODS)}"
    limits = axis_bounds(axis)
    if limits.top < TOP_MIN:
        yield (
            f"axes.{name}.limits.velocity: {axis.limits.velocity:g} {axis.unit}/s is below the lowest rate of "
            f"{TOP_MIN} steps/s"
        )
    if limits.start_min > limits.start_max:
        yield (
            f"axes.{name}.start_rate: no whole rate at which the controller can start is between its min "
            f"and its max; allowed: {START_MIN} to {START_MAX} steps/s"
        )


def _find_link_problems(config: Controller) -> Iterator[str]:
    link = config.link
    if isinstance(link, SerialLink):
        if (link.data_bits, link.parity, link.stop_bits) != (7, "odd", 1):
            yield (
                f"link: {link.data_bits} data bits, parity {link.parity}, {link.stop_bits} stop bits; an "
                "SMC30 uses 7 data bits, odd parity, 1 stop bit: set `data_bits: 7` and `parity: odd`"
            )
        if link.baud not in BAUDS:
            yield f"link.baud: {link.baud} is not possible; allowed: {', '.join(map(str, BAUDS))}"
        if link.rtscts:
            yield "link.rtscts: an SMC30 has no handshake lines; remove it"
        if link.address is not None and link.address not in LINE_ADDRESSES:
            yield (f"link.address: {link.address} is not an address; allowed: 1 to 7, or none for a controller alone")
    elif link.kind == "udp":
        yield "link.kind: udp is not possible; allowed: serial, or tcp for a bridge to a serial port"
