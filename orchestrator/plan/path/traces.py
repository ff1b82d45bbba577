"""The ways of a program as points, rapids apart from feeds: for drawings, extents, and where an axis stood."""

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

POINTS_PER_TURN = 48
POINTS_PER_SPLINE = 9


@dataclass(frozen=True, slots=True)
class PathTrace:
    """The points along a path, in the unit of its first axis. piece: of the way to each point, from 0; rapid: whether
    that has no feed."""

    points: Array
    piece: Index
    rapid: np.ndarray[tuple[int], np.dtype[np.bool_]]


def trace_paths(job: Job, paths: Sequence[ResolvedPath]) -> list[PathTrace]:
    """The traces of the paths of a job that were resolved. Arcs have their extremes among the points."""
    traces: list[PathTrace] = []
    for step, path in zip(find_paths(job.steps), paths, strict=True):
        outlines = [part for part in path.parts if isinstance(part, Outline)]
        traces += [_trace_outline(outline, has_feed=step.speed is not None) for outline in outlines]
    return traces


def _trace_outline(outline: Outline, *, has_feed: bool) -> PathTrace:
    lengths = [_choose_lengths(outline, span) for span in range(len(outline.kind))]
    span = np.repeat(np.arange(len(lengths)), [len(values) for values in lengths])
    along = np.concatenate(lengths)
    points = outline.shapes.evaluate(outline.kind[span], outline.row[span], along).q
    rapid = np.isinf(outline.speed[span]) & (not has_feed)
    return PathTrace(points, outline.piece[span], rapid)


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
