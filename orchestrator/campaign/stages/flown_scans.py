"""Scans that fly in the fault campaign: lines in one motion, some with a pulse in each window."""

from collections.abc import Mapping, Sequence
from random import Random
from typing import Any

from orchestrator.campaign.stages.fleet_parts import TRIGGER_OUTPUT
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.scan import Scan

SPACING = 1.0  # unit, a window; a count is a thousandth of it
LINES = (4, 6, 8, 10)  # the longer ones are of several chunks
POINTS = (11, 18)  # of a line, least and most
WINDOWS_MS = (50, 60, 80)
OUTER_STEP = (0.4, 2.0)  # unit, between two lines
ROOM = 8.0  # unit, from where an axis stands to its lines: for the run-up, and something to go there
TOLERANCE = 2.0  # unit: the clocks of a campaign's fleet are young
TRIGGER_CHANCE = 0.6
PULSE = "5 ms"
PAIRED_AXES = 2  # besides the flown and the outer one, that have two positions each


def draw_flown_scan(
    fleet: Fleet, controllers: Sequence[str], member: str, positions: Mapping[str, float], draw: Random
) -> dict[str, Any]:
    """Draw a scan whose lines the first axis of `member` flies, with the first axis of each other controller outside of
    it. positions: of each axis, in its unit."""
    flown_axis, *outer_axes = [
        f"{name}.{next(iter(fleet.controllers[name].axes))}"
        for name in (member, *(name for name in controllers if name != member))
    ]
    begins = {axis: _find_begin(fleet, axis, positions[axis]) for axis in (flown_axis, *outer_axes)}
    lines, points = draw.choice(LINES), draw.randint(*POINTS)
    axes: dict[str, dict[str, Any]] = {axis: {"values": [begins[axis]]} for axis in outer_axes[1 + PAIRED_AXES :]}
    for axis in outer_axes[1 : 1 + PAIRED_AXES]:
        axes[axis] = _make_axis(begins[axis], 2, draw.uniform(*OUTER_STEP))
        lines //= 2
    if outer_axes:
        axes[outer_axes[0]] = _make_axis(begins[outer_axes[0]], max(2, lines), draw.uniform(*OUTER_STEP))
    axes[flown_axis] = _make_axis(begins[flown_axis], points, SPACING)
    fly: dict[str, Any] = {
        "duration": f"{draw.choice(WINDOWS_MS)} ms",
        "tolerance": TOLERANCE,
        "repeat_disturbed": draw.choice((0, 2)),
    }
    outputs = [f"{name}.{TRIGGER_OUTPUT}" for name in controllers if TRIGGER_OUTPUT in fleet.controllers[name].outputs]
    if outputs and draw.random() < TRIGGER_CHANCE:
        fly["trigger"] = {"output": draw.choice(outputs), "at": draw.choice(("start", "middle", "end")), "pulse": PULSE}
    return {"do": "scan", "axes": axes, "fly": fly}


def _find_begin(fleet: Fleet, axis: str, position: float) -> float:
    """Where the lines of an axis begin: near its position, towards the middle of its way."""
    reach = fleet.axis(axis).limits.velocity
    way = POINTS[1] * SPACING + ROOM
    return round(position + ROOM if position + way < reach else position - way, 2)


def _make_axis(begin: float, points: int, step: float) -> dict[str, Any]:
    return {"from": begin, "to": round(begin + step * (points - 1), 3), "points": points, "snake": True}


def find_flown_scan(job: Job) -> Scan | None:
    """The scan of a job that flies, None: it has none."""
    return next((step for step in job.steps if isinstance(step, Scan) and step.fly is not None), None)


def find_flight_ns(job: Job) -> int:
    """How long the windows of a job are flown at least, without turn-arounds; 0 without any."""
    scan = find_flown_scan(job)
    if scan is None or scan.fly is None or scan.fly.duration is None:
        return 0
    return scan.point_count * scan.fly.duration
