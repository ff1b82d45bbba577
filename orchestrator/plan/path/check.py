"""The check of a time law: every axis's velocity, acceleration and jerk, sampled, against its limits.

Each segment of the motion is looked at at both of its ends and twice between them, and where spans join. What is over
is made good by stretching a section, from rest to rest, in time; a little only, for what lies between the nodes of the
grid.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.curves import QUICK, Derivatives
from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.smooth import PathMotion
from orchestrator.plan.path.track import Track

BLOCK = 2048  # segments looked at at a time
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


class LimitParts(NamedTuple):
    """Velocity and acceleration at points as parts of their limits: one row per axis, the last one of the path itself.
    bent, straight: of jerk, what curvature makes, and what each unit of jerk along the path adds."""

    velocity: Array
    acceleration: Array
    bent: Array
    straight: Array

    def find_jerk(self, j: Array) -> Array:
        """Jerk as a part of its limits, with `j` along the path."""
        return np.abs(self.bent + self.straight * j)

    def find_needed(self) -> Array:
        """What the time must be multiplied by at each point, so that velocity and acceleration hold."""
        return np.maximum(self.velocity.max(axis=0), np.sqrt(self.acceleration.max(axis=0)))


def find_needed_for_jerk(parts: Array) -> Array:
    """The same for jerk, from parts of its limits."""
    return np.cbrt(parts.max(axis=0))


def find_parts(at: Derivatives, motion: tuple[Array, Array], limits: PathLimits, most: Array) -> LimitParts:
    """Compare the motion of all axes with the limits. motion: speed and acceleration along the path. most: the highest
    speed of each point's piece."""
    v, a = motion
    first, second, third = (np.ascontiguousarray(part.T) for part in at[1:])
    axes, points = first.shape
    parts = LimitParts(*(np.zeros((axes + 1, points)) for _ in range(4)))
    parts.velocity[:axes] = np.abs(first * v) / limits.velocity[:, None]
    parts.acceleration[:axes] = np.abs(second * v**2 + first * a) / limits.acceleration[:, None]
    parts.bent[:axes] = (third * v**3 + second * (3 * v * a)) / limits.jerk[:, None]
    parts.straight[:axes] = first / limits.jerk[:, None]
    parts.velocity[axes], parts.acceleration[axes] = (
        v / np.minimum(most, limits.path_speed),
        np.abs(a) / limits.path_acceleration,
    )
    parts.straight[axes] = 1.0 / limits.path_jerk
    return parts


def _measure_junctions(track: Track, motion: PathMotion, limits: PathLimits, stretch: Array) -> None:
    """Raise `stretch` by what both sides of the junctions need at which the motion goes on: jerk jumps there."""
    spans = np.flatnonzero(~track.stop[:-1])
    t = motion.find_instants(track.start[spans + 1])
    segment = motion.find_segments(t)
    _, v, a, j = motion.evaluate(t)
    for span, local in ((spans, track.length[spans]), (spans + 1, np.zeros(len(spans)))):
        parts = find_parts(track.evaluate_spans(span, local, QUICK), (v, a), limits, track.speed[span])
        needed_stretch = np.maximum(parts.find_needed(), find_needed_for_jerk(parts.find_jerk(j)))
        np.maximum.at(stretch, segment, needed_stretch)


def _measure_block(
    track: Track, motion: PathMotion, limits: PathLimits, part: slice
) -> tuple[Array, Array, Index, Index]:
    begin = motion.t[part]
    end = motion.ends_s[part]
    j = motion.j[part]
    n = len(j)
    # Each end is the start of the next segment, with the jerk of this one; except at a rest, where a section ends.
    section_ends = np.flatnonzero(np.diff(motion.section[part], append=-1))
    number = np.arange(n)
    instants = np.concatenate([begin, *(begin + at * (end - begin) for at in INSIDE), end[section_ends]])
    segment = np.concatenate([number, number, number, section_ends]) + (part.start or 0)
    x = instants - motion.t[segment]
    a0, v0, j0 = motion.a[segment], motion.v[segment], motion.j[segment]
    s = motion.s[segment] + x * (v0 + x * (a0 / 2 + x * j0 / 6))
    v, a = v0 + x * (a0 + x * j0 / 2), a0 + x * j0
    span = track.find_spans_of(s, motion.section[segment])
    parts = find_parts(track.evaluate_spans(span, s - track.start[span], QUICK), (v, a), limits, track.speed[span])
    ends = number + 1
    ends[section_ends] = 3 * n + np.arange(len(section_ends))
    needed_stretch = parts.find_needed()
    jerk = parts.find_jerk(j0)[:, : 3 * n]
    jerk_at_ends = np.abs(parts.bent.take(ends, axis=1) + parts.straight.take(ends, axis=1) * j)
    by_motion = np.maximum(needed_stretch[: 3 * n].reshape(3, n).max(axis=0), needed_stretch[ends])
    by_jerk = np.maximum(find_needed_for_jerk(jerk).reshape(3, n).max(axis=0), find_needed_for_jerk(jerk_at_ends))
    interior = slice(2 * n, 3 * n)
    flat = np.concatenate([parts.velocity[:, interior], parts.acceleration[:, interior], jerk[:, interior]])
    most = flat.argmax(axis=0)
    width = len(parts.velocity)
    axis = most % width
    return np.maximum(by_motion, by_jerk), flat[most, number], most // width + 1, np.where(axis == width - 1, -1, axis)
