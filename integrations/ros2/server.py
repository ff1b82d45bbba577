"""A fleet as a node of ROS 2."""

from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from integrations.ros2.action import TrajectoryAction
from integrations.ros2.goals import GoalRunner
from integrations.ros2.joints import NS_PER_S, Joint, find_utc_ns, make_joints, make_token, split_ns
from integrations.ros2.messages import JOINT_STATE, MessageTypes
from integrations.ros2.node import RosNode, Topic, open_session
from tutti import Refusal, StateReading, Tutti, running
from tutti.commands import ServerReady


@dataclass(frozen=True, slots=True)
class RosSettings:
    """router: for ROS 2. domain, namespace: None: as the fleet file says, or 0 and the name of the fleet. joints: of
    names, the axes. hz: messages of a controller a second at most. tolerance: of a path without one, m or rad."""

    router: str
    domain: int | None = None
    namespace: str | None = None
    joints: Mapping[str, str] = field(default_factory=dict[str, str])
    hz: float = 20.0
    tolerance: float = 1e-3


def fill_settings(settings: RosSettings, section: Mapping[str, Any], fleet: str) -> tuple[int, str, dict[str, str]]:
    """Domain, namespace and joints, by the options, the section of the fleet file, and what holds without. Raises
    `Refusal`."""
    unknown_names = section.keys() - {"domain", "namespace", "joints"}
    domain, namespace = section.get("domain", 0), section.get("namespace", make_token(fleet))
    joints = section.get("joints", {})
    domain = domain if settings.domain is None else settings.domain
    namespace = namespace if settings.namespace is None else settings.namespace
    is_good = isinstance(domain, int) and 0 <= domain <= 232 and isinstance(joints, dict)
    is_good = is_good and isinstance(namespace, str) and all(part == make_token(part) for part in namespace.split("/"))
    if unknown_names or not is_good:
        names = f", not {', '.join(sorted(unknown_names))}" if unknown_names else ""
        text = f"`integrations: ros2:` of the fleet file, or an option: domain {domain}, namespace {namespace}"
        remedy = f"domain is 0 to 232, namespace letters, digits, _ and /, joints a map from names to axes{names}"
        raise Refusal("bad-settings", text, remedy)
    return domain, namespace, {**joints, **settings.joints}


@asynccontextmanager
async def serve_ros2(tutti: Tutti, settings: RosSettings) -> AsyncGenerator[ServerReady]:
    """Serve the fleet while the context lasts. Raises `Refusal`."""
    fleet = await tutti.load_fleet()
    domain, namespace, names = fill_settings(settings, fleet.integrations.get("ros2", {}), fleet.fleet)
    joints = make_joints([await tutti.axis(axis) for axis in (await tutti.list_names()).axes], names)
    readings: dict[str, StateReading] = {}
    async with open_session(settings.router) as session:
        node = RosNode(session, MessageTypes(), domain, namespace, "tutti")
        name = f"/{namespace}/follow_joint_trajectory" if namespace else "/follow_joint_trajectory"
        action = TrajectoryAction(node, name, joints, settings.tolerance, GoalRunner(tutti, readings))
        topic = node.publish_on("/joint_states", JOINT_STATE)

        async def follow() -> None:
            by_axis = {joint.axis: joint for joint in joints.values()}
            published_ns: dict[str, int] = {}
            async for reading in tutti.states():
                controller, at_ns = reading.controller, find_utc_ns(reading)
                readings[controller] = reading
                is_due = at_ns - published_ns.get(controller, 0) >= 0.9 * NS_PER_S / settings.hz
                if is_due and reading.mode != "offline":
                    published_ns[controller] = at_ns
                    publish_joints(topic, node.types, reading, by_axis)
                    action.publish_feedback(readings, controller)

        async with running(follow()):
            try:
                lines = [f"joints {', '.join(joints)} on /joint_states, domain {domain}", f"action {name}"]
                yield ServerReady(lines, {"action": name, "domain": domain, "joints": list(joints)})
            finally:
                await action.close()


def publish_joints(topic: Topic, types: MessageTypes, reading: StateReading, joints: Mapping[str, Joint]) -> None:
    """Publish a reading of a controller as joint states, with the instant at which it was read."""
    axes = {joints[axis]: state for axis, state in reading.axes.items() if axis in joints}
    if not axes or not topic.is_wanted:
        return
    stamp = types.make("builtin_interfaces/msg/Time", **split_ns(find_utc_ns(reading)))
    message = types.make(
        JOINT_STATE,
        header=types.make("std_msgs/msg/Header", stamp=stamp, frame_id=""),
        name=[joint.name for joint in axes],
        position=np.array([state.position * joint.size for joint, state in axes.items()]),
        velocity=np.array([state.velocity * joint.size for joint, state in axes.items()]),
        effort=np.zeros(0),
    )
    topic.publish(message)
