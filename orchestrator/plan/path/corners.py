"""Corners of an outline: none where curves go on smoothly, a stop, or a quintic blend within the tolerance.

A blend leaves its neighbours `trim` before and after the corner with their tangents and curvatures, so that the path is
twice continuously differentiable and a bounded jerk exists. Arcs as blends cannot do that: curvature jumps there.

The tolerance is the true greatest distance. On a corner of straight lines it is that of the corner from the blend, and
proportional to `trim`: exact. Otherwise the blend is compared with the outline point by point, at equal fractions,
which is at least the true distance. LinuxCNC derived its blends from a formula instead, and was off by 2.4 (PR#3663).
"""

from dataclasses import dataclass

import numpy as np

from orchestrator.plan.path.arc_length import COARSE_ERROR, NEWTON_ROUNDS, Array, Flags, Index, measure_curves
from orchestrator.plan.path.curves import LINE, POLY, QUICK, Derivatives, Polys, Shapes, evaluate_polys
from orchestrator.plan.path.outline import SMOOTH, STOP, Outline
from orchestrator.plan.path.track import Frame, Track

# Where the control points of a blend lie between its end and the corner, in parts of `trim`.
INNER, OUTER = 0.4, 0.75
SAME_TANGENT = 1e-9  # rad
SAME_CURVATURE = 1e-6  # relative
# A blend that turns further, or whose |x'(u)| falls below that part of its length, is nearly a cusp: it would be slower
# than a stop, and its third derivative is too steep for the grid.
SHARPEST = np.pi * 150 / 180
SLOWEST = 0.4
ROUNDS = 5
COMPARED = 17  # points of a blend compared with the outline
_AT: Array = np.linspace(0.0, 1.0, COMPARED)


@dataclass(frozen=True, slots=True)
class Joints:
    """Where a span joins the next one: the turn in rad, whether both are lines, whether curvature continues."""

    turn: Array
    straight: Flags
    even: Flags


@dataclass(frozen=True, slots=True)
class Corners:
    """The corners of an outline. smooth: which need nothing. at: spans before those that can be blended, with how far
    their blends reach, and the curves of these."""

    smooth: Flags
    at: Index
    trims: Array
    curves: Array


def fit_corners(outline: Outline, *, even: bool) -> Corners:
    """Fit the blends of all corners with a tolerance. even: whether curvature must continue, because an axis has a
    jerk limit."""
    joints = _look_at_joints(outline)
    tolerance = outline.tolerance[:-1]
    smooth = (joints.turn <= SAME_TANGENT) & (joints.even | (not even)) | (tolerance == SMOOTH)
    at = np.flatnonzero(~smooth & (tolerance > STOP) & (joints.turn < SHARPEST))
    if not len(at):
        return Corners(smooth, at, np.zeros(0), np.zeros((0, *outline.shapes.polys.coefficients.shape[1:])))
    trims, curves, sound = _fit_blends(outline, joints, at, tolerance[at])
    return Corners(smooth, at[sound], trims[sound], curves[sound])


def make_track(outline: Outline, frame: Frame | None, corners: Corners, stops: Flags | None = None) -> Track:
    """The track of an outline, with all its blends. stops: for each span, whether to stop at its end instead."""
    mask = np.ones(len(corners.at), dtype=bool) if stops is None else ~stops[corners.at]
    at, trims = corners.at[mask], corners.trims[mask]
    stop = np.append(~corners.smooth, True)
    stop[at] = False
    cut = np.zeros((2, len(outline.kind)))
    cut[1, at], cut[0, at + 1] = trims, trims
    return _join_spans(outline, frame, stop, cut, (at, corners.curves[mask]) if len(at) else None)


def _look_at_joints(outline: Outline) -> Joints:
    spans = np.arange(len(outline.kind) - 1)
    ends = evaluate_ends(outline, spans, outline.length[spans])
    starts = evaluate_ends(outline, spans + 1, np.zeros(len(spans)))
    # From the chord of the unit tangents, because the arc cosine is inexact near 1.
    chord = np.linalg.norm(starts.first - ends.first, axis=1)
    turn = 2 * np.arcsin(np.minimum(chord / 2, 1.0))
    bend = np.linalg.norm(starts.second - ends.second, axis=1)
    most = np.maximum(np.linalg.norm(starts.second, axis=1), np.linalg.norm(ends.second, axis=1))
    straight = (outline.kind[:-1] == LINE) & (outline.kind[1:] == LINE)
    return Joints(turn, straight, bend <= SAME_CURVATURE * most)


def evaluate_ends(outline: Outline, span: Index, local: Array, rounds: int = NEWTON_ROUNDS) -> Derivatives:
    """Evaluate spans of an outline, in coordinates."""
    return outline.shapes.evaluate(outline.kind[span], outline.row[span], local, rounds)


def _fit_blends(outline: Outline, joints: Joints, at: Index, tolerance: Array) -> tuple[Array, Array, Flags]:
    """(trims, curves, which are sound) of the blends of corners `at`.

    No blend takes more than half of a span, so neighbours do not overlap.
    """
    most = np.minimum(outline.length[at], outline.length[at + 1]) / 2
    # The middle of a symmetric blend lies trim (16 - 5 outer - 10 inner) / 32 * 2 sin(turn / 2) from the corner, where
    # outer and inner are the control points' distances from the end.
    reach = (16 - 5 * INNER - 10 * OUTER) / 16 * np.sin(joints.turn[at] / 2)
    with np.errstate(divide="ignore"):
        trims = np.minimum(most, np.where(reach > 0, tolerance / reach, np.inf))
    curves = _make_blends(outline, at, trims)
    curved_joints = np.flatnonzero(~joints.straight[at])
    open_joints = curved_joints
    for _ in range(ROUNDS):
        off = (
            _find_distances(outline, at[open_joints], trims[open_joints], curves[open_joints]) / tolerance[open_joints]
        )
        # The distance grows with a power of the trim between 1 (a turn) and 2 (a step of curvature).
        better = np.where(off > 1.0, 0.98 / off, np.maximum(1.0, np.sqrt(0.95 / np.maximum(off, 1e-6))))
        new_trims = np.minimum(trims[open_joints] * better, most[open_joints])
        mask = ((off > 1.0) | (off < 0.8)) & (new_trims != trims[open_joints])
        open_joints, new_trims = open_joints[mask], new_trims[mask]
        if not len(open_joints):
            break
        trims[open_joints] = new_trims
        curves[open_joints] = _make_blends(outline, at[open_joints], new_trims)
    table = measure_curves(curves)
    sound = (table.slowest > SLOWEST * table.lengths[:, -1]) & (table.error < COARSE_ERROR)
    if len(curved_joints):
        off = _find_distances(outline, at[curved_joints], trims[curved_joints], curves[curved_joints])
        sound[curved_joints] &= off <= tolerance[curved_joints] * (1 + 1e-9)
    return trims, curves, sound


def _make_blends(outline: Outline, at: Index, trims: Array) -> Array:
    """Quintics from `trims` before the ends of spans `at` to as far behind, in Bernstein form, then in powers of u.

    Their ends have the position, tangent and curvature k of the neighbours: with x'(0) = 5 INNER trim t, the second
    derivative is |x'|² k plus a part along t, which is free.
    """
    begin = evaluate_ends(outline, at, outline.length[at] - trims)
    finish = evaluate_ends(outline, at + 1, trims)
    d = trims[:, None]
    bend = (5 * INNER * d) ** 2 / 20
    p0, p5 = begin.q, finish.q
    p1, p4 = p0 + INNER * d * begin.first, p5 - INNER * d * finish.first
    p2 = p0 + OUTER * d * begin.first + bend * begin.second
    p3 = p5 - OUTER * d * finish.first + bend * finish.second
    return np.einsum("kj,jnc->nkc", _FROM_BERNSTEIN, np.stack([p0, p1, p2, p3, p4, p5]))


_FROM_BERNSTEIN: Array = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [-5, 5, 0, 0, 0, 0],
        [10, -20, 10, 0, 0, 0],
        [-10, 30, -30, 10, 0, 0],
        [5, -20, 30, -20, 5, 0],
        [-1, 5, -10, 10, -5, 1],
    ],
    dtype=np.float64,
)


def _find_distances(outline: Outline, at: Index, trims: Array, curves: Array) -> Array:
    """The greatest distance of blends from the outline, point by point at equal fractions of u and of length."""
    rows = np.repeat(np.arange(len(at)), COMPARED)
    fraction = np.tile(_AT, len(at))
    on_blend = evaluate_polys(curves, rows, fraction).q
    late = fraction > 0.5
    along = (2 * fraction - 1) * trims[rows]
    span = at[rows] + late
    local = np.where(late, along, outline.length[at[rows]] + along)
    on_outline = evaluate_ends(outline, span, local, QUICK).q
    return np.linalg.norm(on_blend - on_outline, axis=1).reshape(len(at), COMPARED).max(axis=1)


def _join_spans(
    outline: Outline, frame: Frame | None, stop: Flags, cut: Array, blends: tuple[Index, Array] | None
) -> Track:
    """The track of spans shortened by `cut` (at the start, at the end), with blends behind spans `blends[0]`."""
    shapes, order = outline.shapes, np.arange(len(outline.kind), dtype=np.float64)
    kind, row, piece, speed = outline.kind, outline.row, outline.piece, outline.speed
    low, length = cut[0], outline.length - cut[0] - cut[1]
    if blends is not None:
        at, curves = blends
        coefficients, lengths = shapes.polys.coefficients, measure_curves(curves)
        table = type(lengths)(*(np.concatenate(p) for p in zip(shapes.polys.table, lengths, strict=True)))
        shapes = Shapes(shapes.lines, shapes.arcs, Polys(np.concatenate([coefficients, curves]), table))
        order = np.append(order, at + 0.5)
        kind = np.append(kind, np.full(len(at), POLY))
        row = np.append(row, len(coefficients) + np.arange(len(at)))
        piece = np.append(piece, piece[at])
        speed = np.append(speed, np.minimum(speed[at], speed[at + 1]))
        low = np.append(low, np.zeros(len(at)))
        length = np.append(length, lengths.lengths[:, -1])
        stop = np.append(stop, np.zeros(len(at), dtype=bool))
    # Of a line between two blends nothing may be left.
    spare = outline.length.max() * 1e-12
    keep = np.argsort(order, kind="stable")
    keep = keep[length[keep] > spare]
    source = np.floor(order).astype(np.int64)
    blend = order != source
    start = np.concatenate([[0.0], np.cumsum(length[keep])])
    return Track(
        shapes=shapes,
        frame=frame,
        kind=kind[keep],
        row=row[keep],
        low=low[keep],
        length=length[keep],
        piece=piece[keep],
        source=source[keep],
        blend=blend[keep],
        stop=stop[keep],
        speed=speed[keep],
        start=start,
    )
