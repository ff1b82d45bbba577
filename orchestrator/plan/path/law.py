"""The time law: how fast a track is gone along, on the limits of velocity, acceleration and jerk of all axes.

Caps of speed on a grid; accelerations left at those speeds; sweeps forward and backward with both spread over the
smoothing time; plateaus on peaks; smoothing. Explained in docs/explanation/path-time-law.md.
"""

from dataclasses import replace

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.coarse import (
    Ladder,
    cap_pieces,
    flatten_peaks,
    insert_peaks,
    integrate_ladder,
    widen_valleys,
)
from orchestrator.plan.path.grid import Grid, make_grid, place_nodes, refine_grid
from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.smooth import PathMotion, smooth_motion
from orchestrator.plan.path.sweeps import spread_cells, sweep_squares
from orchestrator.plan.path.track import Track

ROUNDS = 5
# Pieces that take fewer smoothing times than this are tried with shorter ones: there they cost more than they give.
FEW = 6.0
LEAST_SMOOTHING_S = 1e-8
SHORTER = (0.5, 0.25, 0.125)


def plan_law(track: Track, limits: PathLimits, slower: Array | None = None) -> PathMotion:
    """Plan the motion along a track from rest to rest. slower: for each node of `place_nodes`, by how much its speeds
    are to be lower than the limits allow."""
    base = make_grid(track, limits, *place_nodes(track))
    if slower is not None:
        base = replace(base, speed=base.speed / slower, slower=slower)
    smoothing_s = choose_smoothing(base, limits)
    motion = plan_with_smoothing(track, limits, base, smoothing_s)
    best, times = smoothing_s, _measure_sections(motion, smoothing_s)
    piece = track.piece[base.span]
    pieces = np.bincount(base.section[np.flatnonzero(np.diff(piece, prepend=-1))], minlength=len(times))
    short = (FEW * smoothing_s > times / np.maximum(pieces, 1)) & (np.bincount(base.section) > 2)
    if not short.any():
        return motion
    for part in SHORTER:
        trial_s = np.where(short, smoothing_s * part, smoothing_s)
        better = _measure_sections(plan_with_smoothing(track, limits, base, trial_s), trial_s)
        best, times = np.where(better < times, trial_s, best), np.minimum(times, better)
    return motion if (best == smoothing_s).all() else plan_with_smoothing(track, limits, base, best)


def _measure_sections(motion: PathMotion, smoothing_s: Array) -> Array:
    """The time of each section; longer if its jerk is more than its largest acceleration in its smoothing time."""
    begin = np.flatnonzero(np.diff(motion.section, prepend=-1))
    times = np.add.reduceat(motion.ends_s - motion.t, begin)
    most = np.maximum.reduceat(np.abs(motion.a), begin)
    jerk = np.maximum.reduceat(np.abs(motion.j), begin) * smoothing_s
    return times * np.cbrt(np.maximum(1.0, jerk / np.maximum(most, 1e-300)))


def choose_smoothing(grid: Grid, limits: PathLimits) -> Array:
    """The smoothing time of each section: the largest acceleration divided by jerk, less on a short line."""
    first = grid.at.first
    with np.errstate(divide="ignore", invalid="ignore"):
        acceleration = np.fmin.reduce(limits.acceleration[:, None] / first, axis=0)
        acceleration = np.minimum(acceleration, limits.path_acceleration)
        jerk = np.minimum(np.fmin.reduce(limits.jerk[:, None] / first, axis=0), limits.path_jerk)
        ratio = acceleration / jerk
    begin = np.flatnonzero(np.diff(grid.section, prepend=-1))
    smoothing_s = np.maximum.reduceat(ratio, begin)
    end = np.append(begin[1:], len(grid.s)) - 1
    # From rest to rest over L with jerk alone: four ramps of (L / 2J)^(1/3).
    single = end - begin == 1
    length = grid.s[end] - grid.s[begin]
    smoothing_s = np.where(single, np.minimum(smoothing_s, np.cbrt(length / (2 * jerk[begin]))), smoothing_s)
    # An axis that moves by rounding alone limits nothing: no instant of a path is known as well as that.
    return np.where(smoothing_s < LEAST_SMOOTHING_S, 0.0, smoothing_s)


def plan_with_smoothing(track: Track, limits: PathLimits, base: Grid, smoothing_s: Array) -> PathMotion:
    """Plan with a smoothing time for each section."""
    grid = _add_nodes(base, track, limits, smoothing_s[base.section])
    width = smoothing_s[grid.section]
    h = np.diff(grid.s)
    same_section = np.diff(grid.section) == 0
    squares = np.where(grid.rest, 0.0, grid.speed**2)

    def sweep(speeds: Array, reach_s: Array | None) -> tuple[Array, Array]:
        nodes = grid.find_accelerations(limits, speeds, width)
        cells = np.minimum(nodes[:-1], nodes[1:])
        if reach_s is not None:
            cells = spread_cells(cells, reach_s, np.minimum(width[:-1], width[1:]))
        cells = np.where(np.isfinite(cells), cells, 0.0)
        return sweep_squares(squares, cells, h), cells

    # What is left at a higher speed is less: so a law from speeds that are never exceeded holds, and the law from
    # one that holds is never exceeded.
    slow, _ = sweep(grid.speed, None)
    fast, _ = sweep(np.sqrt(slow), None)
    with np.errstate(divide="ignore"):
        dt = np.where(h > 0, 2 * h / np.maximum(np.sqrt(fast[:-1]) + np.sqrt(fast[1:]), 1e-12), 0.0)
    times = np.concatenate(
        [[0.0], np.cumsum(np.where(same_section, np.minimum(dt, 1e3), 2 * width[:-1] + 2 * width[1:]))]
    )
    _, cells = sweep(np.sqrt(fast), times)
    ladder = Ladder(
        s=grid.s,
        caps=squares,
        acceleration=cells,
        cell_caps=_find_cell_caps(grid) ** 2,
        smoothing_s=width,
        section=grid.section,
    )
    ladder = cap_pieces(ladder, *_find_capped(track, smoothing_s))
    for _ in range(ROUNDS):  # what one changes on a flank the other one has to look at again
        wide = widen_valleys(ladder, ladder.sweep())
        flat = flatten_peaks(wide, wide.sweep())
        if flat is ladder:
            break
        ladder = flat
    return smooth_motion(*integrate_ladder(ladder, *insert_peaks(ladder, ladder.sweep())))


def _find_capped(track: Track, smoothing_s: Array) -> tuple[Array, Array, Array]:
    """(begin, end, squared speed) of spans with a highest speed, wider by half of the smoothing time at that speed: so
    that the smoothed motion has it on the whole span."""
    capped_spans = np.flatnonzero(np.isfinite(track.speed))
    stops = np.flatnonzero(track.stop)
    section = np.searchsorted(stops, capped_spans)
    ends, begins = track.start[stops + 1], np.concatenate([[0.0], track.start[stops[:-1] + 1]])
    wide = track.speed[capped_spans] * smoothing_s[section] / 2
    low = np.maximum(track.start[capped_spans] - wide, begins[section])
    high = np.minimum(track.start[capped_spans + 1] + wide, ends[section])
    return low, high, track.speed[capped_spans] ** 2


def _add_nodes(grid: Grid, track: Track, limits: PathLimits, width: Array) -> Grid:
    """Nodes at which caps and accelerations change that are spread from a junction into a line, an arc or a spline."""
    ends = np.flatnonzero(np.diff(grid.span, append=-1))
    begins = np.concatenate([[0], ends[:-1] + 1])
    spans = np.flatnonzero(~track.blend)
    parts: list[tuple[Index, Array]] = []
    speed = grid.speed
    joint = np.minimum(speed[begins[1:]], speed[ends[:-1]])
    with np.errstate(invalid="ignore"):
        steep = grid.find_accelerations(limits, np.zeros(len(speed)), width)
    for is_forward in (True, False):
        v = np.concatenate([[0.0], joint])[spans] if is_forward else np.concatenate([joint, [0.0]])[spans]
        node = begins[spans] if is_forward else ends[spans]
        inner = ~grid.rest[node] & (v < np.inf)
        t, a = width[node], np.where(np.isfinite(steep[node]), steep[node], 0.0)
        reach = v * t + a * t**2 / 2
        use = inner & (reach < 0.49 * track.length[spans]) & (reach > 0)
        parts.append((spans[use], (reach if is_forward else track.length[spans] - reach)[use]))
    span, local = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return refine_grid(grid, track, limits, span.astype(np.int64), local) if len(span) else grid


def _find_cell_caps(grid: Grid) -> Array:
    """The cap of speed between nodes: on lines their own one, else the lower one of both ends."""
    line = grid.line[:-1] & (grid.span[:-1] == grid.span[1:])
    return np.where(line, grid.speed[:-1], np.minimum(grid.speed[:-1], grid.speed[1:]))
