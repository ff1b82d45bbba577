"""Curves of a scan that flies: a spline in time through the bounds and the middle of all windows, each of one duration.

Its cubics have one jerk each, so that it is executed as it is planned, and position, velocity and acceleration are
continuous. Run-ups begin at rest where a smooth way leads to the state at the first window.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import sqrt

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.steps.fly import WindowPlace
from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.splines import find_top_speeds, reverse_motion
from orchestrator.plan.path_profiles import Array, FittedMotion
from orchestrator.plan.shape import WayEnd, WayLimits

LEAST_SPEED = 0.01  # of the mean: where axes are slower, no instant is known at which they pass a place
_PLACES: dict[WindowPlace, int] = {"start": 0, "middle": 1, "end": 2}


@dataclass(frozen=True, slots=True)
class CurvedLines(FlownLines):
    """Curves, all alike but for their direction. curve: the motion of the axes that fly through all windows of one that
    goes forward: two cubics for each window. limits: of these axes."""

    curve: FittedMotion
    limits: Sequence[WayLimits]

    @property
    def window_s(self) -> float:
        return self.curve.duration_s / self.count

    @property
    def slowest(self) -> float:
        speeds = np.linalg.norm(self.curve.velocities, axis=1)
        return float(max(speeds.min(), LEAST_SPEED * speeds.mean()))

    @property
    def lead(self) -> str:
        ways = np.abs(np.diff(self.curve.positions, axis=0)).sum(axis=0) * list(map(float, self.counts_per_unit))
        return self.scan.flown_axes[int(ways.argmax())]

    @property
    def turn_speeds(self) -> Sequence[float]:
        return [limits.velocity for limits in self.limits]

    @property
    def rooms(self) -> None:
        return None

    def find_begin(self, point: int) -> tuple[float, ...]:
        return self._find_rest(self.find_states(point, 0), -1.0)

    def find_end(self, point: int) -> tuple[float, ...]:
        return self._find_rest(self.find_states(point - point % self.count + self.count - 1, 1), 1.0)

    def _find_rest(self, states: Sequence[WayEnd], direction: float) -> tuple[float, ...]:
        """Where axes rest that are in a state, so long before, direction -1, or behind it, 1: at the end of a smooth
        way whose velocity is a cubic of time."""
        way_s = find_way_s(states, self.limits)
        return tuple(
            state.position + way_s * (direction * state.velocity / 2 + way_s * state.acceleration / 12)
            for state in states
        )

    def find_states(self, point: int, part: int) -> list[WayEnd]:
        motion, number = self._orient(point), 2 * (point % self.count + part)
        ends = motion.accelerations[-1] + motion.jerks[-1] * (motion.times_s[-1] - motion.times_s[-2])
        accelerations = ends if number == len(motion.jerks) else motion.accelerations[number]
        rows = (motion.positions[number], motion.velocities[number], accelerations)
        return [WayEnd(*row) for row in zip(*(row.tolist() for row in rows), strict=True)]

    def make_windows(self, point: int, count: int) -> FittedMotion:
        motion, first = self._orient(point), 2 * (point % self.count)
        nodes, pieces = slice(first, first + 2 * count + 1), slice(first, first + 2 * count)
        return FittedMotion(
            motion.times_s[nodes] - motion.times_s[first],
            motion.positions[nodes],
            motion.velocities[nodes],
            motion.accelerations[pieces],
            motion.jerks[pieces],
        )

    def list_top_speeds(self, point: int, count: int) -> Array:
        # Two cubics for each window.
        return find_top_speeds(self.make_windows(point, count)).reshape(count, 2, -1).max(axis=1)

    def _orient(self, point: int) -> FittedMotion:
        """The motion of the line of a point, in its direction."""
        return self.curve if self.is_forward(point) else reverse_motion(self.curve)

    def share_out(self, limits: Sequence[WayLimits]) -> Sequence[WayLimits]:
        return limits

    def list_positions(self, point: int, place: WindowPlace = "middle") -> list[Fraction]:
        column = self.scan.flown_axes.index(self.lead)
        positions = self._orient(point).positions[_PLACES[place] :: 2, column]
        return [Fraction(position) for position in positions[: self.count].tolist()]

    def make_path(self, point: int) -> FollowPath:
        text = f"a curve of {self.words} is planned when its turn comes"
        raise Refusal("fly-curve", text, "")

    def list_reach(self) -> Sequence[Sequence[float]]:
        # How far it goes between them is checked when it is planned.
        return list(zip(self.find_begin(0), self.find_end(0), strict=True))

    def describe(self) -> str:
        return f"{self.words} fly through {self.count} points on a curve, {self.window_s * 1e3:g} ms each"


def find_way_s(states: Sequence[WayEnd], limits: Sequence[WayLimits]) -> float:
    """How long a smooth way of all axes between rest and a state takes at most, s."""
    return max(
        1.5 * abs(state.velocity) / limit.acceleration
        + sqrt(6.0 * abs(state.velocity) / limit.jerk)
        + 2.0 * abs(state.acceleration) / limit.jerk
        for state, limit in zip(states, limits, strict=True)
    )
