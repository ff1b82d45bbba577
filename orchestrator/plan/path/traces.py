"""The way of a path as points: for drawings, extents, and to find where on it axes stood."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi

import numpy as np

from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.tree import find_paths
from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.curves import ARC, LINE
from orchestrator.plan.path.outline import Outline
from orchestrator.plan.path.resolve import ResolvedPath
from orchestrator.plan.path.tables import TimedTable

POINTS_PER_TURN = 48
POINTS_PER_SPLINE = 9


@dataclass(frozen=True, slots=True)
class PathTrace:
    """The points along a path, in the units of its coordinates. Of the way to each point: piece, from 0; rapid, whether
    it has no feed; part of the resolved path, span of its outline, and along, how far on that span the point is."""

    points: Array
    piece: Index
    rapid: np.ndarray[tuple[int], np.dtype[np.bool_]]
    part: Index
    span: Index
    along: Array


def trace_paths(job: Job, paths: Sequence[ResolvedPath]) -> list[PathTrace]:
    """The traces of the paths of a job that were resolved."""
    return [
        trace_path(path, has_feed=step.speed is not None)
        for step, path in zip(find_paths(job.steps), paths, strict=True)
    ]


def trace_path(path: ResolvedPath, *, has_feed: bool = False) -> PathTrace:
    """The trace of a path. Arcs have their extremes among the points."""
    traces = [
        _trace_outline(part, number, has_feed=has_feed) if isinstance(part, Outline) else _trace_table(part, number)
        for number, part in enumerate(path.parts)
    ]
    if len(traces) == 1:
        return traces[0]
    return PathTrace(
        *(
            np.concatenate([getattr(trace, name) for trace in traces])
            for name in ("points", "piece", "rapid", "part", "span", "along")
        )
    )


def _trace_outline(outline: Outline, part: int, *, has_feed: bool) -> PathTrace:
    lengths = [_choose_lengths(outline, span) for span in range(len(outline.kind))]
    span = np.repeat(np.arange(len(lengths)), [len(values) for values in lengths])
    along = np.concatenate(lengths)
    points = outline.shapes.evaluate(outline.kind[span], outline.row[span], along).q
    rapid = np.isinf(outline.speed[span]) & (not has_feed)
    return PathTrace(points, outline.piece[span], rapid, np.full(len(span), part), span, along)


def _trace_table(table: TimedTable, part: int) -> PathTrace:
    """The rows of a table; its span has its own times, so none is cut."""
    count = len(table.rows)
    zeros = np.zeros(count, dtype=np.int64)
    return PathTrace(table.rows, zeros + table.piece, np.zeros(count, dtype=bool), zeros + part, zeros, np.zeros(count))


def _choose_lengths(outline: Outline, span: int) -> Array:
    """The lengths from the start of a span at which it is drawn."""
    length, kind, row = float(outline.length[span]), int(outline.kind[span]), int(outline.row[span])
    if kind == LINE:
        return np.array([0.0, length])
    if kind != ARC:
        return np.linspace(0.0, length, POINTS_PER_SPLINE)
    arcs = outline.shapes.arcs
    turn = float(arcs.turn[row])
    extremes = np.arctan2(arcs.second[row], arcs.first[row]) % pi
    most = np.concatenate([extremes, extremes + pi]) / turn
    even = np.linspace(0.0, length, ceil(turn * length / (2 * pi) * POINTS_PER_TURN) + 2)
    return np.unique(np.concatenate([even, most[most < length]]))
