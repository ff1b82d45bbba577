"""Clients of ROS 2 that are not ours drive the demo fleet by `tutti ros2 serve`: zenoh-ros2-sdk, bare Zenoh, and nightly
the crate hiroz."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh
from click.testing import CliRunner
from ecosystem.programs import require_program
from ecosystem.ros2_sdk import (
    ACTION,
    GET_RESULT_HASH,
    LIMIT_S,
    SEND_GOAL_HASH,
    Client,
    Messages,
    find_hash,
)
from ecosystem.waits import wait_until
from zenoh import ext

from integrations.ros2.messages import CANCEL_GOAL, GET_RESULT, SEND_GOAL, MessageTypes
from integrations.ros2.node import MAX_WAITING
from orchestrator.bus.zenoh.sessions import open_router
from orchestrator.cli.main import main
from orchestrator.runtime.live.fleet import find_free_port
from tutti import Refusal
from tutti.testing import LiveTestbed

NAME = "/demo/follow_joint_trajectory"
JOINTS = ["gantry.x", "gantry.y"]
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
MM = 1e-3
CRATE = Path(__file__).parent / "ros2_client"
TARGET = str(Path(__file__).parents[2] / "build/ros2_client")


@contextmanager
def serving(endpoint: str, *words: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """The server in a process of its own, and what it says when it is ready."""
    program = [sys.executable, "-c", "from orchestrator.cli.entry import main; main()"]
    command = [*program, "ros2", "serve", "--connect", endpoint, "--json", *words]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            yield process, json.loads("".join(iter(process.stdout.readline, "}\n")) + "}")
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                assert process.wait(20) == 0
        finally:
            process.kill()


def find_port(fleet: LiveTestbed) -> int:
    return int(fleet.endpoint.rpartition(":")[2])


@pytest.fixture(scope="module")
def server(demo_fleet: LiveTestbed) -> Iterator[LiveTestbed]:
    with serving(demo_fleet.endpoint) as (_, said):
        assert said["action"] == NAME
        yield demo_fleet


@pytest.fixture(scope="module")
def client(server: LiveTestbed) -> Client:
    return Client(find_port(server), NAME)


@pytest.fixture
def feedback(client: Client) -> Iterator[Messages]:
    messages = Messages()
    subscription = client.follow(f"{NAME}/_action/feedback", f"{ACTION}_FeedbackMessage", messages)
    yield messages
    subscription.close()


def park(fleet: LiveTestbed) -> None:
    fleet.tutti.move(dict.fromkeys(JOINTS, 10.0), speed=1.0, wait=True)


def read_axes(fleet: LiveTestbed) -> list[float]:
    return [fleet.tutti.position(axis) for axis in JOINTS]


def is_of(goal_id: bytes, condition: Callable[[Any], bool] = lambda _: True) -> Callable[[Any], bool]:
    return lambda message: bytes(message.goal_id.uuid) == goal_id and condition(message.feedback)


def seconds(stamp: Any) -> float:
    return stamp.sec + stamp.nanosec * 1e-9


def test_hashes_are_those_of_other_implementations() -> None:
    """Of messages by the SDK; of services with known ones, by the same rule (design.md of rmw_zenoh; ROS's own files)."""
    types = MessageTypes()
    for name in ("sensor_msgs/msg/JointState", "action_msgs/msg/GoalStatusArray", "rcl_interfaces/msg/Log"):
        assert types.find_hash(name) == find_hash(name)
    assert types.find_hash(f"{ACTION}_FeedbackMessage") == find_hash(f"{ACTION}_FeedbackMessage")
    assert types.find_hash(CANCEL_GOAL) == "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"
    assert (types.find_hash(SEND_GOAL), types.find_hash(GET_RESULT)) == (SEND_GOAL_HASH, GET_RESULT_HASH)


def test_joint_states_are_in_metres_at_the_instant_of_the_reading(server: LiveTestbed, client: Client) -> None:
    park(server)
    messages = Messages()
    subscription = client.follow("/joint_states", "sensor_msgs/msg/JointState", messages)
    state = messages.wait_for(lambda message: message.name[:2] == JOINTS)
    assert list(state.position) == pytest.approx([10 * MM, 10 * MM], abs=0.01 * MM)
    assert abs(seconds(state.header.stamp) - time.time()) < 5
    stage = messages.wait_for(lambda message: "stage.u" in message.name)
    assert "gantry.x" not in stage.name  # another instant
    subscription.close()


def test_a_trajectory_begins_at_its_stamp(server: LiveTestbed, client: Client, feedback: Messages) -> None:
    park(server)
    at_s = time.time() + 4  # also a busy computer has loaded it by then
    points = [(0.0, [10 * MM] * 2, [0.0] * 2), (0.6, [20 * MM, 30 * MM], [0.03, 0.0]), (1.2, [30 * MM] * 2, [0.0] * 2)]
    goal = client.make_goal(
        JOINTS, points, at_s=at_s, path={"gantry.x": (0.2 * MM, 0)}, goal={"gantry.y": 0.05 * MM}, end_s=1.0
    )
    goal_id, accepted = client.send(goal)
    assert accepted
    status, code, text = client.result(goal_id)
    assert (status, code) == (SUCCEEDED, 0), text
    assert "mm off the path" in text and "the tolerance is 0.2 mm" in text and "start skew at most" in text
    assert read_axes(server) == pytest.approx([30.0, 30.0], abs=0.05)
    # Beyond its beginning each message says how long ago that was: on one computer, by the same clock as the stamp.
    moving = feedback.wait_for(is_of(goal_id, lambda part: seconds(part.desired.time_from_start) > 0.1))
    t0_s = seconds(moving.feedback.header.stamp) - seconds(moving.feedback.desired.time_from_start)
    assert t0_s == pytest.approx(at_s, abs=0.05)
    assert moving.feedback.joint_names == JOINTS and 10 * MM < moving.feedback.actual.positions[0] <= 30.1 * MM


def test_a_goal_is_cancelled_and_its_axes_are_its_own(server: LiveTestbed, client: Client, feedback: Messages) -> None:
    park(server)
    goal_id, accepted = client.send(client.make_goal(JOINTS, [(20.0, [200 * MM, 20 * MM])]))
    assert accepted
    feedback.wait_for(is_of(goal_id, lambda part: part.actual.positions[0] > 11 * MM))
    other_id, accepted = client.send(client.make_goal(["gantry.y"], [(1.0, [10 * MM])]))
    assert not accepted
    assert f"gantry.y: goal {goal_id.hex()} is on it" in client.result(other_id)[2]
    assert client.cancel(goal_id) == (0, 1)
    assert client.result(goal_id) == (CANCELED, 0, "cancelled")
    assert read_axes(server)[0] < 150
    assert client.cancel(goal_id) == (3, 0)
    assert client.cancel(b"?" * 16) == (2, 0)
    # A client that comes later reads the states that were published last.
    key = f"0{NAME}/_action/status/action_msgs::msg::dds_::GoalStatusArray_/{find_hash('action_msgs/msg/GoalStatusArray')}"
    samples: list[bytes] = []
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    subscriber = ext.declare_advanced_subscriber(
        client.session.session, key, lambda sample: samples.append(sample.payload.to_bytes()), history=history
    )
    wait_until(lambda: samples)
    statuses = client.session.store.deserialize_cdr(samples[-1], "action_msgs/msg/GoalStatusArray").status_list
    assert (goal_id, CANCELED) in {(bytes(entry.goal_info.goal_id.uuid), entry.status) for entry in statuses}
    subscriber.undeclare()


def test_bad_goals_move_nothing_and_say_why(server: LiveTestbed, client: Client) -> None:
    park(server)
    log = Messages()
    subscription = client.follow("/rosout", "rcl_interfaces/msg/Log", log)
    make = client.make_goal
    rejected = [
        (make(["gantry.q"], [(1.0, [0.02])]), -2, "unknown joints: gantry.q"),
        (make(JOINTS, [(1.0, [0.02, 0.02]), (1.0, [0.02, 0.03])]), -1, "times must increase"),
        (make(JOINTS, [(1.0, [float("nan"), 0.02])]), -1, "not finite"),
        (make(JOINTS, [(1.0, [0.02, 0.02])], at_s=time.time() - 1), -3, "in the past"),
    ]
    for goal, code, said in rejected:
        goal_id, accepted = client.send(goal)
        result = client.result(goal_id)
        assert (accepted, result[:2], said in result[2]) == (False, (0, code), True), result
    aborted = [
        (make(JOINTS, [(30.0, [0.5, 0.02])]), -1, "above its soft limit 400"),
        (make(JOINTS, [(0.1, [0.2, 0.02])]), -1, "needs a velocity of"),
        (make(JOINTS, [(0.0, [0.2, 0.02]), (1.0, [0.2, 0.01])]), -1, "from the point at 0 s"),
        (make(JOINTS, [(1.0, [0.02, 0.02])], path={"gantry.x": (1e-8, 0.0)}), -4, "the tolerance is"),
        (make(["gantry.x", "stage.u"], [(1.0, [0.02, 0.002])]), -1, "from rest to rest only"),
    ]
    for goal, code, said in aborted:
        goal_id, accepted = client.send(goal)
        result = client.result(goal_id)
        assert (accepted, result[:2], said in result[2]) == (True, (ABORTED, code), True), result
    near_id, _ = client.send(make(JOINTS, [(1.0, [0.02, 0.02])], at_s=time.time() + 0.1))
    assert client.result(near_id)[1] == -3
    garbage = b"\x00\x01\x00\x00" + b"\xff" * 200
    assert "this is no control_msgs/action/FollowJointTrajectory_SendGoal_Request" in client.query(
        garbage, b"\x10" * 33
    )
    assert "needs a payload" in client.query(b"", None)
    log.wait_for(lambda message: message.level == 40 and "from rest to rest only" in message.msg)
    subscription.close()
    assert read_axes(server) == pytest.approx([10.0, 10.0], abs=0.01)


def test_an_estop_aborts_a_goal_and_refuses_others(server: LiveTestbed, client: Client, feedback: Messages) -> None:
    park(server)
    goal = client.make_goal(JOINTS, [(20.0, [200 * MM, 20 * MM])])
    goal_id, _ = client.send(goal)
    feedback.wait_for(is_of(goal_id, lambda part: part.actual.positions[0] > 11 * MM))
    try:
        server.tutti.estop("test")
        status, code, text = client.result(goal_id)
        assert (status, code, "e-stop" in text) == (ABORTED, -4, True), text
        status, code, text = client.result(client.send(goal)[0])
        assert (status, code, "e-stop" in text) == (ABORTED, -1, True), text
    finally:
        server.tutti.reset()
        wait_until(lambda: is_ready(server))
    waiting_id, _ = client.send(client.make_goal(JOINTS, [(20.0, [200 * MM, 20 * MM])], at_s=time.time() + 30))
    wait_until(lambda: server.tutti.list_jobs(1).jobs[0].state == "running")
    assert client.cancel(waiting_id) == (0, 1)
    assert client.result(waiting_id)[0] == CANCELED


def is_ready(fleet: LiveTestbed) -> bool:
    """Whether motors and queue could be started; the coordinator knows of a reset a moment later."""
    try:
        fleet.tutti.enable()
        fleet.tutti.start_queue()
    except Refusal:
        return False
    return True


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--ros-router", "tcp/192.0.2.1:7447"], "ROS 2 has no users here"),
        (["--connect", "tls/192.0.2.1:7447"], "have no certificates of the fleet"),
        (["--joint", "x"], "no name of an axis"),
    ],
)
def test_what_the_command_refuses(words: list[str], said: str) -> None:
    done = CliRunner().invoke(main, ["ros2", "serve", *words])
    assert (done.exit_code, said in done.stderr) == (2, True), done.output


@pytest.mark.nightly
def test_a_router_of_its_own_a_domain_and_names(demo_fleet: LiveTestbed) -> None:
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    options = ["--ros-router", endpoint, "--domain", "7", "--namespace", "cell/left", "--joint", "slide=gantry.x"]
    config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": [endpoint]}}))
    with open_router(endpoint), serving(demo_fleet.endpoint, *options) as (_, said), zenoh.open(config) as session:
        assert said["action"] == "/cell/left/follow_joint_trajectory" and "slide" in said["joints"]
        with session.declare_subscriber("7/joint_states/**") as samples:
            types = MessageTypes()
            while "slide" not in types.decode("sensor_msgs/msg/JointState", bytes(samples.recv().payload)).name:
                pass
        tokens = {str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/7/**") if reply.ok}
        (node,) = (token for token in tokens if "/NN/" in token)
        assert node.endswith("/NN/%/%cell%left/tutti")


@pytest.mark.nightly
def test_another_axis_of_a_controller_in_use_is_aborted(
    server: LiveTestbed, client: Client, feedback: Messages
) -> None:
    park(server)
    goal_id, _ = client.send(client.make_goal(["gantry.x"], [(20.0, [200 * MM])]))
    feedback.wait_for(is_of(goal_id, lambda part: part.actual.positions[0] > 11 * MM))
    other_id, accepted = client.send(client.make_goal(["gantry.y"], [(1.0, [12 * MM])]))
    status, code, text = client.result(other_id)
    assert (accepted, status, code, "in use" in text) == (True, ABORTED, -1, True), text
    client.cancel(goal_id)
    assert client.result(goal_id)[0] == CANCELED


@pytest.mark.nightly
@pytest.mark.timeout(3600)  # it is built once, which takes half an hour on a slow core
def test_an_action_client_in_rust(server: LiveTestbed) -> None:
    """hiroz looks for the action in the graph by its tokens, and waits for its result without an end."""
    cargo = require_program("cargo")
    build = [
        cargo,
        "build",
        "--release",
        "--locked",
        "--manifest-path",
        str(CRATE / "Cargo.toml"),
        "--target-dir",
        TARGET,
    ]
    subprocess.run(build, check=True)

    def run(seconds: str, x: str, verb: str) -> list[str]:
        words = [server.endpoint, NAME, seconds, x, "0.02", verb]
        done = subprocess.run(
            [f"{TARGET}/release/ros2_client", *words], capture_output=True, text=True, timeout=LIMIT_S
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    park(server)
    first, moving, result = run("2", "0.03", "run")
    assert (first, moving) == ("accepted", "feedback gantry.x gantry.y")
    assert result.startswith("result 0 ") and "mm off the path" in result
    assert read_axes(server) == pytest.approx([30.0, 20.0], abs=0.05)
    assert run("30", "0.3", "cancel")[2:] == ["cancel 0", "result 0 cancelled"]
    assert run("30", "0.5", "run")[-1].startswith("result -1 ")


@pytest.mark.nightly
def test_a_server_that_is_killed_stops_its_goal(demo_fleet: LiveTestbed) -> None:
    park(demo_fleet)
    with serving(demo_fleet.endpoint, "--domain", "7") as (process, _):
        goal_client = Client(find_port(demo_fleet), NAME, domain=7)
        goal_client.send(goal_client.make_goal(JOINTS, [(30.0, [300 * MM, 20 * MM])]))
        wait_until(lambda: demo_fleet.tutti.position("gantry.x") > 11)
        process.kill()
        process.wait()
        wait_until(lambda: not demo_fleet.tutti.axes()["gantry.x"].moving, 5)
    assert demo_fleet.tutti.position("gantry.x") < 200


@pytest.mark.nightly
def test_a_client_that_is_killed_leaves_its_goal_to_its_end(server: LiveTestbed) -> None:
    park(server)
    program = (
        "import os, signal\nfrom ecosystem.ros2_sdk import Client\n"
        f"client = Client({find_port(server)}, {NAME!r})\n"
        f"goal = client.make_goal({JOINTS!r}, [(4.0, [0.03, 0.02])])\n"
        "assert client.send(goal)[1]\nos.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.run([sys.executable, "-c", program], env=environment).returncode == -signal.SIGKILL
    wait_until(lambda: abs(server.tutti.position("gantry.x") - 30) < 0.05)


@pytest.mark.nightly
def test_a_thousand_goals_in_a_second_are_answered_each(server: LiveTestbed, client: Client) -> None:
    park(server)
    goal = client.make_goal(JOINTS, [(1.0, [0.02, 0.02])], at_s=time.time() - 1)
    answers, all_answered, count = list[bool](), threading.Event(), 3000

    def take(reply: zenoh.Reply) -> None:
        answers.append(reply.ok is not None)
        if len(answers) == count:
            all_answered.set()

    for number in range(count):
        client.ask_goal(number.to_bytes(16, "big"), goal, take)
    assert all_answered.wait(LIMIT_S)
    assert answers.count(True) >= MAX_WAITING
    goal_id, accepted = client.send(client.make_goal(JOINTS, [(1.0, [0.02, 0.02])]))
    assert accepted and client.result(goal_id)[0] == SUCCEEDED
