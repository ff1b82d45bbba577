"""Where a step moves its axes, compared with where they are: another client may have set a position, or moved an axis,
after the step was loaded."""

from adapters.contract import AxisReading, ControllerReading
from adapters.controller.state.armed_step import ArmedStep
from orchestrator.model.fleet import Axis, Controller

_REMEDY = "another client has set it, or moved it; it must be homed again"


def find_last_instant(reading: ControllerReading) -> int:
    """The last instant at which the controller can have sampled its positions, host time."""
    return reading.at_ns if reading.sampled is None else reading.sampled.latest_ns


def find_misplaced_axes(
    config: Controller, step: ArmedStep, following: ArmedStep | None, reading: ControllerReading
) -> dict[str, str]:
    """Axes that are where the step, which is released or moves, brings them at no time, in words. Before it begins they
    are at its start. following: the step behind it, which may have begun when the end of this one is not seen yet."""
    read_ns = find_last_instant(reading)
    is_before = step.is_before_begin(read_ns)
    has_begun = following is not None and following.executes and not following.is_before_begin(read_ns)
    ways_behind = following.ways if following is not None and has_begun else {}
    misplaced_axes: dict[str, str] = {}
    for name, way in step.ways.items():
        axis_reading, axis = reading.axes[name], config.axes[name]
        counts = axis_reading.commanded_counts
        # What a limit switch stops may come to rest beyond its way.
        is_stopped = not axis_reading.enabled or axis_reading.limit != "none"
        if is_stopped or not (way.is_off_start(counts) if is_before else way.is_outside(counts)):
            continue
        if name in ways_behind and not ways_behind[name].is_outside(counts):
            continue
        range_text = f"moves it from {axis.to_unit(way.low):g} to {axis.to_unit(way.high):g}"
        plan_text = f"the step begins at {axis.to_unit(way.start):g}" if is_before else f"the step {range_text}"
        misplaced_axes[name] = f"axis {name} is at {_format_position(axis, axis_reading)}, and {plan_text}: {_REMEDY}"
    return misplaced_axes


def find_wrong_ends(config: Controller, step: ArmedStep, reading: ControllerReading) -> dict[str, str]:
    """Axes that are not where the step ends, which is done, in words."""
    return {
        name: f"axis {name} is at {_format_position(config.axes[name], reading.axes[name])}, and the step ends at "
        f"{config.axes[name].to_unit(way.end):g}: {_REMEDY}"
        for name, way in step.ways.items()
        if reading.axes[name].enabled and way.is_off_end(reading.axes[name].commanded_counts)
    }


def _format_position(axis: Axis, reading: AxisReading) -> str:
    return f"{axis.to_unit(reading.commanded_counts):g} {axis.unit}"
