"""A path in time as one profile of constant jerk per axis, for the makes that execute any profile.

On a grid of instants that all axes share, each axis gets the cubic with the path's position and velocity at both ends:
position and velocity are continuous, and the jerk of a piece is a weighted mean of the path's jerk over it (weight
6u(1-u)), so that it never exceeds it. Where the profiles are farther from the path than allowed, the grid is halved.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.model.profile import Profile
from orchestrator.plan.shape import PlanError

Array = NDArray[np.float64]

FIT_SHARE = 0.05  # of the tolerance: how far the profiles may be from the path
LEAST_FIT_COUNTS = 0.05  # or this: a member's own count is coarser
LONGEST_PIECE_S, SHORTEST_PIECE_S = 0.08, 0.5e-3
INSIDE = np.arange(1, 8) / 8.0  # where a piece is compared with the path
MAX_STRETCH = 1.01  # by which a plan may become longer to keep the limits to the last digit
MAX_PIECES = 60_000  # of one axis: its profile must fit into a message several times


class PathStates(NamedTuple):
    """The path at instants: one row each, one column per axis. Units of the axes, per s, per s²."""

    positions: Array
    velocities: Array
    accelerations: Array


Evaluate = Callable[[Array], PathStates]


class FittedAxis(NamedTuple):
    """An axis of a path.

    counts_per_unit: signed. velocity, acceleration, jerk: its limits, units/s, units/s², units/s³. start_counts: where
    it stands, end_counts: its exact target.
    """

    name: str
    counts_per_unit: float
    velocity: float
    acceleration: float
    start_counts: int
    end_counts: int
    jerk: float = inf


class FittedMotion(NamedTuple):
    """The motion of all profiles of a path: cubics between instants `times_s`. positions, velocities: at these;
    accelerations, jerks: of each piece, at its start. One column per axis, in its unit, per second (², ³)."""

    times_s: Array
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array

    @property
    def duration_s(self) -> float:
        """Of the whole motion."""
        return float(self.times_s[-1])

    def evaluate(self, times_s: Array) -> tuple[Array, Array, Array, Array]:
        """Positions, velocities, accelerations and jerks at instants: (instants, axes); at rest from the end on."""
        k = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, len(self.jerks) - 1)
        x = np.minimum(times_s - self.times_s[k], np.diff(self.times_s)[k])[:, None]
        v, a, j = self.velocities[k], self.accelerations[k], self.jerks[k]
        is_moving = (times_s < self.times_s[-1])[:, None]
        return (
            self.positions[k] + x * (v + x * (a / 2 + x * j / 6)),
            (v + x * (a + x * j / 2)) * is_moving,
            (a + x * j) * is_moving,
            j * is_moving,
        )

    @property
    def peak_accelerations(self) -> Array:
        """The largest acceleration of each axis in each cubic, without its sign: at one of its ends."""
        ends = self.accelerations + self.jerks * np.diff(self.times_s)[:, None]
        return np.maximum(np.abs(self.accelerations), np.abs(ends))

    def stretch_time(self, factor: float) -> "FittedMotion":
        """The same motion in `factor` times the time."""
        times_s, v, a, j = self.times_s * factor, self.velocities / factor, self.accelerations, self.jerks
        return FittedMotion(times_s, self.positions, v, a / factor**2, j / factor**3)


@dataclass(frozen=True, slots=True)
class FittedPath:
    """Profiles of a path. duration_s: of all of them. standing: axes that the path does not move. error: the largest
    sampled distance between profiles and path at one instant, in the unit of the axes. motion: of all axes."""

    duration_s: float
    profiles: Mapping[str, Profile]
    standing: Sequence[str]
    error: float
    motion: FittedMotion


def fit_profiles(evaluate: Evaluate, duration_s: float, axes: Sequence[FittedAxis], tolerance: float) -> FittedPath:
    """Make the profiles of a path. tolerance: of the path, in the unit of the axes. Raises `PlanError`."""
    pieces = _refine_grid(evaluate, duration_s, axes, find_fit_error(axes, tolerance))
    stretch = _find_stretch(pieces, axes)
    profiles: dict[str, Profile] = {}
    standing: list[str] = []
    for column, axis in enumerate(axes):
        profile = make_profile(pieces.motion, column, axis)
        if profile.is_still:
            standing.append(axis.name)
        else:
            profiles[axis.name] = profile if stretch == 1.0 else profile.stretch_time(stretch)
    offsets = [axis.start_counts / axis.counts_per_unit for axis in axes] - pieces.positions[0]
    ends = [axis.end_counts / axis.counts_per_unit for axis in axes] - pieces.positions[-1]
    # The profiles begin and end at whole counts, which the path may be off by half a count.
    rounding = max(float(np.linalg.norm(offsets)), float(np.linalg.norm(ends)))
    error = float(pieces.errors.max(initial=0.0)) + rounding
    return FittedPath(duration_s * stretch, profiles, standing, error, pieces.motion.stretch_time(stretch))


def find_fit_error(axes: Sequence[FittedAxis], tolerance: float) -> float:
    """How far profiles may be from a path with this tolerance."""
    finest = LEAST_FIT_COUNTS / max(abs(axis.counts_per_unit) for axis in axes)
    return max(FIT_SHARE * tolerance, finest)


def fit_stretch(evaluate: Evaluate, duration_s: float, axes: Sequence[FittedAxis], allowed: float) -> FittedMotion:
    """The cubics of a stretch of a path from 0 to `duration_s`; it need not begin or end at rest. Raises
    `PlanError`."""
    return _refine_grid(evaluate, duration_s, axes, allowed).motion


class _Pieces(NamedTuple):
    """The cubics between instants `times_s`. positions, velocities: at these; accelerations, jerks: of each piece, at
    its start. errors: the largest distance from the path in each. speeds, peaks: the largest velocity and acceleration
    in each, by axis."""

    times_s: Array
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    errors: Array
    speeds: Array
    peaks: Array

    @property
    def motion(self) -> FittedMotion:
        """The cubics alone."""
        return FittedMotion(self.times_s, self.positions, self.velocities, self.accelerations, self.jerks)


def _refine_grid(evaluate: Evaluate, duration_s: float, axes: Sequence[FittedAxis], allowed: float) -> _Pieces:
    """The pieces on the coarsest grid, of halves of equal parts, on which each is near enough to the path."""
    limits = np.array([axis.acceleration for axis in axes])
    times_s = np.linspace(0.0, duration_s, max(2, int(np.ceil(duration_s / LONGEST_PIECE_S))) + 1)
    while True:
        pieces = _make_pieces(evaluate, times_s)
        # The acceleration of a cubic may exceed the path's; a finer grid follows that.
        poor = (pieces.errors > allowed) | (pieces.peaks > limits * MAX_STRETCH).any(axis=1)
        poor &= np.diff(times_s) > 2 * SHORTEST_PIECE_S
        if not poor.any():
            break
        middles = (times_s[:-1] + times_s[1:])[poor] / 2
        times_s = np.sort(np.concatenate([times_s, middles]))
        if len(times_s) > MAX_PIECES:
            raise PlanError(
                f"the path of {duration_s:.0f} s needs more than {MAX_PIECES} pieces for its tolerance; split it"
            )
    return pieces


def _make_pieces(evaluate: Evaluate, times_s: Array) -> _Pieces:
    positions, velocities, _ = evaluate(times_s)
    lengths = np.diff(times_s)[:, None]
    slopes = np.diff(positions, axis=0) / lengths
    velocities_before, velocities_after = velocities[:-1], velocities[1:]
    accelerations = (6 * slopes - 4 * velocities_before - 2 * velocities_after) / lengths
    jerks = (6 * (velocities_before + velocities_after) - 12 * slopes) / lengths**2
    peaks = np.maximum(np.abs(accelerations), np.abs(accelerations + jerks * lengths))
    # The velocity is largest at an end, or where the acceleration is zero.
    turn = np.divide(-accelerations, jerks, out=np.zeros_like(jerks), where=jerks != 0.0).clip(0.0, lengths)
    tops = np.abs(velocities_before + turn * (accelerations + turn * jerks / 2))
    speeds = np.maximum(np.maximum(np.abs(velocities_before), np.abs(velocities_after)), tops)
    length_inside = INSIDE[None, :, None] * lengths[:, :, None]
    position = positions[:-1, None] + length_inside * (
        velocities_before[:, None] + length_inside * (accelerations[:, None] / 2 + length_inside * jerks[:, None] / 6)
    )
    true = evaluate((times_s[:-1, None] + length_inside[:, :, 0]).ravel()).positions.reshape(position.shape)
    errors = np.sqrt(((position - true) ** 2).sum(axis=2)).max(axis=1)
    return _Pieces(
        times_s=times_s,
        positions=positions,
        velocities=velocities,
        accelerations=accelerations,
        jerks=jerks,
        errors=errors,
        speeds=speeds,
        peaks=peaks,
    )


def _find_stretch(pieces: _Pieces, axes: Sequence[FittedAxis]) -> float:
    """By how much longer the path must last for all limits to hold exactly. Raises `PlanError` if that is too much."""
    fastest = pieces.speeds.max(axis=0) / [axis.velocity for axis in axes]
    steepest = np.sqrt(pieces.peaks.max(axis=0) / [axis.acceleration for axis in axes])
    over = np.maximum(fastest, steepest)
    worst = int(over.argmax())
    if over[worst] > MAX_STRETCH:
        raise PlanError(
            f"{axes[worst].name}: the path exceeds its limits by {100 * (over[worst] - 1):.1f} % of its speed"
        )
    return max(1.0, float(over[worst]))


def make_profile(motion: FittedMotion, column: int, axis: FittedAxis) -> Profile:
    """The profile of one axis of a motion from rest to rest."""
    return Profile(
        start_counts=axis.start_counts,
        end_counts=axis.end_counts,
        scale_counts=axis.counts_per_unit,
        durations_s=np.diff(motion.times_s).tolist(),
        accelerations=motion.accelerations[:, column].tolist(),
        jerks=motion.jerks[:, column].tolist(),
    )
