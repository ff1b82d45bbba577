"""Whether the lines of a scan that flies, with run-up and run-down, are inside the soft limits of their axes: straight
ones before they are planned together, curves as they are planned."""

from collections.abc import Callable, Sequence
from fractions import Fraction
from math import sqrt

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.plan.flying.line_plan import MARGIN_COUNTS, PERIOD_S, find_margin
from orchestrator.plan.flying.motions import find_extremes
from orchestrator.plan.flying.straight import FlownAxis, StraightLines
from orchestrator.plan.path_profiles import FittedMotion


def check_room(lines: StraightLines, fleet: Fleet, find_offset: Callable[[str], Fraction | None]) -> None:
    """Raise `Refusal` for lines that leave the soft limits with their run-up or run-down. find_offset: user minus motor
    position of an axis, None: not known yet."""
    ends = lines.ends
    for axis, begin, end in zip(lines.axes, ends.begin, ends.end, strict=True):
        offset = find_offset(axis.name)
        if offset is not None:
            _check_axis(lines, axis, fleet.axis(axis.name), (min(begin, end), max(begin, end)), float(offset))


def _check_axis(lines: StraightLines, flown: FlownAxis, axis: Axis, reach: tuple[float, float], offset: float) -> None:
    """Raise `Refusal` for an axis that leaves its soft limits. reach: from where to where its lines go."""
    limits = axis.soft_limits_counts
    if limits is None:
        return
    low, high = sorted(axis.to_unit(limit) + offset for limit in limits)
    least, most = reach
    excess = max(low - least, most - high)
    if excess * float(flown.counts_per_unit) <= 0.5:
        return
    limit, line_end = (low, least) if low - least == excess else (high, most)
    run_up = float(lines.find_run_up(flown))
    text = (
        f"{flown.name} needs {run_up:.4g} {axis.unit} before and behind its windows for "
        f"{lines.find_speed(flown):g} {axis.unit}/s; its lines reach {line_end:.6g} {axis.unit}, "
        f"{excess:.4g} {axis.unit} beyond its soft limit {limit:g} {axis.unit}"
    )
    fitting = _describe_fitting(lines, (run_up - excess) / flown.share)
    remedy = f"{fitting}scan a shorter line, or change the soft limits in the fleet file"
    raise Refusal("fly-room", text, remedy, controller_of(flown.name))


def _describe_fitting(lines: StraightLines, room: float) -> str:
    """Which time in a window fits a shorter run-up, in words; empty if none does. room: for the run-up, along the
    line."""
    has_trigger = lines.scan.fly is not None and lines.scan.fly.trigger is not None
    room -= find_margin(lines.axes) + lines.speed * PERIOD_S / 2 * has_trigger
    if room <= 0.0:
        return ""
    acceleration, ramp_s = lines.acceleration, lines.ramp_s
    speed = acceleration * (sqrt(ramp_s**2 + 8 * room / acceleration) - ramp_s) / 2
    return f"`duration: {lines.length / speed * 1.0005e3:.4g} ms` or longer fits; or "


def check_curve_room(motion: FittedMotion, axes: Sequence[tuple[str, Axis]]) -> None:
    """Raise `Refusal` for a motion that leaves the soft limits of its axes. motion: in motor positions."""
    least, most = find_extremes(motion)
    for (name, axis), low_reach, high_reach in zip(axes, least.tolist(), most.tolist(), strict=True):
        limits = axis.soft_limits_counts
        if limits is None:
            continue
        low, high = sorted(map(axis.to_unit, limits))
        excess = max(low - low_reach, high_reach - high)
        if excess * abs(float(axis.counts_per_unit)) > MARGIN_COUNTS:
            reach, limit = (low_reach, low) if low - low_reach == excess else (high_reach, high)
            text = (
                f"on its curve, with run-up and run-down, {name} reaches {reach:.6g} {axis.unit}, {excess:.4g} "
                f"{axis.unit} beyond its soft limit {limit:g} {axis.unit}"
            )
            remedy = "write a longer `duration`, which needs a shorter run-up, or scan a smaller curve"
            raise Refusal("fly-room", text, remedy, controller_of(name))
