"""The live job of a socket."""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from cluster.gateway_client import Socket, VirtualGateway, run_with_gateway
from cluster.worlds import PREPARE, outcome

from orchestrator.runtime.virtual.fleet import VirtualFleet


async def open_socket(fleet: VirtualFleet, folder: Path) -> Socket:
    await outcome(fleet, PREPARE)
    gateway = VirtualGateway(fleet, folder)
    await gateway.start()
    return await gateway.connect()


async def wait_alive(socket: Socket, **fields: Any) -> dict[str, Any]:
    """Wait for a `live` frame with these fields; signs of life are sent meanwhile."""
    async with asyncio.timeout(60):
        while True:
            for frame in socket.frames:
                if "live" in frame and frame["live"].items() >= fields.items():
                    return frame["live"]
            socket.send("alive")
            await asyncio.sleep(0.1)


def test_a_socket_has_a_live_job(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        socket = await open_socket(fleet, tmp_path)
        begun = await socket.ask("live-begin", axes=["gantry"], name="by frames")
        job_id = begun["ok"]["job_id"]
        moves = [{"do": "move", "to": {"gantry.x": x}, "speed": 1} for x in (5, 10)]
        assert (await socket.ask("live-ask", steps=moves))["ok"]["numbers"] == [0, 1]
        result = await wait_alive(socket, number=1)
        assert result["state"] == "done" and result["positions"]["gantry.x"]["position"] == pytest.approx(10, abs=0.01)
        assert (await socket.ask("live-ask", steps=[{"do": "move", "to": {"gantry.y": 1}}]))["ok"]["numbers"] == [2]
        assert (await wait_alive(socket, number=2))["state"] == "done"
        await socket.ask("live-end")
        assert (await wait_alive(socket, ended="done"))["job_id"] == job_id
        assert (await socket.ask("live-ask", steps=moves))["refused"]["code"] == "ended"

    run_with_gateway(main)


def test_it_is_stopped_and_goes_on(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        socket = await open_socket(fleet, tmp_path)
        await socket.ask("live-begin", axes=["gantry"])
        await socket.ask("live-ask", steps=[{"do": "move", "to": {"gantry.x": 300}, "speed": 0.1}])
        await asyncio.sleep(0.8)
        await socket.ask("live-stop")
        assert (await wait_alive(socket, number=0))["state"] == "stopped"
        await socket.ask("live-ask", steps=[{"do": "move", "by": {"gantry.x": 1}}])
        assert (await wait_alive(socket, number=1))["state"] == "done"

    run_with_gateway(main)


@pytest.mark.parametrize("closes", [True, False])
def test_it_ends_with_its_socket_and_with_its_silence(tmp_path: Path, closes: bool) -> None:
    async def main(fleet: VirtualFleet) -> None:
        socket = await open_socket(fleet, tmp_path)
        await socket.ask("live-begin", axes=["gantry"])
        await socket.ask("live-ask", steps=[{"do": "move", "to": {"gantry.x": 300}, "speed": 0.1}])
        await asyncio.sleep(0.5)
        if closes:
            socket.close()
        await asyncio.sleep(3.5)
        assert not fleet.controllers["gantry"].is_moving("X")
        jobs = await fleet.make_client().list_jobs(1)
        # Of a socket that is silent the adapters stop the step, before the job is cancelled.
        assert jobs.jobs[0].state == ("cancelled" if closes else "aborted")

    run_with_gateway(main)


@pytest.mark.parametrize(
    ("verb", "fields", "code"),
    [
        ("live-begin", {}, "bad-request"),
        ("live-begin", {"axes": "gantry"}, "bad-request"),
        ("live-begin", {"axes": ["nothing"]}, "unknown-name"),
        ("live-begin", {"axes": ["gantry"], "gather": "1 h"}, "bad-request"),
        ("live-ask", {"steps": [{"do": "dwell", "duration": "1 s"}]}, "not-begun"),
        ("live-stop", {}, "not-begun"),
        ("live-end", {}, "not-begun"),
    ],
)
def test_wrong_frames_are_refused(tmp_path: Path, verb: str, fields: dict[str, Any], code: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        socket = await open_socket(fleet, tmp_path)
        assert (await socket.ask(verb, **fields))["refused"]["code"] == code

    run_with_gateway(main)


@pytest.mark.parametrize(
    ("steps", "code"),
    [
        (None, "bad-request"),
        (7, "bad-request"),
        ([], "bad-request"),
        ([7], "bad-request"),
        ([{"do": "scan"}], "bad-request"),
        ([{"do": "move", "to": {"stage.u": 1}}], "not-of-job"),
        ([{"do": "move", "to": {"gantry.x": 1}}] * 101, "too-many"),
        ([{"do": "move", "to": {"gantry.x": 1}}, {"do": "move", "to": {"gantry.x": 5000}}], "soft-limit"),
    ],
)
def test_wrong_steps_are_refused_and_it_goes_on(tmp_path: Path, steps: Any, code: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        socket = await open_socket(fleet, tmp_path)
        await socket.ask("live-begin", axes=["gantry"])
        assert (await socket.ask("live-ask", steps=steps))["refused"]["code"] == code
        assert (await socket.ask("live-begin", axes=["stage"]))["refused"]["code"] == "busy"
        assert (await socket.ask("live-ask", steps=[{"do": "move", "to": {"gantry.x": 1}}]))["ok"]["numbers"] == [0]
        assert (await wait_alive(socket, number=0))["state"] == "done"

    run_with_gateway(main)
