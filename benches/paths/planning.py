"""What the planner of paths makes of random ones: limits held, time against the least, processor time."""

import re
import time
from collections.abc import Callable
from math import cos, sin
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benches.paths.lower_bound import find_least_time
from benches.paths.random_paths import (
    even_limits,
    find_worst_use,
    random_outline,
    stop_everywhere,
    uneven_limits,
)
from orchestrator.model.paths.files.gcode.reader import GcodeReader
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.units import Unit
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.resolve import resolve_path
from orchestrator.plan.path.run import plan_run

SAMPLES = 4  # of each segment; segments are much shorter than what they follow
GRID = 30  # cells of a span, of the least time


class LimitsRun(NamedTuple):
    """A random path. worst: the largest part of a limit that is used; None: refused."""

    worst: float | None


def run_limits(seed: int) -> LimitsRun:
    """Plan a random path of 2 to 8 axes: even seeds with the same limits for all axes, odd ones with limits over
    decades and pieces of 10 um to 1 m."""
    draw = np.random.default_rng(seed)
    axes = int(draw.integers(2, 9))
    if seed % 2:
        least = 10 ** draw.uniform(-2, 1)
        limits, lengths = uneven_limits(draw, axes), (least, least * 10 ** draw.uniform(0.1, 2))
        outline = random_outline(draw, axes, int(draw.integers(1, 25)), lengths=lengths)
    else:
        limits, outline = even_limits(axes), random_outline(draw, axes, int(draw.integers(5, 20)))
    try:
        return LimitsRun(find_worst_use(plan_run(outline, None, limits), limits, SAMPLES))
    except PathRefusal:
        return LimitsRun(None)


class TimeRun(NamedTuple):
    """The time of a path as a multiple of the least with velocity and acceleration alone, on the same curve; and of
    that with a stop at every corner."""

    of_least: float
    of_stopping: float


def run_time(seed: int) -> TimeRun:
    """Plan a random path of 2 to 4 axes and 5 to 50 pieces of 5 to 100 mm, tolerances of 50 um to 1 mm."""
    draw = np.random.default_rng(seed)
    axes = int(draw.integers(2, 5))
    outline, limits = random_outline(draw, axes, int(draw.integers(5, 51))), even_limits(axes)
    run = plan_run(outline, None, limits)
    stop_duration_s = plan_run(stop_everywhere(outline), None, limits).duration_s
    return TimeRun(run.duration_s / find_least_time(run.track, limits, GRID), run.duration_s / stop_duration_s)


def measure_planning(pieces: int, kinds: tuple[str, ...], rounds: int) -> float:
    """The processor time of planning over 8 axes, us a piece: the least of `rounds`. A spline of n points is one
    piece."""
    outline = random_outline(np.random.default_rng(1), 8, pieces, kinds)
    limits = even_limits(8)
    return 1e6 / pieces * _measure_least(lambda: plan_run(outline, None, limits), rounds)


class GcodeCost(NamedTuple):
    """us_line: processor time from a line of text to geometry; peak_mb: the largest memory of the program."""

    us_line: float
    peak_mb: float


def measure_gcode(lines: int, rounds: int = 2) -> GcodeCost:
    """The cost of a program of short lines and arcs, from text to geometry."""
    program = make_program(lines)
    axes = [PathAxis(f"cell.{letter}", Unit.MM, 200.0, 2000.0, 200_000.0) for letter in "xyz"]

    def read() -> None:
        steps = GcodeReader("part.ngc", {"X": "cell.x", "Y": "cell.y", "Z": "cell.z"}).read_steps(program)
        for step in steps:
            resolve_path(FollowPath.model_validate({**step, "tolerance": "100 um"}), axes)

    seconds = _measure_least(read, rounds)
    return GcodeCost(1e6 * seconds / lines, _find_peak_mb())


def _find_peak_mb() -> float:
    """The largest memory of this process; that of `getrusage` would include what its parent had."""
    match = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text(encoding="utf-8"))
    assert match is not None
    return int(match[1]) / 1000


def make_program(lines: int) -> list[str]:
    """Lines of a contour with an arc in every tenth of them."""
    program = ["G21 G90 G64 P0.05", "G1 F6000 X60 Y0 Z0"]
    for k in range(1, lines - 1):
        x, y, z = 60 * cos(k / 50), 60 * sin(k / 50), k / lines
        if k % 10:
            program.append(f"G1 X{x:.4f} Y{y:.4f} Z{z:.4f}")
        else:
            program.append(f"G3 X{x:.4f} Y{y:.4f} Z{z:.4f} R60.01")
    return program


def _measure_least(work: Callable[[], object], rounds: int) -> float:
    times_s: list[float] = []
    for _ in range(rounds):
        began_s = time.process_time()
        work()
        times_s.append(time.process_time() - began_s)
    return min(times_s)
