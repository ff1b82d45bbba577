"""How the lines of a scan that flies are planned: speed, run-up and tolerance, from the scan and the limits of its
axes."""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from math import ceil, sqrt

import numpy as np

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.steps.fly import LEAST_WINDOW_NS, FlyOptions
from orchestrator.model.steps.scan import Scan
from orchestrator.model.units import Unit, UnitError, parse_quantity, parse_rate
from orchestrator.plan.flying.curves import CurvedLines, find_way_s
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.splines import find_longer, fit_curve, require_limits
from orchestrator.plan.flying.straight import FlownAxis, StraightLines
from orchestrator.plan.shape import WayEnd, WayLimits
from orchestrator.plan.targets import find_jerk

MARGIN_COUNTS = 2  # of each run-up: its ends are rounded to counts
LEAST_WINDOW_COUNTS = 2
# A make that switches outputs in a stream of positions makes a path slower until it is whole periods long: so a line
# with triggers is a little shorter than so many of these. A whole number of the usual periods.
PERIOD_S, PERIOD_MARGIN_S = 0.02, 0.0002
TOLERANCE = 0.25  # of a window
CURVE_USE = 0.8  # of acceleration and jerk on a curve whose duration is found: the rest is for braking along it
EVEN = 1e-9  # of a distance: rounding of values that are written as decimals


def plan_lines(scan: Scan, fleet: Fleet) -> FlownLines:
    """The lines of a scan that flies, whose positions are all quantities. Raises `Refusal` for what cannot be flown,
    wherever its axes are."""
    assert scan.fly is not None
    axes = {name: fleet.axis(name) for name in scan.flown_axes}
    name, unit = scan.flown_axis, _require_axes(axes)
    units = [Unit(fleet.axis(named_axis).unit) for named_axis in scan.axes]
    try:
        return (_plan_curve if scan.is_curved else _plan_straight)(scan, scan.fly, axes, unit, units)
    except UnitError as error:
        raise Refusal("bad-unit", f"`fly`: {error}", "correct the unit", controller_of(name)) from None


def _plan_straight(
    scan: Scan, fly: FlyOptions, axes: Mapping[str, Axis], unit: Unit, units: Sequence[Unit]
) -> StraightLines:
    """Straight lines. units: of all axes of the scan. Raises `Refusal`, `UnitError`."""
    flown_axes = _find_axes(scan, axes)
    length = _find_length([axis.spacing for axis in flown_axes])
    tolerance = _parse_tolerance(fly, unit, scan.flown_axis, length)
    most_speed = min(axes[axis.name].limits.velocity / axis.share for axis in flown_axes)
    speed = _find_speed(fly, unit, length, most_speed)
    _require_windows(flown_axes)
    _require_speed(flown_axes, axes, length / speed)
    _require_detector(fly, scan.flown_axis, length / speed)
    acceleration = min(axes[axis.name].limits.acceleration / axis.share for axis in flown_axes)
    ramp_s = acceleration / min(find_jerk(axes[axis.name]) / axis.share for axis in flown_axes)
    run_up_s = speed / acceleration + ramp_s
    run_up = speed * run_up_s / 2 + find_margin(flown_axes)
    if fly.trigger is not None:
        line_s = 2 * run_up / speed + run_up_s + scan.line_points * length / speed
        run_up += speed * (ceil(line_s / PERIOD_S) * PERIOD_S - PERIOD_MARGIN_S - line_s) / 2
    return StraightLines(
        scan=scan,
        units=units,
        counts_per_unit=[axis.counts_per_unit for axis in flown_axes],
        count=scan.line_points,
        tolerance=tolerance,
        run_up_s=run_up_s,
        axes=flown_axes,
        length=length,
        speed=min(speed, most_speed),
        acceleration=acceleration,
        ramp_s=ramp_s,
        run_up=run_up,
    )


def _plan_curve(
    scan: Scan, fly: FlyOptions, axes: Mapping[str, Axis], unit: Unit, units: Sequence[Unit]
) -> CurvedLines:
    """Curves. units: of all axes of the scan. Raises `Refusal`, `UnitError`."""
    knots = np.array([scan.axes[name].list_knots(unit) for name in axes]).T
    lengths, limited_axes = np.linalg.norm(np.diff(knots[::2], axis=0), axis=1), list(axes.values())
    if not lengths.min() > 0.0:
        text = f"the window of point {int(lengths.argmin()) + 1} of the curve begins where it ends"
        raise Refusal("fly-window", text, "correct its bounds", controller_of(scan.flown_axis))
    limits = [WayLimits(axis.limits.velocity, axis.limits.acceleration, find_jerk(axis)) for axis in limited_axes]
    curve = fit_curve(knots, fly.duration / NS_PER_S if fly.duration is not None else _find_least_s(fly))
    if fly.duration is None:
        braking_limits = [
            WayLimits(limit.velocity, limit.acceleration * CURVE_USE, limit.jerk * CURVE_USE) for limit in limits
        ]
        curve = curve.stretch_time(max(1.0, find_longer(curve, braking_limits)))
    require_limits(curve, list(axes), unit, limits)
    fastest_states = [
        WayEnd(0.0, *peaks)
        for peaks in zip(np.abs(curve.velocities).max(axis=0), curve.peak_accelerations.max(axis=0), strict=True)
    ]
    _require_detector(fly, scan.flown_axis, curve.duration_s / scan.line_points)
    return CurvedLines(
        scan=scan,
        units=units,
        counts_per_unit=[abs(Fraction(axis.counts_per_unit)) for axis in limited_axes],
        count=scan.line_points,
        tolerance=_parse_tolerance(fly, unit, scan.flown_axis, float(lengths.min())),
        run_up_s=find_way_s(fastest_states, limits),
        curve=curve,
        limits=limits,
    )


def find_margin(axes: Sequence[FlownAxis]) -> float:
    """What a run-up along a line has beside its need."""
    return MARGIN_COUNTS / min(float(axis.counts_per_unit) for axis in axes)


def _require_axes(axes: Mapping[str, Axis]) -> Unit:
    """The unit of the axes that fly. Raises `Refusal` for axes that cannot be on one line."""
    for name, axis in axes.items():
        if axis.turn_length is not None:
            text = f"axis {name} wraps, and a line has a beginning and an end"
            raise Refusal("fly-axis", text, "scan it point by point: leave out `fly`", controller_of(name))
        if axis.is_compensated:
            text = f"axis {name} has `backlash` or `correction`, which are not applied in flight yet"
            raise Refusal("not-compensated", text, "scan it point by point: leave out `fly`", controller_of(name))
    units = {Unit(axis.unit): name for name, axis in axes.items()}
    if len(units) > 1:
        words = ", ".join(f"{name} in {axis.unit}" for name, axis in axes.items())
        text = f"the axes that fly together along a line must have one unit; they are {words}"
        raise Refusal("fly-axis", text, "leave one of them out of `fly.axis`, or change its unit in the fleet file")
    return next(iter(units))


def _find_axes(scan: Scan, axes: Mapping[str, Axis]) -> list[FlownAxis]:
    """The axes that fly, with their shares of the line. Raises `Refusal`, `UnitError`."""
    places = {name: _find_spacing(scan, name, Unit(axis.unit)) for name, axis in axes.items()}
    length = _find_length([spacing for _, spacing in places.values()])
    return [
        FlownAxis(name, first, spacing, abs(Fraction(axes[name].counts_per_unit)), abs(float(spacing)) / length)
        for name, (first, spacing) in places.items()
    ]


def _find_length(spacings: Sequence[Fraction]) -> float:
    """The length of a window along the line."""
    if len(spacings) == 1:
        return abs(float(spacings[0]))
    return sqrt(sum(float(spacing) ** 2 for spacing in spacings))


def _find_spacing(scan: Scan, name: str, unit: Unit) -> tuple[Fraction, Fraction]:
    """The first position of an axis that flies, and the distance of two. Raises `Refusal`, `UnitError`."""
    axis = scan.axes[name]
    count = axis.count
    positions = [axis.position(number, unit) for number in range(count if axis.values is not None else 2)]
    spacing = positions[1] - positions[0]
    if axis.values is not None:
        spacing = (positions[-1] - positions[0]) / (count - 1)
        off = max(abs(position - positions[0] - spacing * k) for k, position in enumerate(positions))
        if off > abs(spacing) * Fraction(EVEN):
            text = f"the `values` of {name} are not evenly spaced, and one speed cannot fit windows of several lengths"
            raise Refusal("fly-spacing", text, "write `from`, `to` and `points`, or leave out `fly`")
    if spacing == 0:
        text = f"all points of {name} are at {float(positions[0]):g} {unit}, so that it would not move"
        is_joint = len(scan.flown_axes) > 1
        remedy = "leave it out of `fly.axis`" if is_joint else "leave out `fly`"
        raise Refusal("fly-spacing", text, f"write another `to`, or {remedy}")
    return positions[0], spacing


def _require_windows(axes: Sequence[FlownAxis]) -> None:
    """Raise `Refusal` for windows that are too short to be told apart on any axis."""
    lead = max(axes, key=lambda axis: axis.window_counts)
    if lead.window_counts < LEAST_WINDOW_COUNTS:
        text = f"the windows of {lead.name} are {lead.window_counts:.3g} counts long; the least are 2"
        raise Refusal("fly-window", text, "put its points farther apart", controller_of(lead.name))


def _require_speed(flown_axes: Sequence[FlownAxis], axes: Mapping[str, Axis], window_s: float) -> None:
    """Raise `Refusal` for windows in which an axis is faster than its limit: the one that exceeds it most."""
    fitting_s = {axis.name: abs(float(axis.spacing)) / axes[axis.name].limits.velocity for axis in flown_axes}
    worst = max(flown_axes, key=lambda axis: fitting_s[axis.name])
    if fitting_s[worst.name] <= window_s * (1 + EVEN):
        return
    window, axis = abs(float(worst.spacing)), axes[worst.name]
    text = (
        f"{worst.name} flies at {window / window_s:g} {axis.unit}/s through windows of {window:g} {axis.unit}; its "
        f"limit is {axis.limits.velocity:g} {axis.unit}/s"
    )
    fitting_ms = fitting_s[worst.name] * 1e3
    remedy = f"`duration: {fitting_ms * 1.0005:.4g} ms` or longer fits, or points that are closer together"
    raise Refusal("fly-speed", text, remedy, controller_of(worst.name))


def _require_detector(fly: FlyOptions, axis: str, window_s: float) -> None:
    """Raise `Refusal` for windows that are shorter than the detector takes."""
    detector, trigger = fly.detector, fly.trigger
    least_s = 0.0 if detector is None else detector.least_window_s
    if window_s < least_s * (1 - EVEN):
        text = f"the windows of {axis} last {window_s * 1e3:.4g} ms; the detector takes one in {least_s * 1e3:.4g} ms"
        remedy = f"`duration: {least_s * 1e3:.4g} ms` or longer fits, or leave `duration` and `speed` out"
        raise Refusal("fly-detector", text, remedy, controller_of(axis))
    if trigger is not None and trigger.gate and detector is not None and detector.dead_time >= window_s * NS_PER_S:
        text = f"a gate in windows of {window_s * 1e3:.4g} ms has no time beside a dead time as long"
        raise Refusal("fly-detector", text, "write a longer `duration`", controller_of(axis))


def _find_speed(fly: FlyOptions, unit: Unit, length: float, most_speed: float) -> float:
    """The speed in the windows along the line, in the unit of the axes per s. most_speed: that their limits allow.
    Raises `Refusal`, `UnitError`."""
    if fly.duration is not None:
        return length / (fly.duration / NS_PER_S)
    if fly.speed is None:
        return min(most_speed, length / _find_least_s(fly))
    value = fly.speed
    if isinstance(value, str) and value.strip().endswith("%"):
        raise Refusal("bad-unit", f"`fly`: a speed of {value} says no time for a point", 'write e.g. "5 mm/s"')
    speed = parse_rate(value, unit, 1) if isinstance(value, str) else float(value or 0.0)
    if not speed > 0.0:
        raise Refusal("fly-speed", f"`fly`: the speed is {value}; it must be above 0", "choose a value above 0")
    return speed


def _find_least_s(fly: FlyOptions) -> float:
    """The shortest window that controllers and the detector take, s."""
    return max(LEAST_WINDOW_NS / NS_PER_S, 0.0 if fly.detector is None else fly.detector.least_window_s)


def _parse_tolerance(fly: FlyOptions, unit: Unit, name: str, length: float) -> float:
    if fly.tolerance is None:
        return length * TOLERANCE
    return float(parse_quantity(fly.tolerance, unit, name))
