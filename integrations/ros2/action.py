"""The action FollowJointTrajectory: three services and two topics, as rcl_action has them."""

import asyncio
import logging
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from integrations.ros2.goals import ABORTED, CANCELED, CANCELING, UNKNOWN, Goal, GoalBook, GoalRunner
from integrations.ros2.joints import Joint, find_read_ns, find_utc_ns, join_ns
from integrations.ros2.messages import CANCEL_GOAL, FEEDBACK, GET_RESULT, LOG, SEND_GOAL, STATUSES, TRAJECTORY
from integrations.ros2.node import Request, RosNode
from integrations.ros2.trajectory import BadGoal, read_goal
from tutti import StateReading, TaskOwner, controller_of

LOGGER = logging.getLogger(__name__)
WARN, ERROR = 30, 40  # levels of rcl_interfaces/Log


class TrajectoryAction:
    """The action at `name`. tolerance: of a path without one, m or rad."""

    def __init__(
        self,
        node: RosNode,
        name: str,
        joints: Mapping[str, Joint],
        tolerance: float,
        runner: GoalRunner,
    ) -> None:
        self._types, self._make, self._name = node.types, node.types.make, name
        self._joints, self._tolerance, self._runner = joints, tolerance, runner
        self._book = GoalBook()
        self._tasks = TaskOwner()
        self._log = node.publish_on("/rosout", LOG, depth=100, kept=True)
        self._statuses = node.publish_on(f"{name}/_action/status", STATUSES, depth=1, kept=True)
        self._feedback = node.publish_on(f"{name}/_action/feedback", FEEDBACK)
        for verb, service, answer in (
            ("send_goal", SEND_GOAL, self._send_goal),
            ("cancel_goal", CANCEL_GOAL, self._cancel_goal),
            ("get_result", GET_RESULT, self._get_result),
        ):
            node.serve(f"{name}/_action/{verb}", service, answer)

    async def close(self) -> None:
        """Stop what the goals move."""
        await self._tasks.end_all()

    def publish_feedback(self, readings: Mapping[str, StateReading], controller: str) -> None:
        """Publish where the axes of goals are, behind a reading of a controller."""
        for goal in self._book.accepted:
            joints = goal.trajectory.joints if goal.trajectory and goal.is_active else []
            members = {controller_of(joint.axis) for joint in joints}
            if controller in members and members <= readings.keys() and self._feedback.is_wanted:
                self._feedback.publish(self._make_feedback(goal, joints, readings, readings[controller]))

    def _make_feedback(
        self, goal: Goal, joints: list[Joint], readings: Mapping[str, StateReading], newest: StateReading
    ) -> Any:
        states = [(readings[controller_of(joint.axis)].axes[joint.axis], joint.size) for joint in joints]
        actual = np.array([state.position * size for state, size in states])
        setpoint = np.array([state.commanded * size for state, size in states])
        read_ns = find_read_ns(newest)
        since_ns = 0 if goal.t0_ns is None or read_ns is None else max(0, read_ns - goal.t0_ns)
        duration = self._types.make_duration(since_ns)
        feedback = self._make(
            f"{TRAJECTORY}_Feedback",
            header=self._types.make_header(find_utc_ns(newest)),
            joint_names=[joint.name for joint in joints],
            desired=self._make_point(setpoint, duration),
            actual=self._make_point(actual, duration),
            error=self._make_point(setpoint - actual, duration),
            multi_dof_joint_names=[],
            **{f"multi_dof_{name}": self._make_no_points() for name in ("desired", "actual", "error")},
        )
        return self._make(FEEDBACK, goal_id=self._make_id(goal.id), feedback=feedback)

    # Services

    def _send_goal(self, request: Request) -> None:
        goal_id, now_ns = request.message.goal_id.uuid.tobytes(), time.time_ns()
        try:
            trajectory = read_goal(request.message.goal, self._joints, now_ns, self._tolerance)
            goal = Goal(goal_id, now_ns, trajectory)
            self._book.add(goal)
        except BadGoal as error:
            if self._book.find(goal_id) is None:
                rejected_goal = Goal(goal_id, now_ns, None, UNKNOWN, error.code, str(error))
                self._book.add(rejected_goal)
            self._write_log(WARN, f"goal {goal_id.hex()} is rejected: {error}")
            self._respond_goal(request, now_ns, accepted=False)
            return
        self._respond_goal(request, now_ns, accepted=True)
        goal.task = self._tasks.spawn(self._runner.run(goal))
        goal.task.add_done_callback(lambda task: self._note_end(goal, task))
        self._publish_statuses()

    def _respond_goal(self, request: Request, now_ns: int, *, accepted: bool) -> None:
        stamp = self._types.make_time(now_ns)
        request.respond(self._make(f"{SEND_GOAL}_Response", accepted=accepted, stamp=stamp))

    def _note_end(self, goal: Goal, task: "asyncio.Task[None]") -> None:
        if goal.is_active:  # by a cancel before it began, or by a defect
            goal.status, goal.text = (CANCELED, "cancelled") if task.cancelled() else (ABORTED, "see the server's log")
        if goal.code:
            self._write_log(ERROR, f"goal {goal.id.hex()} is aborted: {goal.text}")
        for respond in goal.waiting:
            respond(goal)
        goal.waiting.clear()
        self._publish_statuses()

    def _cancel_goal(self, request: Request) -> None:
        info = request.message.goal_info
        code, goals = self._book.find_meant(info.goal_id.uuid.tobytes(), join_ns(info.stamp))
        for goal in goals:
            if goal.status != CANCELING and goal.task is not None:
                goal.status = CANCELING
                goal.task.cancel()
        infos = [self._make_info(goal) for goal in goals]
        request.respond(self._make(f"{CANCEL_GOAL}_Response", return_code=code, goals_canceling=infos))
        if goals:
            self._publish_statuses()

    def _get_result(self, request: Request) -> None:
        def respond(goal: Goal) -> None:
            result = self._make(f"{TRAJECTORY}_Result", error_code=goal.code, error_string=goal.text)
            request.respond(self._make(f"{GET_RESULT}_Response", status=goal.status, result=result))

        goal_id = request.message.goal_id.uuid.tobytes()
        goal = self._book.find(goal_id)
        if goal is None:
            respond(Goal(goal_id, 0, None, UNKNOWN, text="there is no such goal"))
        elif goal.is_active:
            goal.waiting.append(respond)
        else:
            respond(goal)

    # Messages

    def _publish_statuses(self) -> None:
        make = self._make
        statuses = [
            make("action_msgs/msg/GoalStatus", goal_info=self._make_info(goal), status=goal.status)
            for goal in self._book.accepted
        ]
        self._statuses.publish(make(STATUSES, status_list=statuses))

    def _write_log(self, level: int, text: str) -> None:
        LOGGER.warning("%s: %s", self._name, text)
        stamp = self._types.make_time(time.time_ns())
        fields = {"name": self._name, "msg": text, "file": "", "function": "", "line": 0}
        self._log.publish(self._make(LOG, stamp=stamp, level=level, **fields))

    def _make_id(self, goal_id: bytes) -> Any:
        return self._make("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(goal_id, np.uint8))

    def _make_info(self, goal: Goal) -> Any:
        stamp = self._types.make_time(goal.stamp_ns)
        return self._make("action_msgs/msg/GoalInfo", goal_id=self._make_id(goal.id), stamp=stamp)

    def _make_point(self, positions: Any, duration: Any) -> Any:
        empty = np.zeros(0)
        fields = {"velocities": empty, "accelerations": empty, "effort": empty, "time_from_start": duration}
        return self._make("trajectory_msgs/msg/JointTrajectoryPoint", positions=positions, **fields)

    def _make_no_points(self) -> Any:
        fields: dict[str, list[Any]] = {"transforms": [], "velocities": [], "accelerations": []}
        duration = self._types.make_duration(0)
        return self._make("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", **fields, time_from_start=duration)
