"""A run: a part of a path from rest to rest, planned as one. Per corner the faster of stop and blend is chosen."""

from dataclasses import dataclass

import numpy as np

from orchestrator.plan.path.arc_length import Array, Flags
from orchestrator.plan.path.check import LimitUse, measure_use
from orchestrator.plan.path.corners import fit_corners, make_track
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.grid import place_nodes
from orchestrator.plan.path.law import plan_law
from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.outline import SMOOTH, STOP, Outline
from orchestrator.plan.path.smooth import PathMotion
from orchestrator.plan.path.sweeps import find_range_minima
from orchestrator.plan.path.track import Frame, Track

MOST_STRETCH = 1.01
ATTEMPTS = 5
LONGEST_S = 50_000.0  # beyond, instants lose the digits in which limits are checked
LAST_STRETCH = 1.1  # a slower motion is of more use than a refusal
NEAR = 4.0  # segments of middle length about a node that is too fast
NEGLECTED = 1.002
MARGIN = 1.01


@dataclass(frozen=True, slots=True)
class Run:
    """A planned run: the track, the motion along it, and how much of the limits its segments use."""

    track: Track
    motion: PathMotion
    use: LimitUse

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.motion.duration_s

    @property
    def length(self) -> float:
        """The length of the track, in coordinates."""
        return self.track.end

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Positions of the axes and their derivatives by time, each (instants, axes)."""
        s, *motion = self.motion.evaluate(t)
        v, a, j = (part[:, None] for part in motion)
        section = self.motion.section[self.motion.find_segments(t)]
        q, q1, q2, q3 = self.track.evaluate(s, section=section)
        return q, q1 * v, q2 * v**2 + q1 * a, q3 * v**3 + 3 * q2 * v * a + q1 * j

    def find_positions(self, s: Array) -> Array:
        """The positions of the axes after lengths `s` of the way."""
        return self.track.evaluate(s).q


def plan_run(outline: Outline, frame: Frame | None, limits: PathLimits) -> Run:
    """Plan an outline from rest to rest.

    Corners with a tolerance are blended, and stopped at, in two plans; where the way from the middle of one span to
    that of the next is faster with a stop, the third plan stops. The fastest of the three is taken.
    """
    corners = fit_corners(outline, even=limits.third_order)
    rounded_track = make_track(outline, frame, corners)
    plans = [(rounded_track, plan_law(rounded_track, limits))]
    if rounded_track.blend.any():
        stopped_track = make_track(outline, frame, corners, np.ones(len(outline.kind), dtype=bool))
        plans.append((stopped_track, plan_law(stopped_track, limits)))
        stops = _choose_stops(outline, *plans)
        if stops.any():
            mixed_track = make_track(outline, frame, corners, stops)
            plans.append((mixed_track, plan_law(mixed_track, limits)))
    plans.sort(key=lambda plan: plan[1].duration_s)
    best = _hold_limits(*plans[0], limits)
    # The check may have stretched it behind the next one.
    for track, motion in plans[1:]:
        if motion.duration_s < best.duration_s:
            best = min(best, _hold_limits(track, motion, limits), key=lambda run: run.duration_s)
    return best


def _choose_stops(outline: Outline, rounded: tuple[Track, PathMotion], stopped: tuple[Track, PathMotion]) -> Flags:
    """The spans at whose ends a stop is faster than a blend."""
    instants = [motion.find_instants(find_middles(track, outline)) for track, motion in (rounded, stopped)]
    slower = np.append(np.diff(instants[0]) > np.diff(instants[1]), False)
    return (outline.tolerance > STOP) & (outline.tolerance < SMOOTH) & slower


def find_middles(track: Track, outline: Outline) -> Array:
    """The middle of each span of the outline, as a length of the track; where blends left nothing of it, their
    junction."""
    middles = np.zeros(len(outline.length))
    # A blend's source is the span before it: its start is that span's end.
    blends = np.flatnonzero(track.blend)
    middles[track.source[blends]] = track.start[blends]
    own = np.flatnonzero(~track.blend)
    source = track.source[own]
    middles[source] = track.start[own] + np.clip(outline.length[source] / 2 - track.low[own], 0.0, track.length[own])
    return middles


def _hold_limits(track: Track, motion: PathMotion, limits: PathLimits) -> Run:
    """Stretch what is over a limit. If that is more than a little, plan again, slower about those places.

    Raises `PathRefusal`.
    """
    if motion.duration_s > LONGEST_S:
        text = f"the path takes {motion.duration_s:.4g} s; at most {LONGEST_S:.0f} s can be planned"
        raise PathRefusal("plan", text, "raise its speed, or split it into several paths")
    slower = np.ones(0)
    use = measure_use(track, motion, limits)
    for attempt in range(ATTEMPTS):
        sections = np.zeros(int(motion.section[-1]) + 1)
        np.maximum.at(sections, motion.section, use.stretch)
        if sections.max() <= (MOST_STRETCH if attempt < ATTEMPTS - 1 else LAST_STRETCH):
            return Run(track, motion.stretch_sections(np.maximum(sections, 1.0)), use)
        if attempt < ATTEMPTS - 1:
            more = _find_slower(track, motion, use)
            slower = slower * more if len(slower) else more
            motion = plan_law(track, limits, slower)
            use = measure_use(track, motion, limits)
    k = int(use.stretch.argmax())
    piece = int(track.piece[track.find_spans(motion.s[k : k + 1])[0]]) + 1
    text = f"piece {piece}: no motion within the limits was found; the best one is {use.stretch[k]:.3f} times too fast"
    raise PathRefusal("over-limit", text, "choose lower speeds, or a larger tolerance, for this piece", piece)


def _find_slower(track: Track, motion: PathMotion, use: LimitUse) -> Array:
    """By how much to slow down at each node of the grid: as the worst segment near it needs, by time."""
    span, local = place_nodes(track)
    t = motion.find_instants(track.start[span] + local)
    reach = NEAR * float(np.median(motion.ends_s - motion.t))
    early = np.append(t[:1], t[:-1]) - reach
    late = np.append(t[1:], t[-1:]) + reach
    low, high = motion.find_segments(early), motion.find_segments(late)
    worst = -find_range_minima(-use.stretch, low, high)
    return np.where(worst > NEGLECTED, worst * MARGIN, 1.0)
