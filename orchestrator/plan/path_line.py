"""One line of a path, from rest to rest on a trapezoid, for members that move from rest to rest only."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from orchestrator.model.profile import Profile
from orchestrator.plan.path.axes import AlongLimits
from orchestrator.plan.path_profiles import Array, FittedAxis
from orchestrator.plan.step import AxisMove, plan_step


class FittedLine(NamedTuple):
    """Profiles of a line. duration_s: of all of them. standing: axes that it does not move. error: as of a path."""

    duration_s: float
    profiles: Mapping[str, Profile]
    standing: Sequence[str]
    error: float


def fit_line(axes: Sequence[FittedAxis], length: float, along: AlongLimits) -> FittedLine:
    """The profiles of a straight line: one trapezoid that all axes share, each scaled by its distance. length: of the
    line; along: limits along it. Raises `PlanError`."""
    moves: list[AxisMove] = []
    for axis in axes:
        scale = abs(axis.counts_per_unit)
        # What the axis does at the limits along the line.
        part = abs(axis.end_counts - axis.start_counts) / scale / length
        velocity, acceleration = (
            limit if path is None or part == 0.0 else min(limit, path * part)
            for limit, path in ((axis.velocity, along.speed), (axis.acceleration, along.acceleration))
        )
        counts = axis.start_counts, axis.end_counts
        moves.append(AxisMove(axis.name, *counts, velocity * scale, acceleration * scale))
    plan = plan_step(moves, "phase")
    # A line begins and ends half a count beside the path at most, on every axis.
    rounding_error = float(np.linalg.norm([0.5 / axis.counts_per_unit for axis in axes]))
    return FittedLine(plan.duration_s, plan.profiles, plan.unmoved, rounding_error)


def sample_speeds(fitted: FittedLine, axes: Sequence[FittedAxis], times_s: Array) -> Array:
    """The speeds of axes at instants, (axes, instants), in their units per s."""
    rows = np.zeros((len(axes), len(times_s)))
    for row, axis in zip(rows, axes, strict=True):
        profile = fitted.profiles.get(axis.name)
        if profile is not None:
            at = profile.make_evaluator()
            row[:] = [abs(at(t).velocity / axis.counts_per_unit) for t in times_s.tolist()]
    return rows
