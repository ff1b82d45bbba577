"""Describe a step of a job in one line."""

import json

from orchestrator.model.duration import format_ns, parse_duration
from orchestrator.model.job import FollowPath, Move, Repeat, Scan, Step
from orchestrator.model.names import ALL_AXES
from orchestrator.model.scan import ScanAxis
from orchestrator.model.triggers import Trigger


def describe_step(step: Step) -> str:
    """Describe what its file says, without defaults: `move to gantry.x=120 stage.u=6, speed=0.5`. Of a repeat only how
    many steps it has."""
    own = {"axes", "points", "scanspec", "at_each"} if isinstance(step, Scan) else set[str]()
    if isinstance(step, FollowPath):
        own = {"axes", "start", "pieces", "names"}
    said = step.model_dump(mode="json", exclude_defaults=True, exclude={"do", "name", "steps", "triggers", *own})
    words = [_describe_field(key, value) for key, value in said.items()]
    if isinstance(step, Repeat):
        words = [f"{step.times} times: {len(step.steps)} step{'' if len(step.steps) == 1 else 's'}"]
    if isinstance(step, FollowPath):
        pieces = "" if step.file else f", {len(step.pieces)} piece{'' if len(step.pieces) == 1 else 's'}"
        words = [f"of {' '.join(step.axes)}{pieces}", *words]
    if isinstance(step, Move | FollowPath):
        words += map(_describe_trigger, step.triggers)
    if isinstance(step, Scan):
        words = [_describe_points(step), *words, *_describe_at_each(step)]
    return " ".join(part for part in (step.do, step.name and f"'{step.name}'", ", ".join(words)) if part)


def _describe_trigger(trigger: Trigger) -> str:
    places = f"every {trigger.every}" if trigger.at is None else f"at {len(trigger.at)} places"
    return f"{trigger.output} {places}" + (f" of {trigger.of}" if trigger.of else "")


def _describe_points(scan: Scan) -> str:
    if scan.points is not None and scan.points.file is not None:
        return f"points of {scan.points.file}"
    axes = " ".join(f"{name}={_describe_axis(axis)}" for name, axis in scan.axes.items()) or " ".join(scan.axis_names)
    return f"{axes}, {scan.point_count} points" if axes else "points of a scanspec"


def _describe_axis(axis: ScanAxis) -> str:
    snake = " snake" if axis.snake else ""
    if axis.values is not None:
        return f"{len(axis.values)} values{snake}"
    return f"{axis.from_}…{axis.to} ({axis.count}{snake})"


def _describe_at_each(scan: Scan) -> list[str]:
    return ["at each " + "; ".join(map(describe_step, scan.at_each))] if scan.at_each else []


def _describe_field(key: str, value: dict[str, object] | list[str] | str | float | None) -> str:
    if isinstance(value, dict):
        if list(value) == [ALL_AXES]:
            return f"{key} {value[ALL_AXES]}"
        return f"{key} " + " ".join(f"{name}={_format_value(each)}" for name, each in value.items())
    if isinstance(value, list):
        return f"{key} " + " ".join(value)
    if isinstance(value, str) and value.endswith(" ns"):
        return f"{key}={format_ns(parse_duration(value))}"
    return f"{key}={_format_value(value)}"


def _format_value(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
