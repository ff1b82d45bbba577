"""The time law: how fast a track is gone along, on the limits of velocity, acceleration and jerk of all axes.

Caps of speed on a grid; accelerations left at those speeds; sweeps forward and backward with both spread over the
smoothing time; plateaus on peaks; smoothing. Explained in docs/explanation/path-time-law.md.
"""

from dataclasses import dataclass

import numpy as np

from orchestrator.plan.path.arc_length import Array
from orchestrator.plan.path.coarse import MARGIN, flatten_peaks, insert_peaks, integrate_squares
from orchestrator.plan.path.grid import Grid, make_grid, place_nodes, refine_grid
from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.smooth import PathMotion, smooth_motion
from orchestrator.plan.path.sweeps import spread_caps, spread_cells, sweep_squares
from orchestrator.plan.path.track import Track


@dataclass(frozen=True, slots=True)
class TimeLaw:
    """A motion along a track, and the grid and the accelerations from which it was made."""

    motion: PathMotion
    grid: Grid
    acceleration: Array
    squares: Array


def plan_law(track: Track, limits: PathLimits) -> TimeLaw:
    """Plan the motion along a track from rest to rest."""
    base = make_grid(track, limits, *place_nodes(track))
    smoothing_s = choose_smoothing(base, track, limits)
    return plan_with_smoothing(track, limits, base, smoothing_s)


def choose_smoothing(grid: Grid, track: Track, limits: PathLimits) -> Array:
    """The smoothing time of each section: the largest acceleration divided by jerk, less on a short line."""
    first = np.abs(grid.at.first)
    with np.errstate(divide="ignore", invalid="ignore"):
        acceleration = np.minimum(np.nanmin(limits.acceleration / first, axis=1), limits.path_acceleration)
        jerk = np.minimum(np.nanmin(limits.jerk / first, axis=1), limits.path_jerk)
        ratio = acceleration / jerk
    begin = np.flatnonzero(np.diff(grid.section, prepend=-1))
    smoothing_s = np.maximum.reduceat(ratio, begin)
    end = np.append(begin[1:], len(grid.s)) - 1
    # From rest to rest over L with jerk alone: four ramps of (L / 2J)^(1/3).
    single = end - begin == 1
    length = grid.s[end] - grid.s[begin]
    return np.where(single, np.minimum(smoothing_s, np.cbrt(length / (2 * jerk[begin]))), smoothing_s)


def plan_with_smoothing(track: Track, limits: PathLimits, base: Grid, smoothing_s: Array) -> TimeLaw:
    """Plan with a smoothing time for each section."""
    grid = _add_nodes(base, track, limits, smoothing_s[base.section])
    width = smoothing_s[grid.section]
    h = np.diff(grid.s)
    within = np.diff(grid.section) == 0
    caps = spread_caps(grid.speed, grid.s, width)
    caps[grid.rest] = 0.0
    squares = caps**2

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
    times = np.concatenate([[0.0], np.cumsum(np.where(within, np.minimum(dt, 1e3), 2 * width[:-1] + 2 * width[1:]))])
    squares_held, cells = sweep(np.sqrt(fast), times)
    top = _find_cell_caps(grid, caps) ** 2
    motion = _assemble_motion(grid, squares_held, top, cells, width)
    return TimeLaw(motion, grid, cells, squares_held)


def _add_nodes(grid: Grid, track: Track, limits: PathLimits, width: Array) -> Grid:
    """Nodes at which caps and accelerations change that are spread from a junction into a line, an arc or a spline."""
    ends = np.flatnonzero(np.diff(grid.span, append=-1))
    begins = np.concatenate([[0], ends[:-1] + 1])
    spans = np.flatnonzero(~track.blend)
    parts: list[tuple[Array, Array]] = []
    speed = grid.speed
    joint = np.minimum(speed[begins[1:]], speed[ends[:-1]])
    with np.errstate(invalid="ignore"):
        steep = grid.find_accelerations(limits, np.zeros(len(speed)), width)
    for ahead in (True, False):
        v = np.concatenate([[0.0], joint])[spans] if ahead else np.concatenate([joint, [0.0]])[spans]
        node = begins[spans] if ahead else ends[spans]
        inner = ~grid.rest[node] & (v < np.inf)
        t, a = width[node], np.where(np.isfinite(steep[node]), steep[node], 0.0)
        for reach in (v * t * (1 + MARGIN) / 2, v * t + a * t**2 / 2):
            use = inner & (reach < 0.49 * track.length[spans]) & (reach > 0)
            local = reach if ahead else track.length[spans] - reach
            parts.append((spans[use], local[use]))
    span, local = (np.concatenate(each) for each in zip(*parts, strict=True))
    return refine_grid(grid, track, limits, span.astype(np.int64), local) if len(span) else grid


def _assemble_motion(grid: Grid, squares: Array, top: Array, cells: Array, width: Array) -> PathMotion:
    s, squares, source = insert_peaks(grid.s, squares, top, cells)
    width = width[source]
    # Between two sections the motion rests for half of the smoothing time of each.
    pause = np.where(np.diff(grid.section[source]) > 0, (width[:-1] + width[1:]) / 2, 0.0)
    coarse = integrate_squares(s, squares, pause)
    s, squares, again = flatten_peaks(coarse, width)
    source, width = source[again], width[again]
    pause = np.where(np.diff(grid.section[source]) > 0, (width[:-1] + width[1:]) / 2, 0.0)
    return smooth_motion(integrate_squares(s, squares, pause), width)


def _find_cell_caps(grid: Grid, caps: Array) -> Array:
    """The cap between nodes: on lines their own one, except where that of a junction is spread into them."""
    begin, end = grid.span[:-1], grid.span[1:]
    line = grid.line[:-1] & (begin == end)
    edge = np.diff(grid.span, prepend=-1, append=-1) != 0  # at each node: before it, one more after the last
    # The first and the last cell of a line; a rest spreads nothing.
    near = (edge[:-2] & ~grid.rest[:-1]) | (edge[2:] & ~grid.rest[1:])
    own = np.where(near, np.minimum(grid.speed[:-1], np.maximum(caps[:-1], caps[1:])), grid.speed[:-1])
    return np.where(line, own, np.minimum(caps[:-1], caps[1:]))
