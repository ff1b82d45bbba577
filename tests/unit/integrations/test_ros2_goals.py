"""Goals of FollowJointTrajectory as table paths, and which are meant by a request to cancel; without the protocol's
libraries."""

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any, cast

import pytest

from integrations.ros2.goals import (
    ABORTED,
    CANCELED,
    KEPT,
    NO_ERROR,
    REJECTED,
    SUCCEEDED,
    TERMINATED,
    UNKNOWN_GOAL,
    Goal,
    GoalBook,
    GoalRunner,
    find_code,
)
from integrations.ros2.joints import Joint, find_fleet_ns, find_utc_ns, make_joints
from integrations.ros2.settings import RosSettings, fill_settings, make_token
from integrations.ros2.trajectory import (
    GOAL_VIOLATED,
    INVALID_GOAL,
    INVALID_JOINTS,
    OLD_STAMP,
    PATH_VIOLATED,
    BadGoal,
    Trajectory,
    read_goal,
)
from tutti import (
    AxisInfo,
    FollowPath,
    Refusal,
    StateReading,
    StepFailed,
    StepReport,
    TimeInterval,
    Tutti,
    TuttiError,
)

NOW_NS = 1_800_000_000_000_000_000
X, Y = Joint("x", "gantry.x", "mm", 1e-3), Joint("y", "gantry.y", "mm", 1e-3)
TURN = Joint("turn", "table.c", "deg", math.pi / 180, 360.0)
JOINTS = {joint.name: joint for joint in (X, Y, TURN)}


def split(seconds: float) -> SimpleNamespace:
    whole_ns = round(seconds * 1e9)
    return SimpleNamespace(sec=whole_ns // 10**9, nanosec=whole_ns % 10**9)


def point(
    at_s: float, positions: list[float], velocities: Any = (), accelerations: Any = (), effort: Any = ()
) -> SimpleNamespace:
    return SimpleNamespace(
        positions=positions,
        velocities=velocities,
        accelerations=accelerations,
        effort=effort,
        time_from_start=split(at_s),
    )


def tolerance(name: str, position: float, velocity: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=0.0)


def make_goal(names: list[str], *points: Any, stamp_ns: int = 0, **more: Any) -> SimpleNamespace:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9))
    plain: dict[str, Any] = {
        "multi_dof_trajectory": SimpleNamespace(joint_names=[]),
        "path_tolerance": [],
        "component_path_tolerance": [],
        "goal_tolerance": [],
        "component_goal_tolerance": [],
        "goal_time_tolerance": split(0),
    }
    trajectory = SimpleNamespace(header=header, joint_names=names, points=list(points))
    return SimpleNamespace(trajectory=trajectory, **{**plain, **more})


def read(*args: Any, **more: Any) -> Trajectory:
    return read_goal(make_goal(*args, **more), JOINTS, NOW_NS, 1e-3)


def list_rows(path: FollowPath) -> list[tuple[float, list[float]]]:
    piece: Any = path.pieces[0]
    return list(zip(piece.t, piece.positions, strict=True))


# Paths


def test_a_goal_is_a_table_from_where_its_axes_stand_in_their_units() -> None:
    path = read(["y", "x"], point(1.5, [0.02, 0.001])).make_path([4.0, 7.0])
    assert (path.axes, path.start, path.tolerance) == (["gantry.y", "gantry.x"], [4.0, 7.0], 1.0)
    assert list_rows(path) == [(0.0, [4.0, 7.0]), (1.5, [20.0, 1.0])]


def test_a_point_at_the_beginning_is_where_the_axes_stand_within_the_tolerance() -> None:
    trajectory = read(["x"], point(0, [0.004]), point(1, [0.02]), path_tolerance=[tolerance("x", 1e-4)])
    assert list_rows(trajectory.make_path([4.05])) == [(0.0, [4.05]), (1.0, [20.0])]
    with pytest.raises(BadGoal, match=r"joint x stands at 4.2 mm, 0.2 from the point at 0 s") as error:
        trajectory.make_path([4.2])
    assert error.value.code == INVALID_GOAL


@pytest.mark.parametrize(
    ("law", "with_accelerations"),
    [
        (lambda t: (2 * t**2 - t**3 / 3, 4 * t - t**2, 4 - 2 * t), False),
        (lambda t: (t**3 - t**4 / 4 + t**5 / 50, 3 * t**2 - t**3 + t**4 / 10, 6 * t - 3 * t**2 + 2 * t**3 / 5), True),
    ],
    ids=["cubic", "quintic"],
)
def test_between_points_with_velocities_a_table_has_their_polynomial(
    law: Callable[[float], tuple[float, float, float]], *, with_accelerations: bool
) -> None:
    def make_point(at_s: float) -> Any:
        position, velocity, acceleration = (value / 1000 for value in law(at_s))
        return point(at_s, [position], [velocity], [acceleration] if with_accelerations else [])

    rest = point(9.0, [0.0], [0.0], [0.0] if with_accelerations else [])
    rows = list_rows(read(["x"], make_point(1.0), make_point(3.0), rest).make_path([0.0]))
    between = [(at_s, places[0]) for at_s, places in rows if 1.0 <= at_s <= 3.0]
    assert len(between) == 9
    for at_s, place in between:
        assert place == pytest.approx(law(at_s)[0], abs=1e-9)


def test_an_axis_that_wraps_takes_the_turn_that_is_nearest() -> None:
    path = read(["turn"], point(1, [math.radians(350)]), point(2, [math.radians(340)])).make_path([5.0])
    assert [place for _, (place,) in list_rows(path)] == pytest.approx([5.0, -10.0, -20.0])


def test_tolerances_are_in_the_units_of_the_axes() -> None:
    trajectory = read(
        ["x", "turn"],
        point(1, [0.0, 0.0]),
        path_tolerance=[tolerance("x", 2e-4), tolerance("turn", -1.0)],
        goal_tolerance=[tolerance("turn", math.radians(0.5), 1.0), tolerance("x", 0.0)],
        goal_time_tolerance=split(0.25),
    )
    assert (trajectory.tolerance, trajectory.late_s) == (pytest.approx(0.2), 0.25)
    assert trajectory.goal_tolerance == {"table.c": pytest.approx(0.5)}


GOOD = point(1, [0.01])


@pytest.mark.parametrize(
    ("goal", "code", "said"),
    [
        (make_goal([], GOOD), INVALID_JOINTS, "no joint"),
        (make_goal(["q"], GOOD), INVALID_JOINTS, "unknown joints: q; there are: x, y, turn"),
        (make_goal(["x", "x"], point(1, [0, 0])), INVALID_JOINTS, "one twice"),
        (make_goal(["x"]), INVALID_GOAL, "0 points"),
        (make_goal(["x"], GOOD, GOOD), INVALID_GOAL, "point 2 is at 1 s; times must increase"),
        (make_goal(["x"], point(-1, [0.0])), INVALID_GOAL, "times must increase"),
        (make_goal(["x"], point(0, [0.0])), INVALID_GOAL, "its only point is at 0 s"),
        (make_goal(["x"], point(1, [0.0, 1.0])), INVALID_GOAL, "2 positions for 1 joints"),
        (make_goal(["x"], point(1, [])), INVALID_GOAL, "0 positions for 1 joints"),
        (make_goal(["x"], point(1, [0.0], [0.0, 0.0])), INVALID_GOAL, "2 velocities"),
        (make_goal(["x"], point(1, [math.nan])), INVALID_GOAL, "positions that are not finite"),
        (make_goal(["x"], point(1, [0.0], [0.0], [math.inf])), INVALID_GOAL, "accelerations that are not finite"),
        (make_goal(["x"], point(1, [0.0], effort=[1.0])), INVALID_GOAL, "effort"),
        (make_goal(["x"], point(1, [0.0], [0.1])), INVALID_GOAL, "velocities at 1 s are not 0"),
        (make_goal(["x"], point(0, [0.0], [0.1]), GOOD), INVALID_GOAL, "velocities at 0 s are not 0"),
        (make_goal(["x"], GOOD, stamp_ns=NOW_NS - 10**9), OLD_STAMP, "1.000 s in the past"),
        (make_goal(["x"], GOOD, stamp_ns=NOW_NS + 601 * 10**9), INVALID_GOAL, "601 s ahead"),
        (make_goal(["x"], GOOD, path_tolerance=[tolerance("y", 1)]), INVALID_JOINTS, "path tolerance of y"),
        (make_goal(["x"], GOOD, path_tolerance=[tolerance("x", 1, 1)]), INVALID_GOAL, "are not watched"),
        (make_goal(["x"], GOOD, goal_tolerance=[tolerance("x", math.nan)]), INVALID_GOAL, "goal tolerance of x"),
        (make_goal(["x"], GOOD, component_path_tolerance=[1]), INVALID_GOAL, "several degrees of freedom"),
    ],
)
def test_a_bad_goal_is_refused_with_its_code(goal: Any, code: int, said: str) -> None:
    with pytest.raises(BadGoal, match=said) as error:
        read_goal(goal, JOINTS, NOW_NS, 1e-3)
    assert error.value.code == code


def test_a_stamp_in_the_future_is_kept() -> None:
    assert read(["x"], GOOD, stamp_ns=NOW_NS + 1).stamp_ns == NOW_NS + 1


# Goals


def make_entry(number: int, *names: str, stamp_ns: int = 0) -> Goal:
    points = point(1, [0.0] * len(names))
    return Goal(bytes([number]) * 16, stamp_ns, read(list(names), points) if names else None)


def test_an_axis_is_on_one_goal_at_a_time() -> None:
    book, first = GoalBook(), make_entry(1, "x", "y")
    book.add(first)
    with pytest.raises(BadGoal, match=r"gantry.y: goal 01"):
        book.add(make_entry(2, "y"))
    book.add(make_entry(3, "turn"))
    first.status = SUCCEEDED
    book.add(make_entry(2, "y"))
    with pytest.raises(BadGoal, match="of this id"):
        book.add(make_entry(2, "x"))


def test_what_a_request_to_cancel_means() -> None:
    """The rules stand in action_msgs/srv/CancelGoal."""
    book = GoalBook()
    early, late, ended = make_entry(1, "x", stamp_ns=10), make_entry(2, "y", stamp_ns=20), make_entry(3, "turn")
    ended.status = SUCCEEDED
    for goal in (ended, early, late, make_entry(4)):
        book.add(goal)
    none = bytes(16)
    assert book.find_meant(none, 0) == (NO_ERROR, [early, late])
    assert book.find_meant(none, 15) == (NO_ERROR, [early])
    assert book.find_meant(none, 5) == (REJECTED, [])
    assert book.find_meant(late.id, 0) == (NO_ERROR, [late])
    assert book.find_meant(late.id, 15) == (NO_ERROR, [early, late])
    assert book.find_meant(ended.id, 0) == (TERMINATED, [])
    assert book.find_meant(b"?" * 16, 0) == (UNKNOWN_GOAL, [])
    assert book.find_meant(bytes([4]) * 16, 0) == (UNKNOWN_GOAL, [])  # it was rejected


def test_goals_that_are_rejected_do_not_displace_results() -> None:
    book, kept = GoalBook(), make_entry(1, "x")
    kept.status = ABORTED
    book.add(kept)
    for number in range(3 * KEPT):
        book.add(Goal(number.to_bytes(16, "big"), 0, None, CANCELED))
    assert book.find(kept.id) is kept
    assert book.find((3 * KEPT - 1).to_bytes(16, "big")) is not None
    assert book.find(bytes(16)) is None


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (Refusal("too-near", ""), OLD_STAMP),
        (Refusal("path-error", ""), PATH_VIOLATED),
        (Refusal("estop", ""), INVALID_GOAL),
        (TuttiError(), INVALID_GOAL),
    ],
)
def test_codes_of_what_is_refused_before_anything_moves(error: TuttiError, code: int) -> None:
    assert find_code(error) == code
    assert code != GOAL_VIOLATED


def make_step(**more: Any) -> StepReport:
    return StepReport(index=0, do="path", name="", state="done", planned_s=1.0, actual_s=1.0, **more)


class FakeFleet:
    """A fleet whose path is done as `outcome` says. commanded: where its axis stands."""

    def __init__(self, outcome: StepReport | TuttiError, position: float = 20.0) -> None:
        self.outcome = outcome
        self.position = position
        self.steps: list[FollowPath] = []
        self.starts: list[int | None] = []

    @asynccontextmanager
    async def live(self, *_: Any, **__: Any) -> AsyncGenerator["FakeFleet"]:
        yield self

    async def axes(self) -> dict[str, Any]:
        return {"gantry.x": SimpleNamespace(commanded=4.0, position=self.position)}

    async def arm(self, step: FollowPath, *, timeout_s: float) -> "FakeFleet":
        assert timeout_s > 0
        self.steps.append(step)
        return self

    async def go(self) -> int:
        return await self.go_at(None)

    async def go_at(self, at_ns: int | None) -> int:
        self.starts.append(at_ns)
        return at_ns or 1

    async def wait(self) -> StepReport:
        if isinstance(self.outcome, TuttiError):
            raise self.outcome
        return self.outcome


def run_goal(fleet: FakeFleet, stamp_ns: int = 0, **more: Any) -> Goal:
    utc = datetime.fromtimestamp(NOW_NS / 10**9, UTC).isoformat()
    readings = {"gantry": StateReading("gantry", "idle", {}, TimeInterval(earliest_ns=5, latest_ns=5), utc, None, 0)}
    goal = Goal(b"1" * 16, NOW_NS, read(["x"], point(1, [0.02]), stamp_ns=stamp_ns, **more))
    asyncio.run(GoalRunner(cast("Tutti", fleet), readings).run(goal))
    return goal


def test_a_goal_starts_at_once_or_at_the_fleet_time_of_its_stamp() -> None:
    fleet = FakeFleet(make_step())
    assert (run_goal(fleet).status, run_goal(fleet, NOW_NS + 1000).t0_ns) == (SUCCEEDED, 1005)
    assert fleet.starts == [None, 1005]
    assert fleet.steps[0].start == [4.0]


@pytest.mark.parametrize(
    ("fleet", "code", "said"),
    [
        (FakeFleet(make_step(), 20.2), GOAL_VIOLATED, "x is 0.2 mm from its goal; 0.1 are allowed"),
        (FakeFleet(make_step().model_copy(update={"actual_s": 1.3})), GOAL_VIOLATED, "ended 0.3 s late; 0.02 s"),
        (FakeFleet(StepFailed(make_step(t0_fleet_ns=7, reason="e-stop"))), PATH_VIOLATED, "e-stop"),
        (FakeFleet(StepFailed(make_step(reason="e-stop"))), INVALID_GOAL, "e-stop"),
        (FakeFleet(Refusal("too-near", "at 5 s", "later")), OLD_STAMP, "at 5 s; later"),
    ],
)
def test_a_goal_that_is_not_reached_has_a_code_and_a_reason(fleet: FakeFleet, code: int, said: str) -> None:
    goal = run_goal(fleet, goal_tolerance=[tolerance("x", 1e-4)], goal_time_tolerance=split(0.02))
    assert (goal.status, goal.code, said in goal.text) == (ABORTED, code, True), goal.text


# Times, names, settings


def test_fleet_time_at_an_instant_of_utc() -> None:
    utc = "2026-05-04T12:00:00.250000Z"
    reading = StateReading("gantry", "idle", {}, TimeInterval(earliest_ns=90, latest_ns=110), utc, None, 0)
    at_ns = find_utc_ns(reading)
    assert at_ns % 10**9 == 250_000_000
    assert find_fleet_ns(reading, at_ns + 7) == 107
    assert find_fleet_ns(StateReading("gantry", "offline", {}, None, utc, None, 0), at_ns) is None


def make_info(name: str, unit: str, si_size: float | None) -> AxisInfo:
    numbers = {"resolution": 1.0, "digits": 0, "least": None, "most": None, "velocity": 1.0, "acceleration": 1.0}
    texts = {"make": "m", "motor": "X", "kind": "linear", "description": "", "retarget": "none"}
    plain: dict[str, Any] = {**numbers, **texts, "jerk": None, "wrap": None, "referenced": True}
    return AxisInfo(name=name, unit=unit, si_size=si_size, **plain)


def test_joints_are_axes_of_a_length_or_an_angle_with_names() -> None:
    infos = [make_info("a.x", "mm", 1e-3), make_info("a.y", "um", 1e-6), make_info("a.n", "counts", None)]
    joints = make_joints(infos, {"slide": "a.y"})
    assert {name: (joint.axis, joint.size) for name, joint in joints.items()} == {
        "a.x": ("a.x", 1e-3),
        "slide": ("a.y", 1e-6),
    }
    for names, said in (
        ({"slide": "a.z"}, "no axis of the fleet: a.z"),
        ({"p": "a.x", "q": "a.x"}, "named twice"),
        ({"a.y": "a.x"}, "the same name"),
    ):
        with pytest.raises(Refusal, match=said):
            make_joints(infos, names)


def test_options_win_over_the_fleet_file() -> None:
    section: dict[str, Any] = {"domain": 7, "namespace": "cell/left", "joints": {"a": "g.x", "b": "g.y"}}
    assert fill_settings(RosSettings(""), {}, "line-2") == (0, "line_2", {})
    assert fill_settings(RosSettings(""), section, "f") == (7, "cell/left", {"a": "g.x", "b": "g.y"})
    options = RosSettings("", 0, "", {"b": "g.z"})
    assert fill_settings(options, section, "f") == (0, "", {"a": "g.x", "b": "g.z"})
    assert make_token("2-axes") == "_2_axes"


@pytest.mark.parametrize(
    "section", [{"domain": 233}, {"domain": "x"}, {"namespace": "a b"}, {"joints": ["a"]}, {"topic": "/x"}]
)
def test_a_bad_section_of_the_fleet_file_is_refused(section: dict[str, Any]) -> None:
    with pytest.raises(Refusal, match="integrations: ros2:"):
        fill_settings(RosSettings(""), section, "f")
