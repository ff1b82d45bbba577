"""A program as the page draws it: rapids and feeds as paths of SVG, and how far it reaches on each axis."""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.model.units import Unit, convert_units
from orchestrator.plan.path.traces import PathTrace

SIZE, MARGIN = 200.0, 8.0  # of the drawing, in its own units
LEAST_STEP = 0.15  # between two points that are drawn
MAX_POINTS = 40_000
ROUNDING = 1e-6  # of a unit: a program that ends at a limit does not leave it


def draw_program(traces: Sequence[PathTrace], letters: Sequence[str]) -> dict[str, Any]:
    """The way in the plane of the first two letters: `rapid` and `feed`, as `d` of an SVG path in a square of 200."""
    if not traces:
        return {"axes": [], "rapid": "", "feed": "", "start": None}
    plane = [np.column_stack([trace.points, trace.points[:, :1] * 0.0])[:, :2] for trace in traces]
    low, high = np.vstack(plane).min(axis=0), np.vstack(plane).max(axis=0)
    scale = (SIZE - 2 * MARGIN) / max(1e-9, float((high - low).max()))
    middle = (low + high) / 2
    drawings = [(points - middle) * [scale, -scale] + SIZE / 2 for points in plane]
    texts: dict[bool, list[str]] = {True: [], False: []}
    count = 0
    for trace, points in zip(traces, drawings, strict=True):
        count += _draw_trace(trace, points.tolist(), texts, MAX_POINTS - count)
    x, y = drawings[0][0].tolist()
    start = [round(x, 1), round(y, 1)]
    return {"axes": list(letters[:2]), "rapid": "".join(texts[True]), "feed": "".join(texts[False]), "start": start}


def _draw_trace(trace: PathTrace, points: list[list[float]], texts: dict[bool, list[str]], most: int) -> int:
    """Append a trace to the texts of its colours; the number of its points."""
    rapids = trace.rapid.tolist()
    last, last_rapid, count = points[0], None, 0
    for point, is_rapid in zip(points[1:], rapids[1:], strict=True):
        is_near = abs(point[0] - last[0]) + abs(point[1] - last[1]) < LEAST_STEP
        if count >= most or (is_near and is_rapid == last_rapid):
            continue
        if is_rapid != last_rapid:
            texts[is_rapid].append(f"M{last[0]:.1f} {last[1]:.1f}")
        texts[is_rapid].append(f"L{point[0]:.1f} {point[1]:.1f}")
        last, last_rapid, count = point, is_rapid, count + 1
    return count


def list_extents(
    traces: Sequence[PathTrace], names: Sequence[str], fleet: Fleet, axes: Mapping[str, AxisForecast]
) -> list[dict[str, Any]]:
    """How far the program goes on each axis, beside its soft limits. over: by how much it leaves them."""
    if not traces:
        return []
    points = np.vstack([trace.points for trace in traces])
    unit = Unit(fleet.axis(names[0]).unit)
    extents: list[dict[str, Any]] = []
    for number, name in enumerate(names):
        axis, forecast = fleet.axis(name), axes.get(name)
        scale = float(convert_units(Fraction(1), unit, Unit(axis.unit)))
        low, high = (float(value) * scale for value in (points[:, number].min(), points[:, number].max()))
        limits = axis.soft_limits_counts
        offset = 0.0 if forecast is None else float(forecast.offset)
        ends = None if limits is None else sorted(axis.to_unit(end) + offset for end in limits)
        over = 0.0 if ends is None else max(ends[0] - low, high - ends[1], 0.0)
        extents.append(
            {
                "axis": name,
                "unit": axis.unit,
                "min": round(low, 6),
                "max": round(high, 6),
                "limits": ends,
                "over": round(over, 6) if over > ROUNDING else 0,
            }
        )
    return extents
