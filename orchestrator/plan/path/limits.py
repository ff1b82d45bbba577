"""Limits of the axes and of the path, and the caps that follow from them at a point of the path.

With derivatives by arc length, speed v and tangential acceleration a and jerk j, an axis has velocity q' v,
acceleration q'' v² + q' a, and jerk q''' v³ + 3 q'' v a + q' j (e.g. Constantinescu and Croft, "Smooth and time-optimal
trajectory planning for industrial manipulators along specified paths", 2000).
"""

from dataclasses import dataclass

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


def find_speed_caps(limits: PathLimits, at: Derivatives) -> Array:
    """The highest speed at each point that leaves something of acceleration and jerk."""
    with np.errstate(divide="ignore"):
        by_velocity = limits.velocity / np.abs(at.first)
        by_acceleration = np.sqrt(ACCELERATION_SHARE * limits.acceleration / np.abs(at.second))
        by_jerk = np.cbrt(JERK_SHARE * limits.jerk / np.abs(at.third))
    caps = np.minimum(np.minimum(by_velocity, by_acceleration), by_jerk).min(axis=1)
    return np.minimum(caps, limits.path_speed)


def find_accelerations(limits: PathLimits, at: Derivatives, speed: Array, smoothing_s: Array) -> Array:
    """The tangential acceleration that axes have left at `speed`.

    Jerk is at most the acceleration divided by `smoothing_s`: |q'''|v³ + (3|q''|v + |q'|/T) a <= J.
    """
    v = speed[:, None]
    first, second, third = np.abs(at.first), np.abs(at.second), np.abs(at.third)
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.maximum(limits.acceleration - second * v**2, 0.0) / first
        rate = 1.0 / smoothing_s[:, None]
        jerk_left = np.maximum(limits.jerk - third * v**3, 0.0) / (3 * second * v + first * rate)
    # 0/0 and inf/inf are axes that stand, or have no limit.
    left = np.minimum(
        np.nan_to_num(left, nan=np.inf, posinf=np.inf), np.nan_to_num(jerk_left, nan=np.inf, posinf=np.inf)
    )
    # Without smoothing jerk is not limited.
    along = np.where(
        smoothing_s > 0.0,
        np.minimum(limits.path_acceleration, limits.path_jerk * np.maximum(smoothing_s, 1e-12)),
        limits.path_acceleration,
    )
    return np.minimum(left.min(axis=1), along)
