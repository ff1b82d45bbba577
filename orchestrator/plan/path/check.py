"""The check of a time law: every axis's velocity, acceleration and jerk, sampled, against its limits.

Each segment of the motion is looked at at both of its ends and twice between them, and where spans join. What is over
is made good by stretching a section, from rest to rest, in time; a little only, for what lies between the nodes of the
grid.
"""

from dataclasses import dataclass

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.curves import QUICK, Derivatives
from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.smooth import PathMotion
from orchestrator.plan.path.track import Track

BLOCK = 1024  # segments looked at at a time
INSIDE = (1 / 3, 2 / 3)


@dataclass(frozen=True, slots=True)
class LimitUse:
    """How much of the limits each segment uses. stretch: what its time must be multiplied by at least (below 1: room).
    used, order, axis: the most used limit inside it, as a part of it, with its order (1 velocity, 2 acceleration, 3
    jerk) and axis (-1: of the path)."""

    stretch: Array
    used: Array
    order: Index
    axis: Index


def measure_use(track: Track, motion: PathMotion, limits: PathLimits) -> LimitUse:
    """Compare a motion with all limits."""
    parts = [_measure_block(track, motion, limits, slice(k, k + BLOCK)) for k in range(0, len(motion.t), BLOCK)]
    use = LimitUse(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    _measure_junctions(track, motion, limits, use.stretch)
    return use


def _measure_junctions(track: Track, motion: PathMotion, limits: PathLimits, stretch: Array) -> None:
    """Raise `stretch` by what both sides of the junctions need at which the motion goes on: jerk jumps there."""
    before = np.flatnonzero(~track.stop[:-1])
    t = motion.find_instants(track.start[before + 1])
    segment = motion.find_segments(t)
    _, v, a, j = motion.evaluate(t)
    for span, local in ((before, track.length[before]), (before + 1, np.zeros(len(before)))):
        needed = find_needed(find_uses(track.evaluate_spans(span, local, QUICK), (v, a, j), limits))
        np.maximum.at(stretch, segment, needed)


def _measure_block(
    track: Track, motion: PathMotion, limits: PathLimits, part: slice
) -> tuple[Array, Array, Index, Index]:
    begin = motion.t[part]
    end = motion.ends_s[part]
    j = motion.j[part]
    n = len(j)
    # Each end is the start of the next segment, with the jerk of this one; except at a rest, where a section ends.
    rest = np.flatnonzero(np.diff(motion.section[part], append=-1))
    number = np.arange(n)
    instants = np.concatenate([begin, *(begin + at * (end - begin) for at in INSIDE), end[rest]])
    segment = np.concatenate([number, number, number, rest]) + (part.start or 0)
    x = instants - motion.t[segment]
    a0, v0, j0 = motion.a[segment], motion.v[segment], motion.j[segment]
    s = motion.s[segment] + x * (v0 + x * (a0 / 2 + x * j0 / 6))
    v, a = v0 + x * (a0 + x * j0 / 2), a0 + x * j0
    at = track.evaluate(s, QUICK, motion.section[segment])
    worst = np.zeros(n)
    uses = (np.zeros((0, 0)),) * 3
    ends = number + 1
    ends[rest] = 3 * n + np.arange(len(rest))
    for points in (number, ends, number + n, number + 2 * n):
        uses = find_uses(Derivatives(*(each[points] for each in at)), (v[points], a[points], j), limits)
        worst = np.maximum(worst, find_needed(uses))
    flat = np.concatenate(uses, axis=1)
    most = flat.argmax(axis=1)
    width = uses[0].shape[1]
    axis = most % width
    return worst, flat[np.arange(n), most], most // width + 1, np.where(axis == width - 1, -1, axis)


def find_uses(at: Derivatives, motion: tuple[Array, Array, Array], limits: PathLimits) -> tuple[Array, Array, Array]:
    """Velocity, acceleration and jerk as parts of their limits: one row per point, one column per axis and one for the
    path. motion: speed, acceleration and jerk along the path."""
    v, a, j = (part[:, None] for part in motion)
    velocity = np.abs(at.first * v) / limits.velocity
    acceleration = np.abs(at.second * v**2 + at.first * a) / limits.acceleration
    jerk = np.abs(at.third * v**3 + 3 * at.second * v * a + at.first * j) / limits.jerk
    along = (v / limits.path_speed, np.abs(a) / limits.path_acceleration, np.abs(j) / limits.path_jerk)
    axes = (velocity, acceleration, jerk)
    found = [np.concatenate(pair, axis=1) for pair in zip(axes, along, strict=True)]
    return found[0], found[1], found[2]


def find_needed(uses: tuple[Array, Array, Array]) -> Array:
    """What the time must be multiplied by at each point, so that no limit is exceeded."""
    velocity, acceleration, jerk = (use.max(axis=1, initial=0.0) for use in uses)
    return np.maximum(velocity, np.maximum(np.sqrt(acceleration), np.cbrt(jerk)))
