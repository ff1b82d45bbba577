"""Motions as cubics of all axes: one after the other, elsewhere, at constant speed, and how far they reach."""

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from orchestrator.plan.path_profiles import Array, FittedMotion
from orchestrator.plan.shape import WayEnd


def join_motions(parts: Sequence[FittedMotion]) -> FittedMotion:
    """One motion after the other. Each begins in the state in which the one before it ends."""
    ends_s = list(accumulate((float(part.times_s[-1]) for part in parts), initial=0.0))
    return FittedMotion(
        times_s=np.concatenate(
            [part.times_s[:-1] + begin_s for part, begin_s in zip(parts, ends_s, strict=False)] + [[ends_s[-1]]]
        ),
        positions=np.concatenate([part.positions[:-1] for part in parts] + [parts[-1].positions[-1:]]),
        velocities=np.concatenate([part.velocities[:-1] for part in parts] + [parts[-1].velocities[-1:]]),
        accelerations=np.concatenate([part.accelerations for part in parts]),
        jerks=np.concatenate([part.jerks for part in parts]),
    )


def move_motion(motion: FittedMotion, shift: Array) -> FittedMotion:
    """The same motion elsewhere: `shift` is added to the positions of the axes."""
    return motion._replace(positions=motion.positions + shift)


def glide(begin: Sequence[WayEnd], duration_s: float) -> FittedMotion:
    """Every axis at the velocity that it has, for so long."""
    positions = np.array([state.position for state in begin])
    velocities = np.array([state.velocity for state in begin])
    zeros = np.zeros((1, len(begin)))
    return FittedMotion(
        np.array([0.0, duration_s]),
        np.array([positions, positions + velocities * duration_s]),
        np.array([velocities, velocities]),
        zeros,
        zeros,
    )


def find_extremes(motion: FittedMotion) -> tuple[Array, Array]:
    """The least and the greatest position of each axis in a motion, exact: at the ends of pieces, and where an axis
    turns in one."""
    lengths = np.diff(motion.times_s)[:, None]
    v, a, j = motion.velocities[:-1], motion.accelerations, motion.jerks
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(a * a - 2 * j * v)
        turns = [np.where(j != 0.0, (-a + sign * root) / j, -v / a) for sign in (1.0, -1.0)]
    places = [motion.positions]
    for turn in turns:
        x = np.where(np.isfinite(turn), np.clip(turn, 0.0, lengths), 0.0)
        places.append(motion.positions[:-1] + x * (v + x * (a / 2 + x * j / 6)))
    every = np.concatenate(places)
    return every.min(axis=0), every.max(axis=0)
