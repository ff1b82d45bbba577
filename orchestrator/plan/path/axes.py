"""Axes that go along a path: units, limits, and soft limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.model.units import Unit
from orchestrator.plan.path.limits import PathLimits


@dataclass(frozen=True, slots=True)
class PathAxis:
    """An axis of a path; all values in its unit, per second (², ³). jerk: None where its controller executes second
    order only. soft_limits: (low, high), ends included, or None."""

    axis: str
    unit: Unit
    velocity: float
    acceleration: float
    jerk: float | None = None
    soft_limits: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class AlongLimits:
    """Limits along the path, in the unit of its coordinates per second (², ³); None: no such limit."""

    speed: float | None = None
    acceleration: float | None = None
    jerk: float | None = None


def collect_limits(axes: Sequence[PathAxis], along: AlongLimits) -> PathLimits:
    """The limits of axes and path as the planner takes them."""
    return PathLimits(
        np.array([axis.velocity for axis in axes], dtype=np.float64),
        np.array([axis.acceleration for axis in axes], dtype=np.float64),
        np.array([np.inf if axis.jerk is None else axis.jerk for axis in axes], dtype=np.float64),
        *(np.inf if limit is None else limit for limit in (along.speed, along.acceleration, along.jerk)),
    )
