"""The rest of a path: from every place on it the same curve, and where on it axes stood."""

import numpy as np
import pytest

from orchestrator.model.steps.path import FollowPath
from orchestrator.model.units import Unit
from orchestrator.plan.path.arc_length import Array
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path.resolve import ResolvedPath, resolve_path
from orchestrator.plan.path.rest import cut_path, find_place
from orchestrator.plan.path.traces import trace_path

TOLERANCE = 0.1
MM = [Unit.MM, Unit.MM, Unit.MM]
AXES = [PathAxis(f"a.{name}", Unit.MM, 1.0, 1.0) for name in "xyz"]
PIECES: list[dict[str, object]] = [
    {"piece": "line", "to": [20, 0, 0]},
    {"piece": "arc", "to": [20, 20, 0], "centre": [20, 10]},
    {"piece": "helix", "to": [20, 20, 6], "centre": [20, 15], "turns": 2, "direction": "cw"},
    {"piece": "arc", "to": [0, 20, 6], "through": [10, 24, 9]},
    {"piece": "spline", "through": [[-5, 10, 6], [0, 0, 6]]},
    {"piece": "arc", "to": [0, 0, 6], "centre": [5, 0]},
    {"piece": "line", "to": [0, -20, 6]},
]
SPLINE = 4
STEP = FollowPath(axes=["a.x", "a.y", "a.z"], start=[0, 0, 0], tolerance="100 um", pieces=PIECES)


def resolve(step: FollowPath) -> ResolvedPath:
    return resolve_path(step, AXES)


def walk(step: FollowPath) -> tuple[Array, Array]:
    """Points of a path and the number of the piece of each."""
    trace = trace_path(resolve(step))
    return trace.points, trace.piece


def nearest(points: Array, others: Array) -> Array:
    """By point, how far it is from the polygon of others."""
    begin, way = others[:-1], np.diff(others, axis=0)
    size = np.maximum((way**2).sum(axis=1), 1e-30)
    part = np.clip(((points[:, None] - begin) * way).sum(axis=2) / size, 0, 1)
    return np.linalg.norm(begin + part[:, :, None] * way - points[:, None], axis=2).min(axis=1)


@pytest.mark.parametrize("part", [0.02, 0.2, 0.5, 0.83, 0.97])
def test_the_rest_from_any_place_is_the_same_curve(part: float) -> None:
    path, trace = resolve(STEP), trace_path(resolve(STEP))
    last = round(part * (len(trace.points) - 1))
    place = find_place(path, trace, list(trace.points[: last + 1]), TOLERANCE)
    assert place is not None
    rest = cut_path(STEP, path, place, MM)
    points, _ = walk(rest)
    assert rest.pieces[-1] == STEP.pieces[-1] and len(rest.pieces) == len(PIECES) - place.piece
    assert points[0] == pytest.approx(place.position, abs=1e-6)
    whole, _ = walk(STEP)
    assert nearest(points, whole).max() < 0.02  # polygons of arcs are that coarse
    # What is left of the whole is in the rest, too.
    assert nearest(whole[last + 1 :], points).max() < 0.02


def test_a_spline_begins_at_its_start_again() -> None:
    path, trace = resolve(STEP), trace_path(resolve(STEP))
    last = int(np.flatnonzero(trace.piece == SPLINE)[-3])
    place = find_place(path, trace, list(trace.points[:last]), TOLERANCE)
    assert place is not None and (place.piece, place.along) == (SPLINE, 0.0)
    assert place.position == pytest.approx([0, 20, 6])


def test_a_table_begins_at_its_start_again() -> None:
    table = {"piece": "table", "t": [0, 1, 2], "positions": [[20, 0, 0], [30, 0, 0], [40, 0, 0]]}
    step = FollowPath(axes=STEP.axes, start=[0, 0, 0], tolerance="100 um", pieces=[PIECES[0], table])
    path = resolve(step)
    place = find_place(path, trace_path(path), [np.array([x, 0.0, 0.0]) for x in (5.0, 15.0, 25.0)], TOLERANCE)
    assert place is not None and (place.piece, place.along) == (1, 0.0)


def test_a_path_that_comes_by_twice_is_followed_in_time() -> None:
    lap = [{"piece": "line", "to": to} for to in ([10, 0, 0], [10, 10, 0], [0, 10, 0], [0, 0, 0])]
    step = FollowPath(axes=STEP.axes, start=[0, 0, 0], tolerance="100 um", pieces=lap * 2)
    path = resolve(step)
    way = np.vstack([np.linspace(begin, end, 9) for begin, end in zip(*_corners(), strict=True)])
    once = find_place(path, trace_path(path), list(way[: 9 * 2 - 3]), TOLERANCE)
    twice = find_place(path, trace_path(path), list(np.vstack([way, way[: 9 * 2 - 3]])), TOLERANCE)
    assert once is not None and twice is not None
    assert (once.piece, twice.piece) == (1, 5)
    assert once.position == pytest.approx(twice.position)


def _corners() -> tuple[list[list[float]], list[list[float]]]:
    corners = [[0.0, 0, 0], [10.0, 0, 0], [10.0, 10, 0], [0.0, 10, 0]]
    return corners, [*corners[1:], corners[0]]


def test_the_place_is_the_last_one_within_the_tolerance() -> None:
    path = resolve(STEP)
    beside = [np.array([x, y, 0.0]) for x, y in ((5.0, 0.02), (9.0, 0.08), (12.0, 0.4))]
    place = find_place(path, trace_path(path), beside, TOLERANCE)
    assert place is not None and place.position == pytest.approx([9, 0, 0])
    assert find_place(path, trace_path(path), beside[2:], TOLERANCE) is None


def test_the_lines_of_a_rest_are_those_of_its_pieces() -> None:
    source = {"file": "part.ngc", "lines": [[3, 2, 2], [9, 1, 0], [10, 4, 1]]}
    step = FollowPath.model_validate({**STEP.model_dump(), "source": source})
    assert step.source is not None
    assert [step.source.find_line(piece) for piece in range(8)] == [3, 5, 9, 10, 11, 12, 13, None]
    path = resolve(step)
    place = find_place(path, trace_path(path), [np.array([20.0, 0.0, 0.0]), np.array([30.0, 10.0, 0.0])], TOLERANCE)
    assert place is not None
    rest = cut_path(step, path, place, MM)
    assert rest.source is not None and [rest.source.find_line(piece) for piece in range(6)] == [5, 9, 10, 11, 12, 13]
