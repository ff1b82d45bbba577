"""What a FollowJointTrajectory goal asks for, checked, and as a table path. It knows no protocol library."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

from integrations.ros2.joints import NS_PER_S, Joint, is_finite, join_ns
from tutti import FollowPath, TuttiError

INVALID_GOAL, INVALID_JOINTS, OLD_STAMP, PATH_VIOLATED, GOAL_VIOLATED = range(-1, -6, -1)
"""Error codes of the action."""

MAX_POINTS = 10_000
MAX_AHEAD_S = 600
SAMPLES, LEAST_SAMPLE_S = 8, 0.01  # between two points with velocities, at most and at least


class BadGoal(TuttiError):
    """A goal that is not carried out. code: of the action."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True, slots=True)
class Row:
    """A point: positions, and derivatives of all joints or none, in the units of the axes."""

    at_s: float
    positions: list[float]
    velocities: list[float] = field(default_factory=list[float])
    accelerations: list[float] = field(default_factory=list[float])


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A goal that was checked. stamp_ns: of its start, since 1970; 0: as soon as possible. tolerance: of the path, in
    the unit of the first axis. goal_tolerance: by axis, in its unit. late_s: how late it may end; 0: not stated."""

    joints: list[Joint]
    rows: list[Row]
    stamp_ns: int
    tolerance: float
    goal_tolerance: dict[str, float]
    late_s: float

    @property
    def axes(self) -> list[str]:
        """The axes, in the order of the joints."""
        return [joint.axis for joint in self.joints]

    def make_path(self, starts: Sequence[float]) -> FollowPath:
        """The table path from where the axes stand. Raises `BadGoal` if a point at 0 s is somewhere else."""
        begin, turns = self.rows[0], list[float]()
        for joint, start, position in zip(self.joints, starts, begin.positions, strict=True):
            turns.append(joint.find_nearest(position, start) - position)
            off = abs(position + turns[-1] - start)
            if begin.at_s == 0 and off > self.tolerance * self.joints[0].size / joint.size:
                text = f"joint {joint.name} stands at {start:.6g} {joint.unit}, {off:.6g} from the point at 0 s"
                raise BadGoal(INVALID_GOAL, text)
        zeros = [0.0] * len(starts)
        rows = [Row(0.0, list(starts), zeros, zeros)]
        for row in self.rows[1 if begin.at_s == 0 else 0 :]:
            rows.append(replace(row, positions=[p + t for p, t in zip(row.positions, turns, strict=True)]))
        table = list(sample(rows))
        piece = {"piece": "table", "t": [at_s for at_s, _ in table], "positions": [positions for _, positions in table]}
        return FollowPath(axes=self.axes, tolerance=self.tolerance, start=list(starts), pieces=[piece])


def read_goal(goal: Any, joints: Mapping[str, Joint], now_ns: int, tolerance: float) -> Trajectory:
    """Check a goal. now_ns: since 1970. tolerance: of the path without one, m or rad. Raises `BadGoal`."""
    trajectory = goal.trajectory
    goal_joints = find_joints(trajectory.joint_names, joints)
    if goal.multi_dof_trajectory.joint_names or goal.component_path_tolerance or goal.component_goal_tolerance:
        raise BadGoal(INVALID_GOAL, "joints of several degrees of freedom are not there; leave them out")
    rows = read_points(trajectory.points, goal_joints)
    stamp_ns = join_ns(trajectory.header.stamp)
    ahead_s = (stamp_ns - now_ns) / NS_PER_S
    if stamp_ns and ahead_s < 0:
        text = f"the stamp is {-ahead_s:.3f} s in the past by the clock of this server; give one in the future, or 0"
        raise BadGoal(OLD_STAMP, text)
    if ahead_s > MAX_AHEAD_S:
        raise BadGoal(INVALID_GOAL, f"the stamp is {ahead_s:.0f} s ahead; at most {MAX_AHEAD_S} s are waited for")
    by_name = {joint.name: joint for joint in goal_joints}
    path_tolerances = list(read_tolerances(goal.path_tolerance, by_name, "path"))
    for part, (_, _, more) in zip(goal.path_tolerance, path_tolerances, strict=True):
        if any(value > 0 for value in more):
            text = f"path tolerance of {part.name}: velocity and acceleration are not watched; leave them 0"
            raise BadGoal(INVALID_GOAL, text)
    goal_tolerances = read_tolerances(goal.goal_tolerance, by_name, "goal")
    most = min((value for _, value, _ in path_tolerances if value > 0), default=tolerance)
    return Trajectory(
        goal_joints,
        rows,
        stamp_ns,
        most / goal_joints[0].size,
        {joint.axis: value / joint.size for joint, value, _ in goal_tolerances if value > 0},
        max(0.0, join_ns(goal.goal_time_tolerance) / NS_PER_S),
    )


def find_joints(names: Sequence[str], joints: Mapping[str, Joint]) -> list[Joint]:
    """The joints of a goal. Raises `BadGoal`."""
    unknown_names = [name for name in names if name not in joints]
    if not names or unknown_names or len(set(names)) < len(names):
        text = f"unknown joints: {', '.join(unknown_names)[:200]}" if unknown_names else "no joint, or one twice"
        raise BadGoal(INVALID_JOINTS, f"{text}; there are: {', '.join(joints)[:500]}")
    return [joints[name] for name in names]


def read_points(points: Sequence[Any], joints: Sequence[Joint]) -> list[Row]:
    """The points, in the units of the axes. Raises `BadGoal`."""
    if not 1 <= len(points) <= MAX_POINTS:
        raise BadGoal(INVALID_GOAL, f"{len(points)} points; give 1 to {MAX_POINTS}")
    rows = [read_point(number, point, joints) for number, point in enumerate(points, 1)]
    for number, row in enumerate(rows):
        if row.at_s < 0 or (number and row.at_s <= rows[number - 1].at_s):
            text = f"point {number + 1} is at {row.at_s:.9g} s; times must increase, from 0 or later"
            raise BadGoal(INVALID_GOAL, text)
    for row in (rows[-1], *(rows[:1] if rows[0].at_s == 0 else [])):
        if any(row.velocities):
            raise BadGoal(INVALID_GOAL, f"velocities at {row.at_s:g} s are not 0: it begins and ends at rest")
    if rows[-1].at_s == 0:
        raise BadGoal(INVALID_GOAL, "its only point is at 0 s; give the time at which it is to be reached")
    return rows


def read_point(number: int, point: Any, joints: Sequence[Joint]) -> Row:
    """A point, in the units of the axes. Raises `BadGoal`."""
    values: list[list[float]] = []
    for name in ("positions", "velocities", "accelerations"):
        part = getattr(point, name)
        if len(part) != len(joints) and (len(part) or name == "positions"):
            text = f"point {number} has {len(part)} {name} for {len(joints)} joints; give one for each"
            raise BadGoal(INVALID_GOAL, text)
        if not is_finite(part):
            raise BadGoal(INVALID_GOAL, f"point {number} has {name} that are not finite")
        values.append([float(value) / joint.size for value, joint in zip(part, joints, strict=False)])
    if len(point.effort):
        raise BadGoal(INVALID_GOAL, f"point {number} has effort; only positions are followed")
    return Row(join_ns(point.time_from_start) / NS_PER_S, *values)


def read_tolerances(
    tolerances: Sequence[Any], joints: Mapping[str, Joint], what: str
) -> Iterator[tuple[Joint, float, tuple[float, float]]]:
    """The joint, position (m, rad) and further tolerances of each. Raises `BadGoal`."""
    for part in tolerances:
        if part.name not in joints:
            raise BadGoal(INVALID_JOINTS, f"{what} tolerance of {part.name[:80]}, which is no joint of the goal")
        if not is_finite((part.position, part.velocity, part.acceleration)):
            raise BadGoal(INVALID_GOAL, f"{what} tolerance of {part.name} is not finite")
        yield joints[part.name], part.position, (part.velocity, part.acceleration)


def sample(rows: Sequence[Row]) -> Iterator[tuple[float, list[float]]]:
    """The instants and positions of a table: the points, and between points with velocities what the controller of
    ros2_control interpolates: a cubic, with accelerations a quintic."""
    yield rows[0].at_s, rows[0].positions
    for begin, end in pairwise(rows):
        span_s = end.at_s - begin.at_s
        parts = min(SAMPLES, max(1, int(span_s / LEAST_SAMPLE_S))) if begin.velocities and end.velocities else 1
        for part in range(1, parts):
            share = part / parts
            positions = [interpolate(share, span_s, begin, end, k) for k in range(len(end.positions))]
            yield begin.at_s + share * span_s, positions
        yield end.at_s, end.positions


def interpolate(share: float, span_s: float, begin: Row, end: Row, k: int) -> float:
    """The position of joint `k` at a share of the time between two points with velocities."""
    start, way = begin.positions[k], end.positions[k] - begin.positions[k]
    v0, v1 = begin.velocities[k] * span_s, end.velocities[k] * span_s
    if not begin.accelerations or not end.accelerations:
        return start + share * (v0 + share * (3 * way - 2 * v0 - v1 + share * (v0 + v1 - 2 * way)))
    a0, a1 = begin.accelerations[k] * span_s**2 / 2, end.accelerations[k] * span_s**2 / 2
    third = 10 * way - 6 * v0 - 4 * v1 - 3 * a0 + a1
    fourth = -15 * way + 8 * v0 + 7 * v1 + 3 * a0 - 2 * a1
    fifth = 6 * way - 3 * v0 - 3 * v1 - a0 + a1
    return start + share * (v0 + share * (a0 + share * (third + share * (fourth + share * fifth))))
