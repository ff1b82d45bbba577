"""A spline in time through the windows of a curve, and what its axes need for it."""

from collections.abc import Sequence

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.names import controller_of
from orchestrator.model.units import Unit
from orchestrator.plan.path_profiles import Array, FittedMotion
from orchestrator.plan.shape import WayLimits

EVEN = 1e-9  # of a limit: rounding
_ORDERS = ("velocity", "acceleration", "jerk")


def fit_curve(positions: Array, window_s: float) -> FittedMotion:
    """The spline in time through the bounds and middles of windows. positions: at the beginning of the first window, in
    its middle, at its end and so on, one column an axis; of two windows at least.

    Its third derivative is continuous at the last knots but one (*not a knot*), so that its ends do not flatten.
    """
    step_s = window_s / 2
    # At the knots inside, of a spline with even steps: m[k-1] + 4 m[k] + m[k+1] = 6 d[k] for its second derivative.
    differences = np.diff(positions, n=2, axis=0) / step_s**2
    second = np.zeros_like(positions)
    second[1], second[-2] = differences[0], differences[-1]
    right = 6 * differences[1:-1]
    right[0] -= second[1]
    right[-1] -= second[-2]
    diagonal = np.full(len(right), 4.0)
    for number in range(1, len(right)):
        factor = 1.0 / diagonal[number - 1]
        diagonal[number] -= factor
        right[number] -= factor * right[number - 1]
    second[-3] = right[-1] / diagonal[-1]
    for number in range(len(right) - 2, -1, -1):
        second[number + 2] = (right[number] - second[number + 3]) / diagonal[number]
    second[0], second[-1] = 2 * second[1] - second[2], 2 * second[-2] - second[-3]
    jerks = np.diff(second, axis=0) / step_s
    velocities = np.diff(positions, axis=0) / step_s - step_s * (2 * second[:-1] + second[1:]) / 6
    last = velocities[-1] + step_s * (second[-2] + second[-1]) / 2
    times_s = step_s * np.arange(len(positions), dtype=np.float64)
    return FittedMotion(times_s, positions, np.vstack([velocities, last]), second[:-1], jerks)


def reverse_motion(motion: FittedMotion) -> FittedMotion:
    """The same motion from its end to its beginning."""
    ends = motion.accelerations + motion.jerks * np.diff(motion.times_s)[:, None]
    return FittedMotion(
        motion.times_s[-1] - motion.times_s[::-1],
        motion.positions[::-1],
        -motion.velocities[::-1],
        ends[::-1],
        -motion.jerks[::-1],
    )


class _Excess:
    """The limit for which the windows of a curve have to be longer by most: its order of derivative from 1 on, the
    cubic, and the axis."""

    def __init__(self, curve: FittedMotion, limits: Sequence[WayLimits]) -> None:
        self._peaks = (find_top_speeds(curve), curve.peak_accelerations, np.abs(curve.jerks))
        self._limits = list(zip(*limits, strict=True))
        factors = [
            (peaks / limit) ** (1.0 / (order + 1))
            for order, (peaks, limit) in enumerate(zip(self._peaks, self._limits, strict=True))
        ]
        self._order = int(np.argmax([values.max() for values in factors]))
        self._piece, self._column = divmod(int(factors[self._order].argmax()), len(limits))
        self.factor = float(factors[self._order][self._piece, self._column])

    def make_refusal(self, names: Sequence[str], unit: Unit, window_s: float) -> Refusal:
        name, limit = names[self._column], self._limits[self._order][self._column]
        value = float(self._peaks[self._order][self._piece, self._column])
        per = f"{unit}/s" + ("", "²", "³")[self._order]
        text = (
            f"{name} would need {value:.4g} {per} of {_ORDERS[self._order]} in the window of point "
            f"{self._piece // 2 + 1} of the curve; its limit is {limit:g} {per}"
        )
        remedy = f"`duration: {window_s * self.factor * 1.0005e3:.4g} ms` or longer fits"
        return Refusal("fly-speed", text, f"{remedy}, or points that are closer together", controller_of(name))


def require_limits(curve: FittedMotion, names: Sequence[str], unit: Unit, limits: Sequence[WayLimits]) -> None:
    """Raise `Refusal` for a curve on which an axis exceeds a limit: the axis, the window, and the duration that
    fits."""
    excess = _Excess(curve, limits)
    if excess.factor > 1.0 + EVEN:
        raise excess.make_refusal(names, unit, 2 * float(curve.times_s[1]))


def find_longer(curve: FittedMotion, limits: Sequence[WayLimits]) -> float:
    """By how much longer the windows of a curve have to be for all limits; below 1: they may be shorter."""
    return _Excess(curve, limits).factor


def find_top_speeds(motion: FittedMotion) -> Array:
    """The highest speed of each axis in each cubic: at one of its ends, or where its acceleration is zero."""
    lengths = np.diff(motion.times_s)[:, None]
    v, a, j = motion.velocities[:-1], motion.accelerations, motion.jerks
    turns = np.divide(-a, j, out=np.zeros_like(j), where=j != 0.0).clip(0.0, lengths)
    ends = np.maximum(np.abs(v), np.abs(motion.velocities[1:]))
    return np.maximum(ends, np.abs(v + turns * (a + turns * j / 2)))
