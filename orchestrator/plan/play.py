"""Ways of motors whose drives have play, and how far their axes may be from where they should be.

Behind a reversal a motor goes farther by the play of its drive. An axis that is approached from one side goes beyond
its target by an overrun first, unless its way leads there from that side anyway; a second motion brings it back.
"""

from dataclasses import dataclass
from typing import Literal

from orchestrator.model.compensation import Approach, Play
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.report import PositionBound
from orchestrator.model.steps.move import Move

ROUNDED_COUNTS = 0.5  # of a target to counts, and of the amount of play


@dataclass(frozen=True, slots=True)
class MotorWay:
    """The way of a motor in one motion from rest to rest, in counts.

    end: where the motor stops last, behind the way back from an overrun. left: how far the axis is ahead of its motor
    at `target`. take_up: where it goes before, at the speed of its own, so
    that the axis moves from the beginning; None: nowhere. is_overrun: another motion must follow, back to the target.
    """

    start: int
    target: int
    end: int
    left: Play | None = None
    take_up: int | None = None
    is_overrun: bool = False
    is_return: bool = False


def choose_approach(axis: Axis, asked: Approach | None) -> Approach:
    """From which side an axis ends at its target. asked: by the step."""
    if axis.backlash is None:
        return "none"
    return axis.backlash.approach if asked is None else asked


def require_play(fleet: Fleet, step: Move) -> None:
    """Raise `Refusal` for a step that asks for an approach of axes without `backlash`."""
    if step.approach in (None, "none"):
        return
    real_axes = (name for name in fleet.find_real_axes(step.named_axes) if name in fleet.names.axes)
    rigid_axes = [name for name in real_axes if fleet.axis(name).backlash is None]
    if rigid_axes:
        text = f"`approach: {step.approach}`: axis {rigid_axes[0]} has no `backlash`, which states how far to overrun"
        raise Refusal("no-backlash", text, "add `backlash` to the axis in the fleet file, or name it in another step")


def require_no_play(name: str, axis: Axis, event: Literal["latch", "contact"]) -> None:
    """Raise `Refusal` for an axis whose drive has play, where a position is captured at an event on its way."""
    if axis.backlash is not None:
        text = f"axis {name} has `backlash`, and which part of its play is taken up at the {event} is not known"
        verb = "latch" if event == "latch" else "probe with"
        raise Refusal("not-compensated", text, f"{verb} an axis without play")


def find_motor_way(axis: Axis, start: int, play: Play | None, target: int, approach: Approach) -> MotorWay:
    """The way of a motor from count `start`, so that the axis is at `target`, which counts without play. play: how far
    the axis is ahead of its motor now; None: unknown."""
    drive = axis.play
    if drive is None:
        return MotorWay(start, target, target)
    play = play or drive
    if approach != "none":
        return _find_one_sided(axis, start, play, target, approach)
    end = play.find_target(start, target, drive)
    take_up = _find_take_up(axis, start, play, end)
    return MotorWay(start, end, end, play.follow(end - start, drive), take_up)


def _find_one_sided(axis: Axis, start: int, play: Play, target: int, approach: Approach) -> MotorWay:
    assert axis.backlash is not None and axis.play is not None
    drive, direction = axis.play, 1 if (approach == "positive") == (axis.sign > 0) else -1
    ahead_counts = drive.least if direction > 0 else drive.most
    end = target - ahead_counts
    play_left = play.follow(end - start, drive)
    overrun = max(round(axis.backlash.overrun_length * float(axis.scale)), drive.most - drive.least)
    if play_left.least == play_left.most == ahead_counts and (end - start) * direction >= 0:
        return MotorWay(start, end, end, play_left, is_return=abs(end - start) <= overrun)
    turn = end - direction * overrun
    return MotorWay(start, turn, end, play.follow(turn - start, drive), is_overrun=True)


def _find_take_up(axis: Axis, start: int, play: Play, end: int) -> int | None:
    assert axis.backlash is not None and axis.play is not None
    if axis.backlash.speed is None or start == end:
        return None
    by = play.most - axis.play.least if end > start else play.least - axis.play.most
    return start + by if 0 < abs(by) < abs(end - start) else None


def find_play_at_end(axis: Axis, way: MotorWay) -> Play | None:
    """How far an axis is ahead of its motor at its target, behind the way back from an overrun."""
    if not way.is_overrun or axis.play is None:
        return way.left
    ahead_counts = axis.play.least if way.target < way.end else axis.play.most
    return Play(least=ahead_counts, most=ahead_counts)


def explain_overrun(name: str, axis: Axis, way: MotorWay, offset: float) -> Refusal | None:
    """Why an overrun is outside the soft limits; None if it is inside. offset: of user positions."""
    limits = axis.motor_limits_counts
    if not way.is_overrun or limits is None or limits[0] <= way.target <= limits[1]:
        return None
    assert axis.backlash is not None
    low, high = sorted(axis.to_unit(limit) + offset for limit in axis.soft_limits_counts or ())
    text = (
        f"axis {name}: the overrun of {axis.backlash.overrun_length:g} {axis.unit} leads to "
        f"{axis.to_unit(way.target) + offset:g} {axis.unit}, beyond its soft limits {low:g} to {high:g} {axis.unit}"
    )
    remedy = "choose a target farther inside, another `approach`, or a smaller `backlash: {overrun}`"
    return Refusal("soft-limit", text, remedy, controller_of(name))


def bound_position(axis: Axis, way: MotorWay) -> PositionBound | None:
    """How far a compensated axis may be from its target at the end of its way, by what its file states; None for
    another axis."""
    if axis.backlash is None and axis.correction is None:
        return None
    scale = float(axis.scale)
    rounding, table, play = ROUNDED_COUNTS / scale, 0.0, 0.0
    if axis.correction is not None:
        errors = axis.correction.table
        table = errors.most_uncertainty
        # The table was measured with the play taken up in one direction.
        rounding += 0.0 if axis.backlash is None else errors.slope * axis.backlash.amount
    last_play = find_play_at_end(axis, way)
    if last_play is not None:
        rounding += ROUNDED_COUNTS / scale
        play = (last_play.most - last_play.least) / scale
    return PositionBound(most=rounding + table + play, rounding=rounding, table=table, play=play, unit=axis.unit)


def bound_path(axis: Axis) -> PositionBound | None:
    """The same of an axis on a path, where the play of a reversal is not taken up."""
    return bound_position(axis, MotorWay(0, 0, 0, axis.play))


def bound_way(axis: Axis, asked: Approach | None) -> float:
    """How far an axis may be from where its motor would have it on the way of a move, in its unit: its play before it
    follows, its overrun, and what tables have between the ends of the way. 0 for an axis that is not compensated.
    asked: the approach of the step."""
    bound = bound_path(axis)
    if bound is None:
        return 0.0
    overrun = 0.0 if axis.backlash is None or choose_approach(axis, asked) == "none" else axis.backlash.overrun_length
    return bound.most + overrun + (0.0 if axis.correction is None else axis.correction.table.span)
