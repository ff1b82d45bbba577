"""Random paths, the use of limits by dense samples, and the least time that second-order limits allow."""

import numpy as np
from numpy.typing import NDArray

from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.outline import Circle, Outline, OutlineBuilder, PieceEnd
from orchestrator.plan.path.run import Run
from orchestrator.plan.path.track import Track

Array = NDArray[np.float64]
KINDS = ("line", "arc", "circle", "spline")


def even_limits(axes: int) -> PathLimits:
    """200 mm/s, 2 m/s², and a jerk of 100 times that per second, for all axes."""
    return PathLimits(np.full(axes, 200.0), np.full(axes, 2000.0), np.full(axes, 200_000.0))


def uneven_limits(draw: np.random.Generator, axes: int) -> PathLimits:
    """Limits over decades, some axes without a jerk limit, some along the path."""
    acceleration = 10 ** draw.uniform(2, 4.5, axes)
    jerk = acceleration * 10 ** draw.uniform(0.7, 3, axes)
    if draw.random() < 0.3:
        jerk[draw.random(axes) < 0.4] = np.inf
    along = [10 ** draw.uniform(*ends) if draw.random() < 0.3 else np.inf for ends in ((1, 2.5), (2, 4), (4, 6))]
    return PathLimits(10 ** draw.uniform(1, 3, axes), acceleration, jerk, *along)


def random_outline(
    draw: np.random.Generator,
    axes: int,
    pieces: int,
    kinds: tuple[str, ...] = KINDS,
    lengths: tuple[float, float] = (5.0, 100.0),
) -> Outline:
    """Pieces of `lengths` in random directions; tolerances of 50 um to 1 mm."""
    builder = OutlineBuilder(np.zeros(axes))
    for number in range(pieces):
        end = PieceEnd(number, 10 ** draw.uniform(np.log10(0.05), 0.0))
        way = draw.normal(size=axes)
        way *= draw.uniform(*lengths) / np.linalg.norm(way)
        kind = str(draw.choice(kinds)) if axes > 1 else "line"
        if kind == "line":
            builder.add_line(end, builder.position + way)
        elif kind == "arc":
            side = draw.normal(size=axes)
            side -= side @ way * way / (way @ way)
            side *= np.linalg.norm(way) / np.linalg.norm(side) * draw.uniform(0.05, 0.4)
            builder.add_arc_through(end, builder.position + way / 2 + side, builder.position + way)
        elif kind == "circle":
            i, j = (int(k) for k in draw.choice(axes, 2, replace=False))
            radius = draw.uniform(*lengths) / 4
            angle = draw.uniform(0, 2 * np.pi)
            centre = builder.position[[i, j]] + radius * np.array([np.cos(angle), np.sin(angle)])
            to = builder.position.copy()
            swept = angle + np.pi + draw.uniform(0.3, 5.0)
            to[[i, j]] = centre + radius * np.array([np.cos(swept), np.sin(swept)])
            builder.add_arc(end, Circle((i, j), (float(centre[0]), float(centre[1])), bool(draw.random() < 0.5)), to)
        else:
            n = int(draw.integers(2, 6))
            steps = way / n + draw.normal(size=(n, axes)) * np.linalg.norm(way) / n * 0.3 / np.sqrt(axes)
            builder.add_spline(end, builder.position + np.cumsum(steps, axis=0))
    return builder.build()


def find_worst_use(run: Run, limits: PathLimits, samples: int = 7) -> float:
    """The largest part of any limit that is used, at samples inside every segment, the path's own limits included."""
    motion = run.motion
    inside = np.linspace(1e-6, 1 - 1e-6, samples)
    t = (motion.t[:, None] + (motion.ends_s - motion.t)[:, None] * inside).ravel()
    _, v, a, j = run.evaluate(t)
    _, speed, acceleration, jerk = motion.evaluate(t)
    axes = max(np.abs(x / y).max() for x, y in ((v, limits.velocity), (a, limits.acceleration), (j, limits.jerk)))
    along = ((speed, limits.path_speed), (acceleration, limits.path_acceleration), (jerk, limits.path_jerk))
    return max(axes, *(float(np.abs(x / y).max()) for x, y in along))


def find_least_time(track: Track, limits: PathLimits, cells: int = 60) -> float:
    """The least time of a track with the limits of velocity and acceleration alone, on `cells` per span.

    It is the theory of TOPP-RA (Pham and Pham, "A new approach to time-optimal path parameterization based on
    reachability analysis", 2018): |q'' b + q' u| <= A for each axis bounds the change u of b = v²/2 at each point; a
    pass backwards and one forwards with the extreme u. On splines it was within 4e-5 of `toppra` 0.6.
    """
    local = np.concatenate([np.linspace(0.0, length, cells + 1) for length in track.length])
    span = np.repeat(np.arange(len(track.kind)), cells + 1)
    at = track.evaluate_spans(span, local)
    s = track.start[span] + local
    ends = np.arange(1, len(track.kind) + 1) * (cells + 1) - 1
    rest = np.zeros(len(s), dtype=bool)
    rest[0] = True
    rest[ends[track.stop]] = True
    rest[np.minimum(ends[track.stop] + 1, len(s) - 1)] = True
    low, high = (
        np.zeros(len(s)),
        np.minimum((limits.velocity / np.maximum(np.abs(at.first), 1e-12)).min(axis=1), 1e6) ** 2,
    )
    allowed = high.copy()
    for _ in range(40):
        middle = (low + high) / 2
        least, most = _find_range(at.first, at.second, middle, limits.acceleration)
        low, high = np.where(least <= most, middle, low), np.where(least <= most, high, middle)
    squares = np.where(rest, 0.0, np.minimum(low, allowed))
    h = np.diff(s)
    for k in range(len(s) - 2, -1, -1):
        least, _ = _find_range(
            at.first[k + 1 : k + 2], at.second[k + 1 : k + 2], squares[k + 1 : k + 2], limits.acceleration
        )
        squares[k] = max(min(squares[k], squares[k + 1] - 2 * h[k] * least[0]), 0.0)
    for k in range(len(s) - 1):
        _, most = _find_range(at.first[k : k + 1], at.second[k : k + 1], squares[k : k + 1], limits.acceleration)
        squares[k + 1] = max(min(squares[k + 1], squares[k] + 2 * h[k] * most[0]), 0.0)
    v = np.sqrt(squares)
    return float(np.where(h > 0, 2 * h / np.maximum(v[:-1] + v[1:], 1e-9), 0.0).sum())


def _find_range(first: Array, second: Array, squares: Array, acceleration: Array) -> tuple[Array, Array]:
    """The least and the largest tangential acceleration at squared speeds; none is allowed if they cross."""
    bend = second * squares[:, None]
    flat = np.abs(first) < 1e-12
    rate = np.where(flat, 1.0, first)
    ends = np.stack([(acceleration - bend) / rate, (-acceleration - bend) / rate])
    least = np.where(flat, np.where(np.abs(bend) > acceleration, np.inf, -np.inf), ends.min(axis=0))
    return least.max(axis=1), np.where(flat, np.inf, ends.max(axis=0)).min(axis=1)
