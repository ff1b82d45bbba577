"""Types of messages: their names, hashes and CDR.

Fields are those of ROS 2 Jazzy: rosbags has the common packages; those of control_msgs 5.8.0 (branch jazzy) and of the
services of an action (rosidl) are written here. Hashes: REP 2016 (RIHS01); a service is a type with a request, a
response and an event.
"""

from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from integrations.ros2.joints import split_ns

TRAJECTORY = "control_msgs/action/FollowJointTrajectory"
SEND_GOAL, GET_RESULT, CANCEL_GOAL = f"{TRAJECTORY}_SendGoal", f"{TRAJECTORY}_GetResult", "action_msgs/srv/CancelGoal"
FEEDBACK, STATUSES = f"{TRAJECTORY}_FeedbackMessage", "action_msgs/msg/GoalStatusArray"
JOINT_STATE, LOG = "sensor_msgs/msg/JointState", "rcl_interfaces/msg/Log"

_EVENT_INFO = "service_msgs/msg/ServiceEventInfo"
_TOLERANCE = "float64 position\nfloat64 velocity\nfloat64 acceleration\n"
_POINT, _POINTS = "trajectory_msgs/JointTrajectoryPoint", "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_TEXTS = {
    # rosbags has `char[16]`, which a hash takes for what it is in ROS: uint8.
    _EVENT_INFO: "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number\n",
    "control_msgs/msg/JointTolerance": f"string name\n{_TOLERANCE}",
    "control_msgs/msg/JointComponentTolerance": f"string joint_name\nuint16 component\n{_TOLERANCE}",
    f"{TRAJECTORY}_Goal": "trajectory_msgs/JointTrajectory trajectory\n"
    "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory\n"
    "control_msgs/JointTolerance[] path_tolerance\n"
    "control_msgs/JointComponentTolerance[] component_path_tolerance\n"
    "control_msgs/JointTolerance[] goal_tolerance\n"
    "control_msgs/JointComponentTolerance[] component_goal_tolerance\n"
    "builtin_interfaces/Duration goal_time_tolerance\n",
    f"{TRAJECTORY}_Result": "int32 error_code\nstring error_string\n",
    f"{TRAJECTORY}_Feedback": f"std_msgs/Header header\nstring[] joint_names\n{_POINT} desired\n{_POINT} actual\n"
    f"{_POINT} error\nstring[] multi_dof_joint_names\n{_POINTS} multi_dof_desired\n{_POINTS} multi_dof_actual\n"
    f"{_POINTS} multi_dof_error\n",
    FEEDBACK: f"unique_identifier_msgs/UUID goal_id\n{TRAJECTORY}_Feedback feedback\n",
    f"{SEND_GOAL}_Request": f"unique_identifier_msgs/UUID goal_id\n{TRAJECTORY}_Goal goal\n",
    f"{SEND_GOAL}_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
    f"{GET_RESULT}_Request": "unique_identifier_msgs/UUID goal_id\n",
    f"{GET_RESULT}_Response": f"int8 status\n{TRAJECTORY}_Result result\n",
    f"{CANCEL_GOAL}_Request": "action_msgs/GoalInfo goal_info\n",
    f"{CANCEL_GOAL}_Response": "int8 return_code\naction_msgs/GoalInfo[] goals_canceling\n",
}


class MessageTypes:
    """The types of messages, each by its name `package/kind/Name`."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._store.fielddefs.pop(_EVENT_INFO)
        for name, text in _TEXTS.items():
            # rosbags gives services names of its own.
            (definition,) = get_types_from_msg(text, name).values()
            self._store.register({name: definition})
        for service in (SEND_GOAL, GET_RESULT, CANCEL_GOAL):
            request, response, event = (f"{service}_{part}" for part in ("Request", "Response", "Event"))
            self._store.fielddefs[event] = (
                [],
                [
                    ("info", (Nodetype.NAME, _EVENT_INFO)),
                    *(
                        (part, (Nodetype.SEQUENCE, ((Nodetype.NAME, name), 1)))
                        for part, name in (("request", request), ("response", response))
                    ),
                ],
            )
            parts = (("request_message", request), ("response_message", response), ("event_message", event))
            self._store.fielddefs[service] = ([], [(part, (Nodetype.NAME, name)) for part, name in parts])

    def make(self, name: str, /, **fields: Any) -> Any:
        """A message of a type."""
        return self._store.types[name](**fields)

    def make_time(self, at_ns: int) -> Any:
        """An instant, ns since 1970."""
        return self.make("builtin_interfaces/msg/Time", **split_ns(at_ns))

    def make_duration(self, length_ns: int) -> Any:
        """A duration, ns."""
        return self.make("builtin_interfaces/msg/Duration", **split_ns(length_ns))

    def make_header(self, at_ns: int) -> Any:
        """The header of a message without a frame."""
        return self.make("std_msgs/msg/Header", stamp=self.make_time(at_ns), frame_id="")

    def encode(self, message: Any) -> bytes:
        """The CDR of a message."""
        return bytes(self._store.serialize_cdr(message, message.__msgtype__))

    def decode(self, name: str, payload: bytes) -> Any:
        """The message of a CDR. Raises `ValueError` if it is none of this type."""
        try:
            return self._store.deserialize_cdr(payload, name)
        except Exception as error:  # whatever foreign bytes make of rosbags
            raise ValueError(f"this is no {name}: {error}") from error

    def find_hash(self, name: str) -> str:
        """The hash of a message or a service, `RIHS01_…`."""
        return self._store.hash_rihs01(name)


def find_dds_name(name: str) -> str:
    """How DDS, and rmw_zenoh with it, names a type."""
    package, kind, type_name = name.split("/")
    return f"{package}::{kind}::dds_::{type_name}_"
