"""Limits of the axes and of the path, and the caps that follow from them at a point of the path.

With derivatives by arc length, speed v and tangential acceleration a and jerk j, an axis has velocity q' v,
acceleration q'' v² + q' a, and jerk q''' v³ + 3 q'' v a + q' j (e.g. Constantinescu and Croft, "Smooth and time-optimal
trajectory planning for industrial manipulators along specified paths", 2000).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orchestrator.plan.path.arc_length import Array
from orchestrator.plan.path.curves import Derivatives

# What curvature may take of an axis's acceleration and jerk; the rest is for changing speed.
ACCELERATION_SHARE = 0.85
JERK_SHARE = 0.65


@dataclass(frozen=True, slots=True)
class PathLimits:
    """Limits in the axes' units: per axis (arrays) velocity, acceleration, jerk (inf: none), and along the path (inf:
    none) speed, acceleration and jerk in units of length."""

    velocity: Array
    acceleration: Array
    jerk: Array
    path_speed: float = np.inf
    path_acceleration: float = np.inf
    path_jerk: float = np.inf

    @property
    def third_order(self) -> bool:
        """Whether anything limits jerk."""
        return bool(np.isfinite(self.jerk).any() or np.isfinite(self.path_jerk))


class Slopes(NamedTuple):
    """Absolute values of the derivatives of all axes: one row per axis, one column per point. So the least of all axes
    is found many times faster than from rows of points."""

    first: Array
    second: Array
    third: Array


def find_slopes(at: Derivatives) -> Slopes:
    """The absolute derivatives at points."""
    return Slopes(*(np.abs(np.ascontiguousarray(part.T)) for part in at[1:]))


def find_speed_caps(limits: PathLimits, at: Slopes) -> Array:
    """The highest speed at each point that leaves something of acceleration and jerk."""
    with np.errstate(divide="ignore"):
        by_velocity = (limits.velocity[:, None] / at.first).min(axis=0)
        by_acceleration = np.sqrt(ACCELERATION_SHARE * (limits.acceleration[:, None] / at.second).min(axis=0))
        by_jerk = np.cbrt(JERK_SHARE * (limits.jerk[:, None] / at.third).min(axis=0))
    return np.minimum(np.minimum(np.minimum(by_velocity, by_acceleration), by_jerk), limits.path_speed)


def find_accelerations(limits: PathLimits, at: Slopes, speed: Array, smoothing_s: Array) -> Array:
    """The tangential acceleration that axes have left at `speed`.

    Jerk is at most the acceleration divided by `smoothing_s`: |q'''|v³ + (3|q''|v + |q'|/T) a <= J.
    """
    first, second, third = at
    with np.errstate(divide="ignore", invalid="ignore"):
        acceleration_left = np.maximum(limits.acceleration[:, None] - second * speed**2, 0.0) / first
        rate = 1.0 / smoothing_s
        jerk_left = np.maximum(limits.jerk[:, None] - third * speed**3, 0.0) / (second * (3 * speed) + first * rate)
    # 0/0 and inf/inf are axes that stand, or have no limit: the least of the others counts.
    least = np.fmin(np.fmin.reduce(acceleration_left, axis=0), np.fmin.reduce(jerk_left, axis=0))
    # Without smoothing jerk is not limited.
    along = np.where(
        smoothing_s > 0.0,
        np.minimum(limits.path_acceleration, limits.path_jerk * np.maximum(smoothing_s, 1e-12)),
        limits.path_acceleration,
    )
    return np.fmin(least, along)
