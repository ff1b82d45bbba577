"""Random paths and limits, and the use of limits by dense samples."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.outline import STOP, Circle, Outline, OutlineBuilder, PieceEnd
from orchestrator.plan.path.run import Run

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
        end = PieceEnd(number, 10 ** draw.uniform(-1.3, 0.0))
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


def stop_everywhere(outline: Outline) -> Outline:
    """The outline with a stop at every corner."""
    tolerance: Array = np.where(np.isfinite(outline.tolerance), STOP, outline.tolerance)
    return replace(outline, tolerance=tolerance)


def find_worst_use(run: Run, limits: PathLimits, samples: int = 7) -> float:
    """The largest part of any limit that is used, at samples inside every segment, the path's own limits included."""
    motion = run.motion
    shares = np.linspace(1e-6, 1 - 1e-6, samples)
    t = (motion.t[:, None] + (motion.ends_s - motion.t)[:, None] * shares).ravel()
    _, v, a, j = run.evaluate(t)
    _, speed, acceleration, jerk = motion.evaluate(t)
    axes = max(np.abs(x / y).max() for x, y in ((v, limits.velocity), (a, limits.acceleration), (j, limits.jerk)))
    along = ((speed, limits.path_speed), (acceleration, limits.path_acceleration), (jerk, limits.path_jerk))
    return max(float(axes), *(float(np.abs(x / y).max()) for x, y in along))
