"""Plans of paths as they are written: units, frames, tables, soft limits, stretches, and what is refused."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from orchestrator.model.frame import FrameSpec
from orchestrator.model.paths.spec import PathSpec
from orchestrator.model.units import Unit
from orchestrator.plan.path.axes import AlongLimits, PathAxis
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.outline import OutlineBuilder, PieceEnd
from orchestrator.plan.path.plan import PathPlan, plan_path
from orchestrator.plan.path.tables import TimedTable

X, Y = "gantry.x", "gantry.y"


def make_axes(low: float = -200.0, high: float = 200.0, jerk: float | None = 200_000.0) -> list[PathAxis]:
    return [PathAxis(name, Unit.MM, 200.0, 2000.0, jerk, (low, high)) for name in (X, Y)]


def spec(*pieces: dict[str, Any], **more: Any) -> PathSpec:
    return PathSpec.model_validate({"axes": [X, Y], "start": [0, 0], "pieces": list(pieces), **more})


def line(x: Any, y: Any, **more: Any) -> dict[str, Any]:
    return {"piece": "line", "to": [x, y], **more}


def check_consistent(plan: PathPlan) -> None:
    """Positions, velocities and accelerations belong together, and end where the path ends."""
    t = np.linspace(0, plan.duration_s, 4001)
    rows = plan.evaluate(t)
    dt = t[1] - t[0]
    slope = np.diff(rows.positions, axis=0) / dt
    assert np.abs(slope - (rows.velocities[1:] + rows.velocities[:-1]) / 2).max() <= 0.2e6 * dt**2
    slope = np.diff(rows.velocities, axis=0) / dt
    assert np.abs(slope - (rows.accelerations[1:] + rows.accelerations[:-1]) / 2).max() <= 0.3e6 * dt
    ends = plan.evaluate(np.array([-1.0, plan.duration_s, plan.duration_s + 1]))
    assert ends.velocities == pytest.approx(0.0) and ends.accelerations == pytest.approx(0.0)
    along = plan.path(np.array([0.0, plan.length]))
    assert along[[0, 1, 1]] == pytest.approx(ends.positions, abs=1e-9)


def test_a_path_of_all_pieces() -> None:
    plan = plan_path(
        spec(
            line("50 mm", 0),
            {"piece": "arc", "centre": [50, 25], "to": ["5 cm", 50]},
            {"piece": "spline", "through": [[30, 60], [10, 50], [0, 20]]},
            {"piece": "arc", "through": [-10, 10], "to": [0, 0], "corner": "stop"},
            {"piece": "table", "t": [0, 1, 2, 3], "positions": [[0, 0], [10, 5], [20, 10], [20, 12]]},
            line(0, 0),
            corner={"within": "100 um"},
            speed="9 m/min",
        ),
        make_axes(),
    )
    check_consistent(plan)
    rows = plan.evaluate(np.linspace(0, plan.duration_s, 50_001))
    for values, limit in ((rows.velocities, 200), (rows.accelerations, 2000), (rows.jerks, 200_000)):
        assert np.abs(values).max() <= limit * 1.001
    assert np.linalg.norm(rows.velocities, axis=1).max() <= 150.0 * 1.0001
    pieces = [each.piece for each in plan.find_stretches()]
    assert pieces == sorted(pieces) and set(pieces) == {1, 2, 3, 4, 5, 6}


def test_stretches_cover_the_path_and_say_what_binds() -> None:
    plan = plan_path(spec(line(100, 0, corner={"within": 0.5}), line(100, 100)), make_axes())
    stretches = plan.find_stretches()
    assert stretches[0].t0_s == 0.0 and stretches[-1].t1_s == pytest.approx(plan.duration_s)
    assert [a.t1_s for a in stretches[:-1]] == [b.t0_s for b in stretches[1:]]
    words = [each.words for each in stretches]
    assert "piece 1: speed of gantry.x, used to 100%" in words
    assert "piece 2: acceleration of gantry.y, used to 100%" in words
    assert any(each.startswith("the corner behind piece 1: jerk of gantry.") for each in words)
    assert max(each.used for each in stretches) <= 1.001


def test_an_outline_in_numbers_is_planned_with_limits_along_it() -> None:
    builder = OutlineBuilder(np.zeros(2))
    builder.add_line(PieceEnd(0), np.array([30.0, 40.0]))
    plan = plan_path(builder.build(), make_axes(), along=AlongLimits(speed=50.0))
    assert plan.length == pytest.approx(50.0)
    assert np.linalg.norm(plan.evaluate(np.array([plan.duration_s / 2])).velocities) == pytest.approx(50.0)
    binding = max(plan.find_stretches(), key=lambda each: each.t1_s - each.t0_s)
    assert binding.words == "piece 1: speed of the path, used to 100%"


FRAME = {"axes": [X, Y], "coordinates": ["u", "v"], "rotation": 90, "scale": [2, 1], "offset": [10, "1 mm"]}


def test_a_frame_maps_coordinates_to_axes() -> None:
    frame = FrameSpec.model_validate(FRAME)
    path = spec(line(20, 0), line(20, 5), frame="plate")
    plan = plan_path(path, make_axes(), {"plate": frame})
    ends = plan.evaluate(np.array([0.0, plan.duration_s])).positions
    assert ends[0] == pytest.approx([10, 1]) and ends[1] == pytest.approx([5, 41])
    assert plan.length == pytest.approx(25.0)  # in coordinates
    assert np.abs(plan.evaluate(np.linspace(0, plan.duration_s, 9999)).velocities).max() <= 200.0 * 1.001
    back = frame.find_coordinates(ends, [Unit.MM, Unit.MM])
    assert back == pytest.approx(np.array([[0, 0], [20, 5]]), abs=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"matrix": [[1, 1], [1, 1]], "rotation": 0, "scale": None}, "must have an inverse"),
        ({"matrix": [[1, 0], [0, 1]]}, "have no meaning"),
        ({"scale": [1]}, "`scale` has 1 entries for 2 axes"),
        ({"coordinates": ["u"]}, "needs 2 different axes"),
        ({"rotation": [1, 2, 3]}, "three coordinates"),
        ({"scale": [0, 1]}, "must have an inverse"),
    ],
)
def test_frames_without_an_inverse_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        FrameSpec.model_validate({**FRAME, **change})


@pytest.mark.parametrize(
    ("pieces", "words"),
    [
        ([line(1, 2, corner={"within": 0})], "rounded by more than 0"),
        ([line(1, 2, corner={"within": "-5 um"})], "rounded by more than 0"),
        ([{"piece": "line", "to": [1]}], "pieces.0.to has 1 values for 2 axes"),
        ([{"piece": "arc", "to": [1, 2]}], "needs either `through`"),
        ([{"piece": "arc", "to": [1, 2], "through": [3, 4], "plane": [X, Y]}], "have no meaning"),
        ([{"piece": "spline", "through": [[1, 2], [3]]}], "pieces.0.through.1 has 1 values"),
        ([{"piece": "table", "t": [0, 1], "positions": [[0, 0]] * 3}], "2 instants and 3 positions"),
        ([{"piece": "table", "t": [0, 2, 1], "positions": [[0, 0]] * 3}], "goes back in time: row 3 is at 1 s"),
        ([{"piece": "table", "t": [0, 0], "positions": [[0, 0]] * 2}], "goes back in time"),
        ([{"piece": "loop"}], "loop"),
    ],
)
def test_specifications_are_refused_by_place(pieces: list[dict[str, Any]], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        spec(*pieces)


def table(t: list[float], *rows: list[float]) -> dict[str, Any]:
    return {"piece": "table", "t": t, "positions": list(rows)}


@pytest.mark.parametrize(
    ("path", "code", "words"),
    [
        (spec(line(10, 0), table([0, 1], [11, 0], [20, 0])), "table-jump", r"piece 2 .*first row is at \(11, 0\)"),
        (
            spec(table([0, 1, 1.01, 2], [0, 0], [1, 0], [50, 0], [51, 0])),
            "table-limit",
            "between rows 2 and 3 gantry.x needs",
        ),
        (spec(line("1 deg", 0)), "bad-unit", "piece 1 .*deg is a unit of angle"),
        (spec(line(1, 0), speed="1 deg/s"), "bad-unit", "`speed` of the path"),
        (spec(line(1, 0), jerk=-1), "bad-limit", "`jerk` of the path is -1"),
        (spec(line(1, 0, corner={"within": "1 deg"}), line(2, 1)), "bad-unit", "`within`"),
        (spec(line(1, 0), frame="plate"), "unknown-frame", "'plate' is not in the fleet file"),
        (spec({"piece": "arc", "to": [2, 0], "centre": [1, 0], "plane": [X, "gantry.z"]}), "no-plane", "not two of"),
        (spec(line(10, 0), line(10, 0)), "zero-length", "piece 2"),
    ],
)
def test_paths_are_refused_by_piece(path: PathSpec, code: str, words: str) -> None:
    with pytest.raises(PathRefusal, match=words) as caught:
        plan_path(path, make_axes())
    assert caught.value.code == code and caught.value.remedy


def test_an_arc_that_leaves_its_plane_is_a_helix() -> None:
    axes = [*make_axes(), PathAxis("gantry.z", Unit.MM, 200.0, 2000.0, 200_000.0)]
    points = {"axes": [X, Y, "gantry.z"], "start": [10, 0, 0]}
    arc = {"piece": "arc", "to": [0, 10, 5], "centre": [0, 0]}
    with pytest.raises(PathRefusal, match=r"leaves its plane gantry\.x and gantry\.y") as caught:
        plan_path(PathSpec.model_validate({**points, "pieces": [arc]}), axes)
    assert "helix" in caught.value.remedy
    plan = plan_path(PathSpec.model_validate({**points, "pieces": [{**arc, "piece": "helix", "turns": 2}]}), axes)
    assert plan.length == pytest.approx(np.hypot(2 * np.pi * 10 * 2.25, 5))
    check_consistent(plan)


@pytest.mark.parametrize(
    "piece",
    [
        {"piece": "arc", "centre": [0, 0], "to": [60, 80], "direction": "cw"},
        {"piece": "arc", "through": [0, 100], "to": [60, 80]},
    ],
)
def test_soft_limits_are_watched_inside_pieces(piece: dict[str, Any]) -> None:
    """Both ends are inside; the top of the arc, at y = 100, is not."""
    path = spec(piece, start=[-60, 80])
    plan_path(path, make_axes(high=100.0))
    with pytest.raises(
        PathRefusal, match=r"piece 1: gantry.y reaches 100 mm at 64.*above its soft limit 99.9"
    ) as caught:
        plan_path(path, make_axes(high=99.9))
    assert (caught.value.code, caught.value.piece) == ("soft-limit", 1)


def test_soft_limits_are_watched_inside_splines_and_tables() -> None:
    with pytest.raises(PathRefusal, match=r"piece 1: gantry.y reaches 10.* above its soft limit 10"):
        plan_path(spec({"piece": "spline", "through": [[2, 10], [4, 10], [6, 0]]}), make_axes(high=10.0))
    rows = table([0, 1, 1.5, 2.5], [0, 0], [10, 10], [14, 10], [24, 0])
    with pytest.raises(PathRefusal, match=r"piece 1 \(table\): gantry.x reaches 24 mm between rows 3 and 4"):
        plan_path(spec(rows), make_axes(high=23.0))
    with pytest.raises(PathRefusal, match=r"piece 1 \(table\): gantry.y reaches .* between rows 2 and 3"):
        plan_path(spec(table([0, 1, 1.5, 2.5], [0, 0], [1, 10], [2, 10], [3, 0])), make_axes(high=10.0))


def test_a_table_goes_through_its_rows_at_its_instants() -> None:
    t = [0.0, 0.7, 1.0, 2.2, 3.0]
    rows = np.array([[0, 0], [5, 1], [8, 4], [8, 20], [2, 21]], dtype=float)
    plan = plan_path(TimedTable(0, np.array(t), rows, rows[0]), make_axes())
    assert plan.duration_s == pytest.approx(3.0)
    assert plan.evaluate(np.array(t)).positions == pytest.approx(rows, abs=1e-9)
    ends = plan.evaluate(np.array([1e-9, 3.0 - 1e-9]))
    assert np.abs(ends.accelerations).max() < 1e-4 and np.abs(ends.velocities).max() < 1e-4
    check_consistent(plan)
    assert [each.words for each in plan.find_stretches()] == ["piece 1: its table"]
    two = plan_path(spec(table([0, 1], [0, 0], [10, 0])), make_axes())
    assert two.evaluate(np.array([0.5])).positions == pytest.approx(np.array([[5.0, 0.0]]), abs=1e-9)


def test_a_table_a_little_too_fast_is_stretched_once() -> None:
    rows = np.array([[0.0, 0.0], [100.0, 0.0]])
    slow = plan_path(TimedTable(0, np.array([0.0, 2.0]), rows, rows[0]), make_axes())
    peak = float(np.abs(slow.evaluate(np.linspace(0, 2, 9999)).velocities).max())
    fast = 2.0 * peak / 200.0  # the time in which the peak is the limit
    plan = plan_path(TimedTable(0, np.array([0.0, fast / 1.005]), rows, rows[0]), make_axes())
    assert plan.duration_s == pytest.approx(fast, rel=1e-6)
    with pytest.raises(PathRefusal, match=r"needs a velocity of 20.*its limit is 200"):
        plan_path(TimedTable(0, np.array([0.0, fast / 1.02]), rows, rows[0]), make_axes())


def test_axes_of_second_order_have_no_jerk_limit() -> None:
    plan = plan_path(spec(line(50, 0), line(50, 50)), make_axes(jerk=None))
    assert plan.duration_s == pytest.approx(0.7)
