"""Two routers that carry for each other: one is lost while the fleet moves."""

import asyncio
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from children import LIMIT_S, wait_until
from fleet import COMMAND, EXAMPLES, READY, RunningFleet, free_port, margin_s

from orchestrator.bus.base import Bus, BusSample, NoReply, RequestTimeout
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.sessions import open_session
from orchestrator.client import Tutti
from orchestrator.clock.live import raw_ns
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.state import ControllerState

pytestmark = pytest.mark.live
LOST_S, OPEN_S, BUSY_S = 10.0, 2.0, 3.0


def start_router(folder: Path, own: str, other: str) -> "subprocess.Popen[str]":
    said = folder / f"router-{own.rpartition(':')[2]}.out"
    with said.open("w") as out:
        command = [*COMMAND, "router", "--listen", own, "--link", other]
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, text=True)
    wait_until(lambda: "router on" in said.read_text() or process.poll() is not None, "the router listens")
    return process


def write_fleet(folder: Path, routers: list[str]) -> Path:
    path = folder / "demo.fleet.json"
    fleet = load_fleet(EXAMPLES / "demo.fleet.yaml").model_copy(update={"routers": routers})
    path.write_bytes(fleet.to_json())
    return path


@pytest.mark.nightly
def test_a_fleet_goes_on_through_its_second_router(tmp_path: Path) -> None:
    """Sessions are back before the coordinator counts as lost, or the axes stop; either way the fleet works on."""
    first, second = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    routers = [start_router(tmp_path, first, second), start_router(tmp_path, second, first)]
    fleet = RunningFleet(tmp_path, write_fleet(tmp_path, [first, second]))
    fleet.endpoint = second
    try:
        fleet.started().ready()
        job_id = fleet.slow_move([{"do": "move", "to": {"gantry.x": 201, "stage.u": 21}, "speed": 0.1}])  # some 20 s
        routers[0].send_signal(signal.SIGKILL)
        routers[0].wait(LIMIT_S)
        report = fleet.wait(job_id)
        assert report.state == "done" or "silent" in report.reason or "answers" in report.reason, report.reason
        fleet.ready()
        assert fleet.run(READY).state == "done"

        routers[0] = start_router(tmp_path, first, second)

        async def look(tutti: Tutti) -> dict[str, ControllerState]:
            async with Tutti(first, "demo", "test") as other:
                return await other.status(1.0)

        wait_until(lambda: len(fleet.ask(look)) == 2, "the first router carries for the second one")
    finally:
        fleet.close()
        for each in routers:
            each.terminate()
            each.wait(LIMIT_S)


@pytest.mark.nightly
def test_a_session_does_not_wait_for_a_router_that_is_silent(tmp_path: Path) -> None:
    """Zenoh notices after 10 s that it is, and would then wait as long for it to open a session again."""
    first, second = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    routers = [start_router(tmp_path, first, second), start_router(tmp_path, second, first)]
    session = open_session(f"{first},{second}")
    try:
        (silent,) = session.info.routers_zid()
        routers[0].send_signal(signal.SIGSTOP)
        stopped_ns = raw_ns()
        wait_until(lambda: bool({*session.info.routers_zid()} - {silent}), "it is with the second router")
        assert margin_s(stopped_ns, raw_ns()) < LOST_S + OPEN_S + BUSY_S
    finally:
        routers[0].send_signal(signal.SIGCONT)
        session.close()
        for each in routers:
            each.terminate()
            each.wait(LIMIT_S)


KEY, ASK_S = "demo/ctl/gantry/cmd/info", 1.0


@contextmanager
def relay_to(port: int) -> Iterator[tuple[int, "subprocess.Popen[str]"]]:
    """A relay to a port of this computer: its own port, and its process, which takes commands."""
    own = free_port()
    words = [sys.executable, str(Path(__file__).parent / "relay.py"), str(own), "127.0.0.1", str(port)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == "ready\n"
            yield own, process
        finally:
            process.terminate()


def say(relay: "subprocess.Popen[str]", word: str) -> None:
    assert relay.stdin is not None and relay.stdout is not None
    relay.stdin.write(f"{word}\n")
    relay.stdin.flush()
    assert relay.stdout.readline() == f"{word}\n"


async def answer(_: BusSample) -> bytes:
    return b"here"


async def wait_for(bus: Bus, *, served: bool, limit_s: float = LIMIT_S) -> None:
    """Ask until the controllers of a host are served, or until they are not."""
    async with asyncio.timeout(limit_s):
        while True:
            with suppress(NoReply, RequestTimeout):
                await bus.request(KEY, b"", ASK_S)
                if served:
                    return
                continue
            if not served:
                return


def test_what_two_hosts_served_is_served_on_when_one_has_ended_and_the_link_is_lost(tmp_path: Path) -> None:
    """Hosts of a fleet without keys serve all controllers with one key expression; the router of the one that has ended
    learns of the other one again."""
    first, second = free_port(), free_port()

    async def main(relay: "subprocess.Popen[str]") -> None:
        asking, ending = [await open_bus(f"tcp/127.0.0.1:{first}") for _ in range(2)]
        staying = await open_bus(f"tcp/127.0.0.1:{second}")
        try:
            await staying.serve("demo/ctl/**", answer)
            await wait_for(asking, served=True)
            await (await ending.serve("demo/ctl/**", answer)).undeclare()
            say(relay, "cut")
            await wait_for(asking, served=False)
            say(relay, "mend")
            await wait_for(asking, served=True)
        finally:
            for bus in (asking, ending, staying):
                await bus.close()

    with relay_to(second) as (relayed, relay):
        routers = [
            start_router(tmp_path, f"tcp/127.0.0.1:{own}", f"tcp/127.0.0.1:{other}")
            for own, other in ((first, relayed), (second, free_port()))
        ]
        try:
            asyncio.run(main(relay))
        finally:
            for each in routers:
                each.terminate()
                each.wait(LIMIT_S)
