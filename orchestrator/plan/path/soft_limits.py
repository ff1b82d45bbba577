"""Soft limits along the whole path: extremes inside its curves, not only ends."""

import numpy as np

from orchestrator.plan.path.arc_length import Array
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path.curves import LINE
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.grid import place_nodes
from orchestrator.plan.path.tables import TableRun
from orchestrator.plan.path.track import Track

ROUNDING = 1e-9  # of the range of soft limits: a position that is a limit has not left it
LOOKED_AT = 33  # points of a cell; twice, the second time about the largest one
BLOCK = 2048


def check_track(track: Track, axes: list[PathAxis]) -> None:
    """Refuse a track that leaves soft limits anywhere. Raises `PathRefusal` naming piece, axis and place."""
    span, local = place_nodes(track)
    parts = [track.evaluate_spans(span[k : k + BLOCK], local[k : k + BLOCK]).q for k in range(0, len(span), BLOCK)]
    q = np.concatenate(parts)
    h = np.where(np.diff(span) == 0, np.diff(local), 0.0)
    for k, axis in enumerate(axes):
        if axis.soft_limits is None:
            continue
        # An axis moves by at most its row's norm for each unit of length.
        rate = 1.0 if track.frame is None else float(np.linalg.norm(track.frame.matrix[k]))
        for sign, limit in zip((-1.0, 1.0), axis.soft_limits, strict=True):
            allowed_sign = sign * limit + ROUNDING * (axis.soft_limits[1] - axis.soft_limits[0])
            reach = (sign * (q[:-1, k] + q[1:, k]) + rate * h) / 2
            ends = np.maximum(sign * q[:-1, k], sign * q[1:, k])
            reach = np.where(track.kind[span[:-1]] == LINE, ends, reach)
            for cell in np.flatnonzero(reach > allowed_sign):
                length, value = _find_extreme(track, span[cell], (local[cell], local[cell] + h[cell]), (k, sign))
                if sign * value > allowed_sign:
                    _refuse(int(track.piece[span[cell]]), axis, (length, value), limit)


def _find_extreme(track: Track, span: int, ends: tuple[float, float], wanted: tuple[int, float]) -> tuple[float, float]:
    """(length from the track's start, position) of the extreme of an axis in a cell."""
    axis, sign = wanted
    low, high = ends
    x = np.linspace(low, high, LOOKED_AT)
    best = 0
    q: Array = np.zeros(1)
    for _ in range(2):
        x = np.linspace(low, high, LOOKED_AT)
        q = track.evaluate_spans(np.full(LOOKED_AT, span), x).q[:, axis]
        best = int(np.argmax(sign * q))
        low, high = x[max(best - 1, 0)], x[min(best + 1, LOOKED_AT - 1)]
    return float(track.start[span] + x[best]), float(q[best])


def check_table(run: TableRun, axes: list[PathAxis]) -> None:
    """The same for a table: at its knots, and where an axis turns between them."""
    for k, axis in enumerate(axes):
        if axis.soft_limits is None:
            continue
        instants = _find_turns(run, k)
        positions = run.evaluate(instants)[0][:, k]
        for sign, limit in zip((-1.0, 1.0), axis.soft_limits, strict=True):
            worst = int(np.argmax(sign * positions))
            value = float(positions[worst])
            if sign * value > sign * limit + ROUNDING * (axis.soft_limits[1] - axis.soft_limits[0]):
                knot = int(np.searchsorted(run.knots, float(instants[worst]))) - 1
                gap = min(max(knot, 0), len(run.row) - 1)
                side = "below" if sign < 0 else "above"
                text = (
                    f"piece {run.piece + 1} (table): {axis.axis} reaches {value:.9g} {axis.unit} between rows "
                    f"{run.row[gap]} and {run.row[gap] + 1}, {side} its soft limit {limit:.9g}"
                )
                raise PathRefusal("soft-limit", text, "keep the path inside, or move it", run.piece + 1)


def _find_turns(run: TableRun, axis: int) -> Array:
    """The instants of knots, and those at which the axis's velocity is zero."""
    c1, c2, c3 = run.cubics[:, 1, axis], run.cubics[:, 2, axis], run.cubics[:, 3, axis]
    h = np.diff(run.knots)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(c2**2 - 3 * c1 * c3)
        roots = [(-c2 + root) / (3 * c3), (-c2 - root) / (3 * c3), -c1 / (2 * c2)]
    inner_knots = [run.knots[:-1][(x > 0) & (x < h)] + x[(x > 0) & (x < h)] for x in roots]
    return np.concatenate([run.knots, *inner_knots])


def _refuse(piece: int, axis: PathAxis, found: tuple[float, float], limit: float) -> None:
    length, value = found
    side = "above" if value > limit else "below"
    text = (
        f"piece {piece + 1}: {axis.axis} reaches {value:.9g} {axis.unit} at {length:.6g} along the path, {side} its "
        f"soft limit {limit:.9g}"
    )
    raise PathRefusal("soft-limit", text, "keep the path inside, or move it", piece + 1)
