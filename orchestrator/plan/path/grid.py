"""The grid of a track on which speeds are planned: nodes by length, with what the axes allow there.

Each span has nodes at both of its ends, because curvature's derivative jumps between spans: two nodes at one length.
Lines need few (their limits are constant), polynomials have one at every knot of their length table.
"""

from dataclasses import dataclass, replace

import numpy as np

from orchestrator.plan.path.arc_length import CELLS, Array, Flags, Index, find_lengths, find_parameters
from orchestrator.plan.path.curves import ARC, LINE, POLY, QUICK
from orchestrator.plan.path.limits import PathLimits, Slopes, find_accelerations, find_slopes, find_speed_caps
from orchestrator.plan.path.track import Track

BLOCK = 4096  # nodes evaluated at a time, so that their derivatives stay in the processor's cache
ARC_CELLS = 12
ARC_STEP = np.pi / 32  # the longest cell of an arc, in rad


@dataclass(frozen=True, slots=True)
class Grid:
    """Nodes in order of length.

    span: of the track; line: whether on a straight line; rest: whether the motion rests there; section: the number of
    the stretch from rest to rest; speed: the cap; slower: by how much speeds are to be lower than limits allow; at:
    absolute derivatives, one column per node.
    """

    s: Array
    span: Index
    line: Flags
    rest: Flags
    section: Index
    speed: Array
    slower: Array
    at: Slopes

    def find_accelerations(self, limits: PathLimits, speed: Array, smoothing_s: Array) -> Array:
        """The tangential acceleration left at each node."""
        parts: list[Array] = []
        for k in range(0, len(self.s), BLOCK):
            part = slice(k, k + BLOCK)
            at = Slopes(*(values[:, part] for values in self.at))
            parts.append(find_accelerations(limits, at, speed[part], smoothing_s[part]))
        # Jerk follows from it within a fixed time.
        return np.concatenate(parts) / self.slower**3


def place_nodes(track: Track) -> tuple[Index, Array]:
    """(span, length from the span's start) of nodes: ends of lines, arcs in even steps, polynomials at knots."""
    angle = np.zeros(len(track.kind))
    arcs = track.kind == ARC
    angle[arcs] = track.shapes.arcs.turn[track.row[arcs]] * track.length[arcs]
    cells = np.where(track.kind == LINE, 1, CELLS)
    cells[arcs] = np.maximum(ARC_CELLS, np.ceil(angle[arcs] / ARC_STEP)).astype(np.int64)
    span = np.repeat(np.arange(len(cells)), cells + 1)
    number = np.arange(len(span)) - np.repeat(np.cumsum(cells + 1) - cells - 1, cells + 1)
    local = number / cells[span] * track.length[span]
    polys = np.flatnonzero(track.kind[span] == POLY)
    if len(polys):
        local[polys] = _place_on_polys(track, span[polys], number[polys])
    return span, local


def _place_on_polys(track: Track, span: Index, number: Index) -> Array:
    """Even steps of the parameter, from the start of the span to its end."""
    coefficients, table = track.shapes.polys
    row = track.row[span]
    local = table.lengths[row, number]
    cut = np.flatnonzero((track.low[span] > 0.0) | (track.length[span] < table.lengths[row, -1] * (1 - 1e-12)))
    if len(cut):
        spans, of = np.unique(span[cut], return_inverse=True)
        first, length = track.low[spans], track.length[spans]
        ends = [find_parameters(coefficients, table, track.row[spans], s, 2) for s in (first, first + length)]
        u = ends[0][of] + (ends[1] - ends[0])[of] * number[cut] / CELLS
        local[cut] = find_lengths(coefficients, table, row[cut], u) - first[of]
    # The ends exactly: by them it is known where the motion rests.
    return np.where(number == CELLS, track.length[span], np.where(number == 0, 0.0, local))


def make_grid(track: Track, limits: PathLimits, span: Index, local: Array) -> Grid:
    """Evaluate the nodes at `local` lengths of spans."""
    parts = [
        find_slopes(track.evaluate_spans(span[k : k + BLOCK], local[k : k + BLOCK], QUICK))
        for k in range(0, len(span), BLOCK)
    ]
    caps = np.minimum(np.concatenate([find_speed_caps(limits, part) for part in parts]), track.speed[span])
    at = Slopes(*(np.concatenate(columns, axis=1) for columns in zip(*parts, strict=True)))
    first = local == 0.0
    last = local == track.length[span]
    after_stop = np.concatenate([[True], track.stop[:-1]])
    at_rest = (first & after_stop[span]) | (last & track.stop[span])
    section = np.cumsum(after_stop)[span] - 1
    line, even = track.kind[span] == LINE, np.ones(len(span))
    return Grid(
        s=track.start[span] + local, span=span, line=line, rest=at_rest, section=section, speed=caps, slower=even, at=at
    )


def refine_grid(grid: Grid, track: Track, limits: PathLimits, span: Index, local: Array) -> Grid:
    """The grid with additional nodes."""
    more = make_grid(track, limits, span, local)
    s = np.concatenate([grid.s, more.s])
    order = np.lexsort((s, np.concatenate([grid.span, more.span])))
    cell = np.clip(np.searchsorted(grid.s, more.s), 1, len(grid.s) - 1)
    slower = np.maximum(grid.slower[cell - 1], grid.slower[cell])
    more = replace(more, slower=slower, speed=more.speed / slower)

    at = Slopes(*(np.concatenate(pair, axis=1).take(order, axis=1) for pair in zip(grid.at, more.at, strict=True)))
    return Grid(
        s=s[order],
        span=np.concatenate([grid.span, more.span])[order],
        line=np.concatenate([grid.line, more.line])[order],
        rest=np.concatenate([grid.rest, more.rest])[order],
        section=np.concatenate([grid.section, more.section])[order],
        speed=np.concatenate([grid.speed, more.speed])[order],
        slower=np.concatenate([grid.slower, slower])[order],
        at=at,
    )
