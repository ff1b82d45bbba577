"""States of the demo fleet on a broker that is not ours (Debian's `mosquitto`)."""

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho
import pytest
from click.testing import CliRunner
from ecosystem.programs import require_program
from ecosystem.waits import LIMIT_S, wait_until

from orchestrator.cli.main import main
from orchestrator.runtime.live.fleet import find_free_port
from tutti.testing import LiveTestbed

CALL = "from orchestrator.cli.entry import main; main()"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[int]:
    """The port of a broker of this test."""
    program = require_program("mosquitto")
    port = find_free_port()
    config = tmp_path / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    process = subprocess.Popen([program, "-c", str(config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: is_open(port))
        yield port
    finally:
        process.kill()
        process.wait()


def is_open(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class Listener:
    """A client that is not ours, and the newest message of each topic."""

    def __init__(self, port: int, topics: str) -> None:
        self.messages: dict[str, dict[str, Any]] = {}
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda *_: self._client.subscribe(topics, qos=1)
        self._client.on_message = lambda _, __, message: self.messages.update(
            {message.topic: json.loads(message.payload)}
        )
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def close(self) -> None:
        self._client.loop_stop()


def serve(fleet: LiveTestbed, port: int, *words: str) -> subprocess.Popen[str]:
    command = [
        "mqtt",
        "serve",
        "--broker",
        f"127.0.0.1:{port}",
        "--connect",
        fleet.endpoint,
        "--hz",
        "20",
        "--json",
        *words,
    ]
    return subprocess.Popen([sys.executable, "-c", CALL, *command], stdout=subprocess.PIPE, text=True)


def test_states_are_published_and_the_broker_says_when_they_end(demo_fleet: LiveTestbed, broker: int) -> None:
    process = serve(demo_fleet, broker)
    listener = Listener(broker, "tutti/#")
    try:
        wait_until(lambda: listener.messages.get("tutti/demo/gantry/x"))
        assert listener.messages["tutti/demo/status"] == {"status": "online"}
        target = 7.0 if demo_fleet.tutti.position("gantry.x") > 8 else 9.0
        demo_fleet.tutti.move({"gantry.x": target})
        wait_until(lambda: abs(listener.messages["tutti/demo/gantry/x"]["position"] - target) < 0.002)
        process.kill()
        wait_until(lambda: listener.messages["tutti/demo/status"] == {"status": "offline"})
    finally:
        process.kill()
        process.communicate()
        listener.close()


@pytest.mark.nightly
def test_births_and_deaths_of_sparkplug(demo_fleet: LiveTestbed, broker: int) -> None:
    listener = Listener(broker, "spBv1.0/#")
    process = serve(demo_fleet, broker, "--sparkplug", "lab")
    try:
        wait_until(lambda: "spBv1.0/lab/DBIRTH/demo/gantry" in listener.messages)
        birth = listener.messages["spBv1.0/lab/DBIRTH/demo/gantry"]
        assert "x/position" in {metric["name"] for metric in birth["metrics"]}
        process.send_signal(signal.SIGTERM)
        assert process.wait(LIMIT_S) == 0
        wait_until(lambda: "spBv1.0/lab/NDEATH/demo" in listener.messages)
        death = listener.messages["spBv1.0/lab/NDEATH/demo"]
        assert death["metrics"] == listener.messages["spBv1.0/lab/NBIRTH/demo"]["metrics"][:1]
    finally:
        process.kill()
        process.communicate()
        listener.close()


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--broker", "127.0.0.1:1"], 1, "does not take messages"),
        (["--broker", "nowhere"], 2, "no address"),
        (["--prefix", "a/#"], 2, "cannot begin a topic"),
    ],
)
def test_a_broker_that_cannot_be_used_is_said(demo_fleet: LiveTestbed, words: list[str], code: int, said: str) -> None:
    done = CliRunner().invoke(main, ["mqtt", "serve", "--connect", demo_fleet.endpoint, *words])
    assert (done.exit_code, said in done.stderr) == (code, True), done.output
