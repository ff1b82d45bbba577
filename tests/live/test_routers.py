"""Two routers that carry for each other: one is lost while the fleet moves."""

import signal
import subprocess
from pathlib import Path

import pytest
from children import LIMIT_S, wait_until
from fleet import COMMAND, EXAMPLES, READY, RunningFleet, free_port, margin_s

from orchestrator.bus.zenoh.sessions import open_session
from orchestrator.client import Tutti
from orchestrator.clock.live import raw_ns
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.state import ControllerState

pytestmark = [pytest.mark.live, pytest.mark.nightly]
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
