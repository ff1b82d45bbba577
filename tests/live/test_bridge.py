"""A simulated SHRC-203 behind a TCP serial bridge: by plain sockets, and as a fleet that `tutti up --sim` runs."""

import asyncio
import socket
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from children import LIMIT_S, Children, tell, wait_until
from fleet import free_port

from orchestrator.client import Tutti
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport
from orchestrator.runtime.live.fleet import LiveFleet
from orchestrator.runtime.live.run import FleetRun

pytestmark = pytest.mark.live

BAUD = 9600
CHAR_S = 10 / BAUD


def client(place: dict[str, Any]) -> socket.socket:
    return socket.create_connection((place["host"], place["port"]), timeout=LIMIT_S)


def line(connection: socket.socket) -> bytes:
    """One line of the controller."""
    received = b""
    while not received.endswith(b"\n"):
        data = connection.recv(1)
        assert data, "the bridge hung up"
        received += data
    return received


def bridge(children: Children, baud: int = BAUD) -> tuple[Any, dict[str, Any]]:
    return children.simulator("shrc203", "tcp:127.0.0.1:0", "--baud", str(baud))


def test_an_exchange_takes_its_time_on_the_serial_side(children: Children) -> None:
    _, place = bridge(children)
    with client(place) as one:
        begun_s = time.monotonic()
        one.sendall(b"*IDN?\r\n")
        answer = line(one)
        took_s = time.monotonic() - begun_s
    assert answer.startswith(b"SIGMAKOKI,SHRC-203")
    assert (len(b"*IDN?\r\n") + len(answer)) * CHAR_S <= took_s < 1.5


def test_connections_share_the_line_and_closing_one_keeps_the_others(children: Children) -> None:
    _, place = bridge(children)
    with client(place) as one:
        with client(place) as other:
            other.sendall(b"?:N\r\n")
            assert line(one) == line(other) == b"SHRC-203\r\n"
        one.sendall(b"?:MODE\r\n")
        assert line(one) == b"HOST\r\n"


def test_a_client_that_sends_faster_than_the_line_loses_nothing(children: Children) -> None:
    _, place = bridge(children, 38400)
    asked = 900  # hundreds of characters more than the bridge keeps
    with client(place) as one:
        one.sendall(b"?:N\r\n" * asked)
        for _ in range(asked):
            assert line(one) == b"SHRC-203\r\n"


def test_the_line_is_still_there_after_a_power_cycle(children: Children) -> None:
    process, place = bridge(children)
    with client(place) as one:
        tell(process, power=False)
        tell(process, power=True)
        one.settimeout(0.1)

        def answers() -> bool:
            one.sendall(b"?:N\r\n")
            with suppress(TimeoutError):  # it begins to answer a while after it has power
                return line(one) == b"SHRC-203\r\n"
            return False

        wait_until(answers, "it answers on the same connection")


def fleet() -> Fleet:
    axis = {
        "unit": "mm",
        "scale": 10_000,
        "limits": {"velocity": 8, "acceleration": 40},
        "start_rate": {"min": 0.01, "max": 0.4},
        "homing": {"speed": 2},
    }
    stage = {
        "adapter": "shrc203",
        "link": {"kind": "tcp", "host": "192.168.1.30", "port": 4001},
        "options": {"bridge_baud": 19200, "nm_per_pulse": 100},
        "simulate": {
            "options": {"divide": 20, "speed": [100, 20_000, 100], "origin_speed": [100, 20_000, 100]},
            "decode_us": 500,
            "spread_us": 500,
        },
        "axes": {"u": {**axis, "motors": ["1"]}, "v": {**axis, "motors": ["2"]}},
    }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "bridged", "controllers": {"stage": stage}})


STEPS = [
    {"do": "enable", "axes": ["stage"]},
    {"do": "home"},
    {"do": "move", "to": {"stage.u": 2, "stage.v": -1}},
]


@pytest.mark.nightly
def test_a_fleet_with_a_bridge_homes_and_moves(tmp_path: Path) -> None:
    async def main() -> JobReport:
        live = LiveFleet(fleet(), tmp_path / "state", lambda _: None, FleetRun(port=free_port(), simulated=True))
        await live.start()
        try:
            async with Tutti(live.connect, "bridged") as tutti:
                job = Job.model_validate(
                    {"schema": "tutti.job/1", "name": "bridge", "max_start_skew": "50 ms", "steps": STEPS}
                )
                async with asyncio.timeout(60):
                    return await tutti.wait_for_job(await tutti.submit(job))
        finally:
            await live.close()

    report = asyncio.run(main())
    assert report.state == "done", report
