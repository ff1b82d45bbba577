"""Two computers with a network in between: network namespaces, a router with TLS, and a relay that fails."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from children import LIMIT_S, wait_until
from fleet import COMMAND, READY, Steps
from parts import Part
from test_hosts import write_fleet

pytestmark = [
    pytest.mark.live,
    pytest.mark.alone,
    pytest.mark.skipif(os.geteuid() != 0 or shutil.which("ip") is None, reason="network namespaces need root and `ip`"),
]

FIRST, SECOND = "10.77.0.1", "10.77.0.2"
ROUTER_PORT, RELAY_PORT = 7447, 7448
HERE = Path(__file__).parent
MOVE: Steps = [{"do": "move", "to": {"gantry.x": 201, "stage.u": 21}, "speed": 0.1}]  # some 20 s


def run(*words: str) -> None:
    subprocess.run(words, check=True, capture_output=True)


@pytest.fixture
def computers() -> Iterator[tuple[str, str]]:
    """Two namespaces that reach each other, and nothing else."""
    names = f"tutti-a-{os.getpid()}", f"tutti-b-{os.getpid()}"
    made: list[str] = []
    try:
        for name in names:
            run("ip", "netns", "add", name)
            made.append(name)
            run("ip", "-n", name, "link", "set", "lo", "up")
        run("ip", "-n", names[0], "link", "add", "eth0", "type", "veth", "peer", "name", "eth0", "netns", names[1])
        for name, address in zip(names, (FIRST, SECOND), strict=True):
            run("ip", "-n", name, "address", "add", f"{address}/24", "dev", "eth0")
            run("ip", "-n", name, "link", "set", "eth0", "up")
        yield names
    finally:
        for name in made:
            run("ip", "netns", "delete", name)


def make_keys(folder: Path) -> Path:
    keys = folder / "keys"

    def make(*words: str) -> None:
        run(*COMMAND, "keys", *words, "--keys", str(keys))

    make("init", "--fleet", "demo", "--address", FIRST, "--address", "127.0.0.1")
    make("add-coordinator")
    make("add-host", "left")
    make("add-host", "right")
    make("add-user", "anna", "--role", "operator")
    return keys


class TwoComputers:
    """The demo fleet on two computers: its stage is on the second one. behind: what is behind the relay, the host of the
    stage or everything on the first computer but the router."""

    def __init__(self, folder: Path, computers: tuple[str, str], behind: str) -> None:
        self._first, self._second = computers
        self.behind = behind
        self.folder = folder
        self.keys = make_keys(folder)
        self._anna = self.keys / "identities" / "operator-anna"
        self.parts: list[Part] = []

    def start(self) -> None:
        """Start router and relay, then coordinator and the first host, then the second host."""
        first, folder, fleet = self._first, self.folder, str(write_fleet(self.folder))
        tls, relayed, state = f"tls/{FIRST}:{ROUTER_PORT}", f"tls/127.0.0.1:{RELAY_PORT}", str(folder / "state")
        self._start(first, None, "router", fleet, "--keys", str(self.keys), "--listen", f"tls/0.0.0.0:{ROUTER_PORT}")
        self.parts[-1].wait_for("router on")
        relay = [sys.executable, str(HERE / "relay.py"), str(RELAY_PORT), FIRST, str(ROUTER_PORT)]
        self.relay = Part(folder, self._second if self.behind == "host" else first, None, *relay)
        self.parts.append(self.relay)
        self.relay.wait_for("ready")
        to_first, to_second = (tls, relayed) if self.behind == "host" else (relayed, tls)
        up = [fleet, "--sim", "--host", "left", "--connect", to_first, "--keys", str(self.keys), "--state", state]
        self._start(first, None, "up", *up, "--no-record", "--no-web")
        self.parts[-1].wait_for("is up")
        right = self.keys / "identities" / "host-right"
        host = ["host", "right", "--fleet", "demo", "--sim", "--connect", to_second, "--state", str(folder / "right")]
        self._start(self._second, right, *host)
        self.parts[-1].wait_for("drives stage")

    def _start(self, computer: str, identity: Path | None, *words: str) -> None:
        self.parts.append(Part(self.folder, computer, identity, *COMMAND, *words))

    def tutti(self, *words: str) -> "subprocess.CompletedProcess[str]":
        """A command of an operator on the first computer."""
        environment = {**os.environ, "TUTTI_IDENTITY": str(self._anna)}
        command = ["ip", "netns", "exec", self._first, *COMMAND, *words, "--connect", f"tls/{FIRST}:{ROUTER_PORT}"]
        return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=3 * LIMIT_S)

    def submit(self, steps: Steps, name: str, *more: str) -> "subprocess.CompletedProcess[str]":
        path = self.folder / f"{name}.job.json"
        path.write_text(json.dumps({"schema": "tutti.job/1", "name": name, "max_start_skew": "50 ms", "steps": steps}))
        return self.tutti("submit", str(path), *more)

    def close(self) -> None:
        for part in reversed(self.parts):
            part.end()


@pytest.fixture
def two(tmp_path: Path, computers: tuple[str, str], behind: str) -> Iterator[TwoComputers]:
    fleet = TwoComputers(tmp_path, computers, behind)
    try:
        fleet.start()
        yield fleet
    finally:
        fleet.close()


def has_ended(two: TwoComputers) -> bool:
    """Whether the last job has failed, as it should."""
    shown = two.tutti("job", "show", "last").stdout
    return "failed" in shown or "aborted" in shown


@pytest.mark.parametrize(
    ("behind", "fault"),
    [
        ("host", "cut"),
        *(pytest.param("host", fault, marks=pytest.mark.nightly) for fault in ("stall", "deaf", "mute")),
        pytest.param("coordinator", "stall", marks=pytest.mark.nightly),
    ],
)
def test_two_computers_do_a_job_and_stop_when_the_network_fails(two: TwoComputers, fault: str) -> None:
    def works() -> bool:
        shown = two.tutti("status").stdout
        return shown.count("idle") == 2

    wait_until(works, "both are idle")
    two.tutti("queue", "start")
    done = two.submit(READY, "ready", "--wait")
    assert done.returncode == 0, done.stdout + done.stderr

    assert two.submit(MOVE, fault).returncode == 0
    wait_until(lambda: two.tutti("status").stdout.count("moving") >= 2, "it moves")
    two.relay.order(fault)
    # The stage's own computer stops it; the gantry is stopped by the coordinator, or by its own host without one.
    wait_until(lambda: "moving" not in two.tutti("status").stdout, "all rest")
    if two.behind == "host":
        wait_until(lambda: has_ended(two), "the job ends")
    two.relay.order("mend")
    wait_until(lambda: has_ended(two), "the job has ended")
    wait_until(works, "both are idle again")
    two.tutti("queue", "start")
    assert two.submit(READY, "after", "--wait").returncode == 0, two.tutti("job", "report", "last").stdout


def test_a_host_without_its_certificate_is_refused(computers: tuple[str, str]) -> None:
    words = ["host", "right", "--fleet", "demo", "--connect", f"tls/{FIRST}:{ROUTER_PORT}"]
    environment = {name: value for name, value in os.environ.items() if name != "TUTTI_IDENTITY"}
    command = ["ip", "netns", "exec", computers[1], *COMMAND, *words]
    refused = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=LIMIT_S)
    assert refused.returncode in (2, 3) and "needs a certificate" in refused.stderr
