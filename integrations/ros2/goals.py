"""Goals of the action, and how each is run as a live job. It knows no protocol library."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from integrations.ros2.joints import NS_PER_S, find_fleet_ns
from integrations.ros2.trajectory import GOAL_VIOLATED, INVALID_GOAL, OLD_STAMP, PATH_VIOLATED, BadGoal, Trajectory
from integrations.whole_fleet import describe
from tutti import JobFailed, Refusal, StateReading, StepFailed, StepReport, Tutti, TuttiError, controller_of

UNKNOWN, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 0, 2, 3, 4, 5, 6
"""States of action_msgs/GoalStatus."""

NO_ERROR, REJECTED, UNKNOWN_GOAL, TERMINATED = range(4)
"""Return codes of action_msgs/CancelGoal."""

KEPT = 100  # goals that were accepted, and as many that were rejected
ARMED_MORE_S = 30.0  # for which it waits armed beyond its instant
SETTLE_S = 1.0  # for the tolerance of the goal, without a time of its own
LOOK_S = 0.05


@dataclass(slots=True)
class Goal:
    """A goal. stamp_ns: of its acceptance, since 1970. trajectory: None of one that was rejected. t0_ns: of its motion,
    fleet time, once it is agreed. code, text: its result. waiting: called with it once it has ended."""

    id: bytes
    stamp_ns: int
    trajectory: Trajectory | None
    status: int = EXECUTING
    code: int = 0
    text: str = ""
    t0_ns: int | None = None
    waiting: "list[Callable[[Goal], None]]" = field(default_factory=list["Callable[[Goal], None]"])
    task: "asyncio.Task[None] | None" = None

    @property
    def is_active(self) -> bool:
        """Whether it has not ended."""
        return self.status in (EXECUTING, CANCELING)


class GoalBook:
    """All goals: those that run, and the last that have ended or were rejected."""

    def __init__(self) -> None:
        self._goals: dict[bytes, Goal] = {}

    @property
    def accepted(self) -> list[Goal]:
        """Those that were accepted, oldest first."""
        return [goal for goal in self._goals.values() if goal.trajectory is not None]

    def find(self, goal_id: bytes) -> Goal | None:
        """A goal by its id."""
        return self._goals.get(goal_id)

    def add(self, goal: Goal) -> None:
        """Add a goal. Raises `BadGoal` for one that uses an axis of another, or its id."""
        if goal.id in self._goals:
            raise BadGoal(INVALID_GOAL, "there is a goal of this id already")
        wanted_axes = set(goal.trajectory.axes) if goal.trajectory else set[str]()
        for entry in self.accepted:
            used_axes = wanted_axes.intersection(entry.trajectory.axes if entry.trajectory else ())
            if entry.is_active and used_axes:
                text = f"{', '.join(sorted(used_axes))}: goal {entry.id.hex()} is on it; cancel that one, or wait"
                raise BadGoal(INVALID_GOAL, text)
        self._goals[goal.id] = goal
        is_rejected = goal.trajectory is None
        goals = [entry for entry in self._goals.values() if (entry.trajectory is None) == is_rejected]
        for entry in goals[:-KEPT]:
            if not entry.is_active:
                del self._goals[entry.id]

    def find_meant(self, goal_id: bytes, stamp_ns: int) -> tuple[int, list[Goal]]:
        """The goals that a request to cancel means, and the return code: by the rules of action_msgs/CancelGoal."""
        active = [goal for goal in self.accepted if goal.is_active]
        if not any(goal_id):
            goals = [goal for goal in active if not stamp_ns or goal.stamp_ns <= stamp_ns]
            return (NO_ERROR if goals else REJECTED), goals
        goals = [goal for goal in active if goal.id == goal_id or (stamp_ns and goal.stamp_ns <= stamp_ns)]
        if goals:
            return NO_ERROR, goals
        return (TERMINATED if goal_id in {goal.id for goal in self.accepted} else UNKNOWN_GOAL), []


class GoalRunner:
    """Runs goals on a fleet. readings: the newest of each controller."""

    def __init__(self, tutti: Tutti, readings: Mapping[str, StateReading]) -> None:
        self._tutti = tutti
        self._readings = readings

    async def run(self, goal: Goal) -> None:
        """Run a goal to its end, and note it; a cancelled task stops its axes."""
        assert goal.trajectory is not None
        try:
            goal.text = await self._move(goal, goal.trajectory)
            goal.status = SUCCEEDED
        except BadGoal as error:
            goal.status, goal.code, goal.text = ABORTED, error.code, str(error)
        except TuttiError as error:
            goal.status, goal.code, goal.text = ABORTED, find_code(error), describe(error)
        except asyncio.CancelledError:
            goal.status, goal.text = CANCELED, "cancelled"
            raise

    async def _move(self, goal: Goal, trajectory: Trajectory) -> str:
        """Move along a trajectory; return what is known of how that went."""
        async with self._tutti.live(trajectory.axes, name=f"ROS 2 goal {goal.id.hex()[:8]}") as live:
            axes = await self._tutti.axes()
            path = trajectory.make_path([axes[axis].commanded for axis in trajectory.axes])
            reading = self._readings.get(controller_of(trajectory.axes[0]))
            at_ns = find_fleet_ns(reading, trajectory.stamp_ns) if reading and trajectory.stamp_ns else None
            if trajectory.stamp_ns and at_ns is None:
                raise BadGoal(OLD_STAMP, "the time of the fleet is not known; send it with a stamp of 0")
            ahead_s = max(0, trajectory.stamp_ns - goal.stamp_ns) / NS_PER_S
            armed_move = await live.arm(path, timeout_s=ahead_s + ARMED_MORE_S)
            goal.t0_ns = await (armed_move.go() if at_ns is None else armed_move.go_at(at_ns))
            report = await armed_move.wait()
        late_s = (report.actual_s or 0.0) - (report.planned_s or 0.0)
        if trajectory.late_s and late_s > trajectory.late_s:
            raise BadGoal(GOAL_VIOLATED, f"it has ended {late_s:.3g} s late; {trajectory.late_s:.3g} s are allowed")
        await self._wait_until_there(trajectory)
        return describe_report(report)

    async def _wait_until_there(self, trajectory: Trajectory) -> None:
        """Wait until all joints are within the tolerances of the goal. Raises `BadGoal`."""
        until_s = asyncio.get_running_loop().time() + (trajectory.late_s or SETTLE_S)
        while trajectory.goal_tolerance:
            axes = await self._tutti.axes()
            misses: list[str] = []
            for joint, target in zip(trajectory.joints, trajectory.rows[-1].positions, strict=True):
                most, position = trajectory.goal_tolerance.get(joint.axis), axes[joint.axis].position
                off = abs(joint.find_nearest(target, position) - position)
                if most is not None and off > most:
                    misses.append(f"{joint.name} is {off:.6g} {joint.unit} from its goal; {most:.6g} are allowed")
            if not misses:
                return
            if asyncio.get_running_loop().time() > until_s:
                raise BadGoal(GOAL_VIOLATED, "; ".join(misses))
            await asyncio.sleep(LOOK_S)


def find_code(error: TuttiError) -> int:
    """The code of the action for what was refused, or has ended the motion of a goal."""
    if isinstance(error, Refusal):
        codes = {"too-near": OLD_STAMP, "too-late": OLD_STAMP, "path-error": PATH_VIOLATED}
        return codes.get(error.code, INVALID_GOAL)
    steps = (
        [error.report] if isinstance(error, StepFailed) else error.report.steps if isinstance(error, JobFailed) else []
    )
    return PATH_VIOLATED if any(step.t0_fleet_ns is not None for step in steps) else INVALID_GOAL


def describe_report(report: StepReport) -> str:
    """The bound of the path and the budget of the start, in a line."""
    parts: list[Any] = [f"{report.planned_s or 0.0:.3f} s planned, {report.actual_s or 0.0:.3f} s taken"]
    bound = report.path.bound if report.path else None
    if bound is not None:
        largest = f"{bound.largest.name} {bound.largest.member}".strip()
        parts.append(f"at most {bound.predicted:.3g} {bound.unit} off the path, most by {largest}")
        parts.append(f"the tolerance is {bound.tolerance:.3g} {bound.unit}")
        if bound.proven is not None:
            parts.append(f"by evidence at most {bound.proven:.3g} {bound.unit}")
    if report.budget is not None:
        parts.append(f"start skew at most {report.budget.predicted_ns / 1e6:.3g} ms")
    return "; ".join([*parts, f"verdict {report.verdict}", *report.deviations])
