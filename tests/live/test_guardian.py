"""The guardian: a dead or hung adapter host costs its controllers a stop, and gets a successor."""

import asyncio
import json
import os
import signal
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from children import LIMIT_S, Children, ready, wait_until
from fake_make import DRIVER_STOP, GUARDIAN_STOP
from forks import ForkedProcess, server_pid

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.estop import put_estop
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.clock.live import raw_ns
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.messages import EstopReset, KeptEstop
from orchestrator.model.state import ControllerState

DEMO = Path(__file__).parents[2] / "deploy" / "examples" / "demo.fleet.yaml"

pytestmark = pytest.mark.live

Entry = dict[str, Any]


class FakeController:
    """A socket that records the data that it receives, with the time."""

    def __init__(self) -> None:
        self.heard: list[tuple[int, bytes]] = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._listen, args=(connection,), daemon=True).start()

    def _listen(self, connection: socket.socket) -> None:
        with connection:
            try:
                while data := connection.recv(1000):
                    self.heard.append((raw_ns(), data))
            except OSError:
                pass

    def said(self, data: bytes) -> int | None:
        """When it received `data`, if it did."""
        return next((at_ns for at_ns, heard in self.heard if heard == data), None)

    def close(self) -> None:
        # A blocked accept is woken by shutdown only.
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()


def fakes(*ports: int) -> Entry:
    """Controllers of the fake make on these TCP ports."""
    axis = {"motors": ["X"], "unit": "mm", "limits": {"velocity": 1, "acceleration": 1}}
    links = [{"kind": "tcp", "host": "127.0.0.1", "port": port} for port in ports]
    return {f"c{at}": {"adapter": "fake", "link": link, "axes": {"x": axis}} for at, link in enumerate(links)}


class Site:
    """A router, a guardian with its host, and the log of both."""

    def __init__(self, children: Children, controllers: Entry) -> None:
        folder = children.folder
        with socket.create_server(("127.0.0.1", 0)) as free:
            endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        self.endpoint = endpoint
        self._children = children
        self.router = self.start_router()
        fleet = folder / "fleet.json"
        fleet.write_text(json.dumps({"schema": "tutti.fleet/1", "fleet": "f", "controllers": controllers}))
        self._log = folder / "log.jsonl"
        arguments = ["--fleet", str(fleet), "--host", "local", "--connect", endpoint]
        arguments += ["--state", str(folder / "state"), "--log", str(self._log)]
        self.guardian = children.start("adapters.host.guardian", *arguments)
        ready(self.guardian)
        self._names = list(controllers)
        self.online(1)

    def start_router(self) -> ForkedProcess:
        kept = ("f", str(self._children.folder / "estop-router.json"))
        router = self._children.start("orchestrator.bus.zenoh.router", self.endpoint, str(server_pid()), *kept)
        ready(router)
        return router

    def entries(self) -> list[Entry]:
        """The log so far; a line may be half written."""
        whole = self._log.read_text().rpartition("\n")[0]
        return [json.loads(line) for line in whole.splitlines()]

    def pids(self) -> list[int]:
        return [entry["pid"] for entry in self.entries() if entry["text"] == "the adapter host is started"]

    def online(self, times: int) -> None:
        """Wait until every controller was taken into service this many times."""

        def all_online() -> bool:
            shown = [entry["controller"] for entry in self.entries() if entry.get("kind") == "online"]
            return all(shown.count(name) >= times for name in self._names)

        wait_until(all_online, f"all online {times} times")

    def texts(self) -> list[str]:
        return [entry["text"] for entry in self.entries()]


def ended(pid: int) -> bool:
    """Whether the process has ended; its parent may not have read its exit status yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.fixture
def controllers() -> Any:
    both = [FakeController(), FakeController()]
    yield both
    for controller in both:
        controller.close()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_lost_host_has_its_controllers_stopped_and_is_replaced(
    how: signal.Signals, children: Children, controllers: list[FakeController]
) -> None:
    site = Site(children, fakes(*(controller.port for controller in controllers)))
    lost_ns = raw_ns()
    os.kill(site.pids()[0], how)
    for controller in controllers:
        wait_until(lambda controller=controller: controller.said(GUARDIAN_STOP) is not None, "the stop")
    took_ms = [(stopped - lost_ns) / 1e6 for each in controllers if (stopped := each.said(GUARDIAN_STOP)) is not None]
    if how == signal.SIGSTOP:
        assert min(took_ms) > 200, "a host that beat just now was taken for hung"
    assert max(took_ms) < 3000
    assert all(controller.said(DRIVER_STOP) is None for controller in controllers)
    site.online(2)
    assert len(site.pids()) == 2


def test_an_axis_that_moves_is_stopped_by_the_simulators_own_truth(children: Children) -> None:
    truth = children.folder / "truth.jsonl"
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0", "--truth", str(truth))
    site = Site(children, fakes(place["port"]))
    with socket.create_connection((place["host"], place["port"]), timeout=LIMIT_S) as line:
        line.sendall(b"SH X;JG 20000;AC 1024000;DC 1024000;BG X\r")
        wait_until(lambda: '"start"' in truth.read_text(), "the start of the motion")
        lost_ns = raw_ns()
        os.kill(site.pids()[0], signal.SIGKILL)
        wait_until(lambda: '"end"' in truth.read_text(), "the end of the motion")
    end = json.loads(truth.read_text().splitlines()[-1])
    assert 0 < end["end_ns"] - lost_ns < 3_000_000_000


def test_all_makes_are_stopped_and_reconnected(children: Children) -> None:
    controllers = load_fleet(DEMO).to_plain()["controllers"]
    truth = children.folder / "truth.jsonl"
    port = str(children.folder / "ports" / "stage")
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0", "--options", '{"axes": 2}', "--truth", str(truth))
    children.simulator("shrc203", f"pty:{port}", "--options", json.dumps(controllers["stage"]["simulate"]["options"]))
    controllers["gantry"]["link"] = {"kind": "tcp", "host": place["host"], "port": place["port"]}
    controllers["stage"]["link"]["device"] = port
    site = Site(children, controllers)
    with socket.create_connection((place["host"], place["port"]), timeout=LIMIT_S) as line:
        line.sendall(b"SH X;JG 20000;BG X\r")
        wait_until(lambda: '"start"' in truth.read_text(), "the start of the motion")
        os.kill(site.pids()[0], signal.SIGKILL)
        wait_until(lambda: '"end"' in truth.read_text(), "the end of the motion")
    site.online(2)
    stopped = {each["controller"] for each in site.entries() if each["text"] == "stopped by the guardian"}
    assert stopped == {"gantry", "stage"}


def test_the_host_of_a_dead_guardian_stops_its_controllers_and_ends(
    children: Children, controllers: list[FakeController]
) -> None:
    site = Site(children, fakes(controllers[0].port))
    site.guardian.kill()
    wait_until(lambda: controllers[0].said(DRIVER_STOP) is not None, "the stop")
    wait_until(lambda: ended(site.pids()[0]), "the end of the host")
    assert "the guardian is gone" in site.texts()


def test_a_guardian_that_is_terminated_ends_its_host_which_stops_its_controllers(
    children: Children, controllers: list[FakeController]
) -> None:
    site = Site(children, fakes(controllers[0].port))
    site.guardian.terminate()
    site.guardian.communicate(timeout=LIMIT_S)
    assert site.guardian.returncode == 0
    assert ended(site.pids()[0])
    assert controllers[0].said(DRIVER_STOP) is not None
    assert controllers[0].said(GUARDIAN_STOP) is None


@pytest.mark.parametrize("module", ["adapters.host.guardian", "adapters.host.host_process"])
def test_bad_input_is_one_line_and_code_2(module: str, children: Children) -> None:
    missing = str(children.folder / "missing.yaml")
    wrong = ["--fleet", missing, "--host", "local", "--connect", "tcp/127.0.0.1:1", "--state", str(children.folder)]
    process = children.start(module, *wrong)
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 2
    assert missing in said
    assert said.count("\n") == 1


@pytest.mark.nightly
def test_a_missing_router_is_code_3(children: Children) -> None:
    fleet = children.folder / "fleet.json"
    axis = {"motors": ["X"], "unit": "mm", "limits": {"velocity": 1, "acceleration": 1}}
    one = {"adapter": "fake", "link": {"kind": "tcp", "host": "127.0.0.1", "port": 1}, "axes": {"x": axis}}
    fleet.write_text(json.dumps({"schema": "tutti.fleet/1", "fleet": "f", "controllers": {"c": one}}))
    arguments = ["--fleet", str(fleet), "--host", "local", "--state", str(children.folder)]
    process = children.start("adapters.host.host_process", *arguments, "--connect", "tcp/127.0.0.1:1")
    begun_s = time.monotonic()
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 3
    assert "no router answered" in said
    assert time.monotonic() - begun_s < LIMIT_S


async def wait_for_latches(bus: Bus, actor: str | None, *keepers: str) -> None:
    """Wait until exactly these keepers answer, all with the e-stop of `actor`, or all with none."""
    keys = FleetKeys("f")
    wanted = {keys.kept_estop(name): actor for name in keepers}
    async with asyncio.timeout(LIMIT_S):
        while True:
            found = await bus.request_all(keys.kept_estop(), b"", LIMIT_S)
            kept = {key: KeptEstop.model_validate_json(payload).estop for key, payload in found.items()}
            if {key: latch and latch.actor for key, latch in kept.items()} == wanted:
                return
            await asyncio.sleep(0.02)


def test_an_estop_is_kept_by_the_guardian_and_by_the_router(
    children: Children, controllers: list[FakeController]
) -> None:
    """While no coordinator runs and the adapter host is dead; also over the end of the keepers."""
    site = Site(children, fakes(*(each.port for each in controllers)))

    async def send_estop() -> None:
        bus, keys = await open_bus(site.endpoint), FleetKeys("f")
        try:
            await wait_for_latches(bus, None, "router", "guardian-local")
            os.kill(site.pids()[-1], signal.SIGKILL)
            put_estop(bus, "f", "e1", "tester", "nothing receives it but the keepers")
            await wait_for_latches(bus, "tester", "router", "guardian-local")
            actors: list[str | None] = []
            async with asyncio.timeout(LIMIT_S):
                # An adapter answers for its state before it has compared latches; until then it cannot be adopted.
                while actors != ["tester", "tester"]:
                    states = await bus.request_all(keys.state(), b"", LIMIT_S)
                    latches = [ControllerState.model_validate_json(payload).estop for payload in states.values()]
                    actors = [latch and latch.actor for latch in latches]
                    await asyncio.sleep(0.02)
        finally:
            await bus.close()

    async def restart_keepers() -> None:
        for process in (site.guardian, site.router):
            process.kill()
            process.wait()
        site.start_router()
        bus = await open_bus(site.endpoint)
        try:
            await wait_for_latches(bus, "tester", "router")
            reset = EstopReset(event="e1", actor="tester")
            bus.put(FleetKeys("f").estop_reset, reset.to_json(), Priority.EVENT)
            await wait_for_latches(bus, None, "router")
        finally:
            await bus.close()

    asyncio.run(send_estop())
    asyncio.run(restart_keepers())
