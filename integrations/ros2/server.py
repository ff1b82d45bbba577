"""A fleet as a node of ROS 2."""

from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager

import numpy as np

from integrations.ros2.action import TrajectoryAction
from integrations.ros2.goals import GoalRunner
from integrations.ros2.joints import NS_PER_S, Joint, find_utc_ns, make_joints
from integrations.ros2.messages import JOINT_STATE, MessageTypes
from integrations.ros2.node import RosNode, Topic, open_session
from integrations.ros2.settings import RosSettings, fill_settings
from tutti import StateReading, TaskOwner, Tutti
from tutti.commands import ServerReady


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
                # A little less than the period: readings come nearly at theirs.
                is_due = at_ns - published_ns.get(controller, 0) >= 0.9 * NS_PER_S / settings.hz
                if is_due and reading.mode != "offline":
                    published_ns[controller] = at_ns
                    publish_joints(topic, node.types, reading, by_axis)
                    action.publish_feedback(readings, controller)

        tasks = TaskOwner()
        tasks.spawn(follow())
        try:
            lines = [f"joints {', '.join(joints)} on /joint_states, domain {domain}", f"action {name}"]
            yield ServerReady(lines, {"action": name, "domain": domain, "joints": list(joints)})
        finally:
            await tasks.end_all()
            await action.close()


def publish_joints(topic: Topic, types: MessageTypes, reading: StateReading, joints: Mapping[str, Joint]) -> None:
    """Publish a reading of a controller as joint states, with the instant at which it was read."""
    axes = {joints[axis]: state for axis, state in reading.axes.items() if axis in joints}
    if not axes or not topic.is_wanted:
        return
    message = types.make(
        JOINT_STATE,
        header=types.make_header(find_utc_ns(reading)),
        name=[joint.name for joint in axes],
        position=np.array([state.position * joint.size for joint, state in axes.items()]),
        velocity=np.array([state.velocity * joint.size for joint, state in axes.items()]),
        effort=np.zeros(0),
    )
    topic.publish(message)
