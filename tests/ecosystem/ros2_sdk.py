"""An action client made of zenoh-ros2-sdk, which is not ours: services, subscribers, CDR, tokens and hashes are its own.

It knows messages and services, and loads their definitions from the internet; so they are written here, and an action is
three services and two topics, with hashes as rosidl has them for Jazzy.
"""

import threading
import time
import uuid
from collections.abc import Callable
from typing import Any

import numpy as np
from zenoh_ros2_sdk.service_client import ROS2ServiceClient
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.subscriber import ROS2Subscriber
from zenoh_ros2_sdk.utils import compute_service_type_hash, compute_type_hash_from_msg

ACTION = "control_msgs/action/FollowJointTrajectory"
SEND_GOAL_HASH = "RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f"
GET_RESULT_HASH = "RIHS01_e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b"
LIMIT_S = 60.0

TEXTS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
    "float64[] effort\n",
    "unique_identifier_msgs/msg/UUID": "uint8[16] uuid\n",
    "action_msgs/msg/GoalInfo": "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp\n",
    "action_msgs/msg/GoalStatus": "action_msgs/GoalInfo goal_info\nint8 status\n",
    "action_msgs/msg/GoalStatusArray": "action_msgs/GoalStatus[] status_list\n",
    "rcl_interfaces/msg/Log": "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\n"
    "string function\nuint32 line\n",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/msg/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/msg/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "trajectory_msgs/msg/JointTrajectoryPoint": "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\n"
    "float64[] effort\nbuiltin_interfaces/Duration time_from_start\n",
    "trajectory_msgs/msg/JointTrajectory": "std_msgs/Header header\nstring[] joint_names\n"
    "trajectory_msgs/JointTrajectoryPoint[] points\n",
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint": "geometry_msgs/Transform[] transforms\n"
    "geometry_msgs/Twist[] velocities\ngeometry_msgs/Twist[] accelerations\n"
    "builtin_interfaces/Duration time_from_start\n",
    "trajectory_msgs/msg/MultiDOFJointTrajectory": "std_msgs/Header header\nstring[] joint_names\n"
    "trajectory_msgs/MultiDOFJointTrajectoryPoint[] points\n",
    "control_msgs/msg/JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n",
    "control_msgs/msg/JointComponentTolerance": "string joint_name\nuint16 component\nfloat64 position\n"
    "float64 velocity\nfloat64 acceleration\n",
    f"{ACTION}_Goal": "trajectory_msgs/JointTrajectory trajectory\n"
    "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory\n"
    "control_msgs/JointTolerance[] path_tolerance\n"
    "control_msgs/JointComponentTolerance[] component_path_tolerance\n"
    "control_msgs/JointTolerance[] goal_tolerance\n"
    "control_msgs/JointComponentTolerance[] component_goal_tolerance\n"
    "builtin_interfaces/Duration goal_time_tolerance\n",
    f"{ACTION}_Result": "int32 error_code\nstring error_string\n",
    f"{ACTION}_Feedback": "std_msgs/Header header\nstring[] joint_names\n"
    "trajectory_msgs/JointTrajectoryPoint desired\ntrajectory_msgs/JointTrajectoryPoint actual\n"
    "trajectory_msgs/JointTrajectoryPoint error\nstring[] multi_dof_joint_names\n"
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired\n"
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual\n"
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error\n",
    f"{ACTION}_FeedbackMessage": f"unique_identifier_msgs/UUID goal_id\n{ACTION}_Feedback feedback\n",
}


def find_hash(name: str) -> str:
    """The hash of a message, by the SDK's own implementation, which takes the names of types in full."""
    texts = {other: text for other, text in TEXTS.items() if other != name}
    return compute_type_hash_from_msg(name, TEXTS[name], texts)


class Client:
    """Clients of one server at a router on this computer."""

    def __init__(self, port: int, action: str, domain: int = 0) -> None:
        self._place: dict[str, Any] = {"router_port": port, "domain_id": domain}
        self._action = action
        self.session = ZenohSession.get_instance("127.0.0.1", port)
        for name, text in TEXTS.items():
            self.session.register_message_type(text, name)
        uuid_text = "unique_identifier_msgs/UUID goal_id\n"
        self._send_goal = self._open_service(
            "send_goal",
            f"{ACTION}_SendGoal",
            f"{uuid_text}{ACTION}_Goal goal\n",
            "bool accepted\nbuiltin_interfaces/Time stamp\n",
            SEND_GOAL_HASH,
        )
        self._get_result = self._open_service(
            "get_result", f"{ACTION}_GetResult", uuid_text, f"int8 status\n{ACTION}_Result result\n", GET_RESULT_HASH
        )
        info = "action_msgs/GoalInfo goal_info\n"
        infos = "int8 return_code\naction_msgs/GoalInfo[] goals_canceling\n"
        cancel = "action_msgs/srv/CancelGoal"
        known = {name: TEXTS[name] for name in ("action_msgs/msg/GoalInfo", "unique_identifier_msgs/msg/UUID")}
        self._cancel_goal = self._open_service(
            "cancel_goal", cancel, info, infos, compute_service_type_hash(cancel, info, infos, known)
        )

    def _open_service(self, verb: str, service: str, request: str, response: str, type_hash: str) -> ROS2ServiceClient:
        return ROS2ServiceClient(
            f"{self._action}/_action/{verb}",
            service,
            request_definition=request,
            response_definition=response,
            type_hash=type_hash,
            timeout=LIMIT_S,
            **self._place,
        )

    def follow(self, topic: str, name: str, take: Callable[[Any], None]) -> ROS2Subscriber:
        """Subscribe to a topic."""
        return ROS2Subscriber(topic, name, take, msg_definition=TEXTS[name], type_hash=find_hash(name), **self._place)

    def make(self, name: str, /, **fields: Any) -> Any:
        """A message."""
        return self.session.store.types[name](**fields)

    # The action

    def make_goal(
        self,
        joints: list[str],
        points: list[tuple[float, list[float]]] | list[tuple[float, list[float], list[float]]],
        *,
        at_s: float = 0.0,
        path: dict[str, tuple[float, float]] | None = None,
        goal: dict[str, float] | None = None,
        end_s: float = 0.0,
    ) -> Any:
        """A goal. points: time, positions and perhaps velocities. path, goal: tolerances by joint (of a path with one of
        velocity). at_s: since 1970."""
        make, none = self.make, np.zeros(0)
        rows = [
            make(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                positions=np.array(positions),
                velocities=np.array(velocities[0]) if velocities else none,
                accelerations=none,
                effort=none,
                time_from_start=make("builtin_interfaces/msg/Duration", **split(after_s)),
            )
            for after_s, positions, *velocities in points
        ]
        header = make(
            "std_msgs/msg/Header", stamp=make("builtin_interfaces/msg/Time", **split(max(0, at_s))), frame_id=""
        )
        empty = make("std_msgs/msg/Header", stamp=make("builtin_interfaces/msg/Time", **split(0)), frame_id="")
        tolerances = [
            [
                make("control_msgs/msg/JointTolerance", name=name, position=value, velocity=more, acceleration=0.0)
                for name, (value, more) in part.items()
            ]
            for part in (path or {}, {name: (value, 0.0) for name, value in (goal or {}).items()})
        ]
        return make(
            f"{ACTION}_Goal",
            trajectory=make("trajectory_msgs/msg/JointTrajectory", header=header, joint_names=joints, points=rows),
            multi_dof_trajectory=make(
                "trajectory_msgs/msg/MultiDOFJointTrajectory", header=empty, joint_names=[], points=[]
            ),
            path_tolerance=tolerances[0],
            component_path_tolerance=[],
            goal_tolerance=tolerances[1],
            component_goal_tolerance=[],
            goal_time_tolerance=make("builtin_interfaces/msg/Duration", **split(end_s)),
        )

    def send(self, goal: Any, goal_id: bytes | None = None) -> tuple[bytes, bool]:
        """Send a goal; return its id, and whether it is accepted."""
        goal_id = goal_id or uuid.uuid4().bytes
        response = self._send_goal.call(goal_id=self._make_id(goal_id), goal=goal)
        assert response is not None
        return goal_id, response.accepted

    def result(self, goal_id: bytes) -> tuple[int, int, str]:
        """Wait for the status, error code and text of a goal."""
        response = self._get_result.call(goal_id=self._make_id(goal_id))
        assert response is not None
        return response.status, response.result.error_code, response.result.error_string

    def cancel(self, goal_id: bytes) -> tuple[int, int]:
        """Cancel a goal; return the code, and how many goals are being cancelled."""
        stamp = self.make("builtin_interfaces/msg/Time", **split(0))
        info = self.make("action_msgs/msg/GoalInfo", goal_id=self._make_id(goal_id), stamp=stamp)
        response = self._cancel_goal.call(goal_info=info)
        assert response is not None
        return response.return_code, len(response.goals_canceling)

    def query(self, payload: bytes, attachment: bytes | None) -> str:
        """Send bytes to the service that takes goals; return the error that is answered."""
        key, session = self._send_goal.keyexpr, self.session.session
        for reply in session.get(key, payload=payload, attachment=attachment, timeout=LIMIT_S):
            if reply.err is not None:
                return reply.err.payload.to_string()
        return ""

    def ask_goal(self, goal_id: bytes, goal: Any, take: Callable[[Any], None]) -> None:
        """Send a goal without waiting for its reply."""
        service = self._send_goal
        message = service.request_msg_class(goal_id=self._make_id(goal_id), goal=goal)
        payload = bytes(self.session.store.serialize_cdr(message, service.request_store_type))
        attachment = service._create_attachment(1, time.time_ns())
        self.session.session.get(service.keyexpr, take, payload=payload, attachment=attachment, timeout=LIMIT_S)

    def _make_id(self, goal_id: bytes) -> Any:
        return self.make("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(goal_id, np.uint8))


def split(seconds: float) -> dict[str, int]:
    whole_ns = round(seconds * 1e9)
    return {"sec": whole_ns // 10**9, "nanosec": whole_ns % 10**9}


class Messages:
    """The messages of a subscription, as they come."""

    def __init__(self) -> None:
        self.all: list[Any] = []
        self._changed = threading.Condition()

    def __call__(self, message: Any) -> None:
        with self._changed:
            self.all.append(message)
            self._changed.notify_all()

    def wait_for(self, condition: Callable[[Any], bool]) -> Any:
        """The first message that is so. Fails after a generous time."""
        until_s = time.monotonic() + LIMIT_S
        with self._changed:
            while True:
                for message in self.all:
                    if condition(message):
                        return message
                assert self._changed.wait(until_s - time.monotonic()), "no such message"
