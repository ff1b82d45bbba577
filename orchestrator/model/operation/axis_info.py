"""What does not change about an axis while a program runs, for programs that describe it to others."""

from dataclasses import dataclass
from math import ceil, log10

from orchestrator.model.fleet import Axis
from orchestrator.model.state import AxisState, ControllerInfo, RetargetAbility
from orchestrator.model.units import find_si_size, parse_quantity

MAX_DIGITS = 12


@dataclass(frozen=True, slots=True)
class AxisInfo:
    """One axis of a fleet.

    name: `controller.axis`. make: of its controller; motor: its name there, of two motors both. unit: of all values
    here. resolution: of one count; digits: decimals with which that is shown. least, most: where it may be sent, in
    user positions as of now (the soft limits plus the offset); None: it has no soft limits, or is endless (`wrap`).
    velocity, acceleration, jerk: limits, in its unit per second (², ³); jerk None: it is planned with trapezoids. wrap:
    the length of a turn. referenced: whether its position counts from its reference. description: from the fleet file.
    si_size: of its unit, in metres or radians; None for a unit of neither.
    retarget: how it gets another target on the way, and the most time from a request until its set-points change; where
    several controllers move together, they brake.
    """

    name: str
    make: str
    motor: str
    unit: str
    kind: str
    resolution: float
    digits: int
    least: float | None
    most: float | None
    velocity: float
    acceleration: float
    jerk: float | None
    wrap: float | None
    referenced: bool
    description: str
    retarget: RetargetAbility
    si_size: float | None = None


def describe_axis(name: str, axis: Axis, axis_now: AxisState, info: ControllerInfo) -> AxisInfo:
    """What is known about `controller.axis` from the fleet file, its offset from its state, and what its controller
    can do."""
    resolution = float(1 / axis.scale)
    wrap = None if axis.wrap is None else float(parse_quantity(axis.wrap, axis.unit, name))
    limits = None if wrap is not None else axis.soft_limits
    offset = axis_now.offset
    return AxisInfo(
        name=name,
        make=info.make,
        motor=", ".join(axis.motors),
        unit=axis.unit,
        kind=axis.kind,
        resolution=resolution,
        digits=min(MAX_DIGITS, max(0, ceil(-log10(resolution)))),
        least=None if limits is None else float(parse_quantity(limits.min, axis.unit, name) + offset),
        most=None if limits is None else float(parse_quantity(limits.max, axis.unit, name) + offset),
        velocity=axis.limits.velocity,
        acceleration=axis.limits.acceleration,
        jerk=axis.limits.jerk,
        wrap=wrap,
        referenced=axis_now.referenced,
        description=axis.description,
        retarget=info.retarget_ability,
        si_size=find_si_size(axis.unit),
    )
