"""The fleet file's part in the drive's own terms: one node, one axis, whole units."""

from collections.abc import Iterator
from math import ceil, floor

from adapters.cia402.options import Cia402Options
from adapters.cia402.shapes.trapezoid import WORD_MAX, DriveBounds, DriveUnits
from orchestrator.model.fleet import Axis, Controller

MOTOR = "1"
POINTS = range(1, 17)
_NAMED_METHODS = {
    "default": 37,
    "current_position": 37,
    "negative_limit_and_index": 1,
    "positive_limit_and_index": 2,
    "negative_limit": 17,
    "positive_limit": 18,
    "home_switch_positive": 23,
    "home_switch_negative": 27,
    "index_negative": 33,
    "index_positive": 34,
}
POSITION_MAX = 2**31 - 1


def node_number(config: Controller) -> int:
    """Return the node number."""
    assert config.link.kind == "can"
    return config.link.address


def only_axis(config: Controller) -> tuple[str, Axis]:
    return next(iter(config.axes.items()))


def drive_units(options: Cia402Options) -> DriveUnits:
    return DriveUnits(float(options.velocity_units), float(options.acceleration_units))


def axis_bounds(axis: Axis) -> DriveBounds:
    """Return an axis's limits in counts."""
    scale = float(axis.scale)
    return DriveBounds(axis.limits.velocity * scale, axis.limits.acceleration * scale)


def homing_method(axis: Axis) -> int:
    """Return the number for 6098h."""
    method_number = _NAMED_METHODS.get(axis.homing.method)
    return int(axis.homing.method) if method_number is None else method_number


def homing_numbers(axis: Axis, options: Cia402Options) -> tuple[int, int, int]:
    """Return the speeds for the switch and for zero, and the acceleration, in the drive's units."""
    limits, homing, own, scale = axis_bounds(axis), axis.homing, drive_units(options), float(axis.scale)
    fast = limits.velocity / 10 if homing.speed is None else homing.speed * scale
    slow = fast / 10 if homing.search_speed is None else homing.search_speed * scale
    return (
        max(1, floor(fast * own.velocity)),
        max(1, floor(slow * own.velocity)),
        max(1, min(WORD_MAX, floor(limits.acceleration * own.acceleration))),
    )


def needs_stream(config: Controller) -> bool:
    """Return whether the axis uses jerk-limited motion, for which positions are streamed."""
    return only_axis(config)[1].limits.jerk is not None


def may_switch(config: Controller) -> bool:
    """Return whether outputs may be switched in a stream, and all of them may be made passive by a stop: none holds a
    brake, which would close in motion."""
    return bool(config.outputs) and needs_stream(config) and only_axis(config)[1].brake is None


def ramp_in_units(axis: Axis, own: DriveUnits) -> int:
    """Return the acceleration limit in the drive's units."""
    return max(1, int(axis.limits.acceleration * float(axis.scale) * own.acceleration))


def ramp_s(axis: Axis) -> float:
    """Return the duration of the ramp from full speed at the acceleration limit."""
    return axis.limits.velocity / axis.limits.acceleration


def passive_outputs(config: Controller) -> int:
    """Return 60FEh with every named output passive."""
    return sum(1 << (15 + point.number) for point in config.outputs.values() if point.active == "low")


def find_problems(config: Controller, options: Cia402Options) -> Iterator[str]:
    """Every mistake in the fleet file that can be found offline."""
    if config.link.kind != "can":
        yield f"link.kind: {config.link.kind!r} cannot reach a CiA 402 drive; allowed: can"
    for kind, points in (("inputs", config.inputs), ("outputs", config.outputs)):
        for point_name, point in points.items():
            if point.number not in POINTS:
                yield f"{kind}.{point_name}.number: {point.number} does not exist; allowed: 1 to 16"
    if len(config.axes) != 1:
        yield f"axes: a drive has one axis, not {len(config.axes)}; define a controller for each node"
        return
    name, axis = only_axis(config)
    if axis.motors[0] != MOTOR:
        yield f"axes.{name}.motors: {axis.motors[0]!r} is not a motor; allowed: '{MOTOR}'"
    method = axis.homing.method
    if method not in _NAMED_METHODS and not (method.lstrip("-").isdigit() and -128 <= int(method) <= 37):
        yield (
            f"axes.{name}.homing.method: {method!r} is unknown; allowed: {', '.join(_NAMED_METHODS)}, or a number of "
            "6098h from -128 to 37"
        )
    limits, own = axis_bounds(axis), drive_units(options)
    for limit_name, value in (
        ("velocity", limits.velocity * own.velocity),
        ("acceleration", limits.acceleration * own.acceleration),
    ):
        if not 1 <= value <= WORD_MAX:
            yield (
                f"axes.{name}.limits.{limit_name}: {ceil(value)} in the drive's units; allowed: 1 to {WORD_MAX}. See "
                "`scale`, `velocity_units` and `acceleration_units`"
            )
