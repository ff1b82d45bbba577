"""Puts as clients of EPICS make them, wrong ones too: each has an end, in the way of its protocol."""

import asyncio
import os
import signal
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import pytest
from aioca import CANothing, caget, caput, purge_channel_caches
from ecosystem.epics_server import CA_PORT, PVA_PORT, free_ports, serving
from ecosystem.waits import wait_until
from epicscorelibs.ca.cadef import CAException
from p4p.client.thread import Context, RemoteError
from p4p.nt import NTURI, NTTable

from integrations.epics.server import ServerSettings
from tutti import JobFailed, Refusal
from tutti.testing import LiveTestbed

pytestmark = pytest.mark.nightly
X, Y, U = "demo:gantry:x", "demo:gantry:y", "demo:stage:u"
WAITING = "import sys; sys.stdin.read()"


@pytest.fixture(scope="module")
def server(demo_fleet: LiveTestbed) -> Iterator[LiveTestbed]:
    with serving(demo_fleet.endpoint, ServerSettings(pva_port=PVA_PORT, ca_port=CA_PORT)):
        yield demo_fleet


@pytest.fixture
def client(server: LiveTestbed) -> Iterator[Context]:
    with Context("pva") as context:
        yield context
        for name in (X, Y, U):
            context.put(f"{name}.SPMG", "Go")
            context.put(f"{name}.STOP", 1)
        wait_until(lambda: not any(axis.moving for axis in server.tutti.axes().values()))


class Monitor:
    """What a client is sent of DMOV."""

    def __init__(self, client: Context, name: str) -> None:
        self.values: list[float] = []
        self._subscription = client.monitor(name, self._note)
        wait_until(lambda: bool(self.values))

    def _note(self, value: Any) -> None:
        if not isinstance(value, Exception) and (not self.values or float(value) != self.values[-1]):
            self.values.append(float(value))

    def close(self) -> list[float]:
        """All of it, once DMOV is 1: the answer to a put may come before."""
        wait_until(lambda: self.values[-1] == 1)
        self._subscription.close()
        return self.values


@contextmanager
def other_client(code: str) -> Iterator[subprocess.Popen[str]]:
    """A client in a process of its own, which is killed at the end; it has begun when it prints a line."""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None and process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.communicate()


def move(client: Context, name: str, target: float) -> None:
    client.put(f"{name}.VAL", target, wait=True, timeout=60)


def background_put(client: Context, name: str, value: float) -> "Future[None]":
    """A put with completion in a thread; its result is None, or raises."""
    ended: Future[None] = Future()

    def put() -> None:
        try:
            client.put(name, value, wait=True, timeout=60)
            ended.set_result(None)
        except BaseException as error:
            ended.set_exception(error)

    threading.Thread(target=put, daemon=True).start()
    return ended


def can_enable(server: LiveTestbed) -> bool:
    """Switch the motors on; the coordinator sees a moment later that an e-stop is released."""
    try:
        server.tutti.enable()
    except Refusal as error:
        assert "e-stop" in error.text
        return False
    return True


def test_dmov_pulses_once_for_each_put(client: Context) -> None:
    move(client, X, 20)
    dmov = Monitor(client, f"{X}.DMOV")
    for target in (25, 25, 20):
        move(client, X, target)
    assert dmov.close() == [1, 0, 1, 0, 1, 0, 1]


def test_the_readback_is_that_of_the_end_of_the_put(client: Context) -> None:
    for number in range(20):
        target = 20 + number % 3
        move(client, X, target)
        assert float(client.get(f"{X}.RBV")) == pytest.approx(target, abs=0.002)


def test_a_put_without_completion_returns_at_once_and_retargets(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    dmov = Monitor(client, f"{X}.DMOV")
    began_s = time.monotonic()
    client.put(f"{X}.VAL", 150)
    assert time.monotonic() - began_s < 0.5
    wait_until(lambda: server.tutti.position("gantry.x") > 30)
    move(client, X, 60)
    assert server.tutti.position("gantry.x") == pytest.approx(60, abs=0.002)
    assert dmov.close() == [1, 0, 1]


def test_targets_at_1_khz_end_at_the_newest(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    dmov = Monitor(client, f"{X}.DMOV")
    puts = [background_put(client, f"{X}.VAL", 50 + number / 100) for number in range(30)]

    def flood(first: int) -> None:
        for number in range(100):
            client.put(f"{X}.VAL", 20 + (first + number) % 60)

    floods = [threading.Thread(target=flood, args=(first,)) for first in range(10)]
    for thread in floods:
        thread.start()
    for thread in floods:
        thread.join()
    assert [put.result(30) for put in puts] == [None] * len(puts)
    wait_until(lambda: int(client.get(f"{X}.DMOV")) == 1)
    assert server.tutti.position("gantry.x") == pytest.approx(float(client.get(f"{X}.VAL")), abs=0.002)
    assert set(zip(dmov.values, dmov.close()[1:], strict=False)) == {(1, 0), (0, 1)}


def test_what_is_no_position_is_refused_in_words(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    for value, text in (
        (float("nan"), "cannot be nan"),
        (float("inf"), "cannot be inf"),
        (1e4, "is outside its limits"),
    ):
        with pytest.raises(RemoteError, match=text):
            client.put(f"{X}.VAL", value, wait=True)
    with pytest.raises((RemoteError, ValueError)):
        client.put(f"{X}.VAL", "far", wait=True)
    with pytest.raises(RemoteError, match="read only"):
        client.put(f"{X}.RBV", 1.0)
    assert int(client.get(f"{X}.LVIO")) == 1
    assert server.tutti.position("gantry.x") == pytest.approx(20, abs=0.002)
    move(client, X, 21)
    assert int(client.get(f"{X}.LVIO")) == 0


def test_an_axis_that_a_job_has_is_not_moved(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    with server.tutti.live("gantry.x", name="alignment"):
        dmov = Monitor(client, f"{X}.DMOV")
        with pytest.raises(RemoteError, match="gantry"):
            move(client, X, 30)
        assert dmov.close() == [1, 0, 1]
        assert int(client.get(f"{X}.LVIO")) == 0
    assert client.get(f"{X}.VAL").severity == 1 and "gantry" in client.get(f"{X}.VAL").raw.alarm.message
    move(client, X, 21)
    assert client.get(f"{X}.VAL").severity == 0


def test_stop_ends_the_job_of_another_client(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    with pytest.raises(JobFailed, match="cancelled by epics"), server.tutti.live("gantry.x", speed=0.2) as live:
        threading.Timer(0.5, lambda: client.put(f"{X}.STOP", 1)).start()
        live.move({"gantry.x": 300})
    wait_until(lambda: not server.tutti.axes()["gantry.x"].moving)
    assert server.tutti.position("gantry.x") < 250


def test_two_clients_of_one_axis(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    with Context("pva") as second:
        first_put = background_put(client, f"{X}.VAL", 100)
        wait_until(lambda: server.tutti.position("gantry.x") > 25)
        move(second, X, 40)
        assert first_put.result(10) is None
    assert server.tutti.position("gantry.x") == pytest.approx(40, abs=0.002)


def test_estop_and_reset(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    put = background_put(client, f"{X}.VAL", 300)
    wait_until(lambda: server.tutti.position("gantry.x") > 25)
    client.put("demo:ESTOP", 1, wait=True)
    try:
        assert isinstance(put.exception(10), RemoteError)
        assert int(client.get("demo:ESTOP")) == 1 and client.get("demo:STATE").raw.value == "e-stop"
        with pytest.raises(RemoteError, match="e-stop"):
            move(client, X, 30)
    finally:
        client.put("demo:RESET", 1, wait=True)
    assert int(client.get("demo:ESTOP")) == 0
    wait_until(lambda: can_enable(server))
    server.tutti.home()
    server.tutti.start_queue()  # an e-stop stops it
    move(client, X, 20)


def test_a_jog_lasts_until_0_and_until_its_client_is_gone(client: Context, server: LiveTestbed) -> None:
    move(client, U, 5)
    jog = background_put(client, f"{U}.JOGF", 1)
    wait_until(lambda: server.tutti.position("stage.u") > 5.5)
    client.put(f"{U}.JOGF", 0)
    assert jog.result(10) is None
    assert float(client.get(f"{U}.VAL")) == pytest.approx(server.tutti.position("stage.u"), abs=0.002)
    begin = f"from p4p.client.thread import Context\nc = Context('pva')\nc.put('{U}.JOGF', 1)\nprint('jogs', flush=True)\n{WAITING}"
    move(client, U, 5)
    watch = client.get(f"{U}.JOGF")  # a client that only looks does not hold it
    assert int(watch) == 0
    with other_client(begin) as process:
        wait_until(lambda: server.tutti.position("stage.u") > 5.5)
        process.kill()
        wait_until(lambda: not server.tutti.axes()["stage.u"].moving, 3)
    wait_until(lambda: int(client.get(f"{U}.DMOV")) == 1)
    assert int(client.get(f"{U}.JOGF")) == 0


def test_a_jog_by_channel_access_ends_with_its_client(client: Context, server: LiveTestbed) -> None:
    move(client, U, 5)
    begin = (
        "import asyncio\nfrom aioca import caput\n"
        f"async def main():\n    await caput('{U}.JOGF', 1)\n    print('jogs', flush=True)\n    await asyncio.sleep(60)\nasyncio.run(main())"
    )
    with other_client(begin) as process:
        wait_until(lambda: server.tutti.position("stage.u") > 5.5)
        process.kill()
        wait_until(lambda: not server.tutti.axes()["stage.u"].moving, 3)
    wait_until(lambda: int(client.get(f"{U}.DMOV")) == 1)


def test_a_move_goes_on_without_its_client(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    begin = f"from p4p.client.thread import Context\nc = Context('pva')\nc.put('{X}.VAL', 90)\nprint('moves', flush=True)\nc.put('{X}.VAL', 90, wait=True)\n{WAITING}"
    with other_client(begin) as process:
        wait_until(lambda: server.tutti.position("gantry.x") > 25)
        process.kill()
    wait_until(lambda: int(client.get(f"{X}.DMOV")) == 1)
    assert server.tutti.position("gantry.x") == pytest.approx(90, abs=0.002)


def test_home_set_and_offset(client: Context, server: LiveTestbed) -> None:
    move(client, U, 1)
    client.put(f"{U}.SET", "Set")
    client.put(f"{U}.VAL", 11.0, wait=True)
    client.put(f"{U}.SET", "Use")
    assert float(client.get(f"{U}.OFF")) == pytest.approx(10, abs=0.001)
    assert float(client.get(f"{U}.HLM")) == pytest.approx(60, abs=0.001)
    move(client, U, 12)
    assert float(client.get(f"{U}.DRBV")) == pytest.approx(2, abs=0.002)
    client.put(f"{U}.OFF", 0.0, wait=True)
    assert server.tutti.position("stage.u") == pytest.approx(2, abs=0.002)
    client.put(f"{U}.CNEN", "Disable", wait=True)
    with pytest.raises(RemoteError, match="enabled"):
        move(client, U, 3)
    client.put(f"{U}.CNEN", "Enable", wait=True)
    client.put(f"{U}.HOMF", 1, wait=True, timeout=60)
    assert int(client.get(f"{U}.HOMF")) == 0
    move(client, U, 3)


def test_the_queue_and_a_job_as_text(client: Context, server: LiveTestbed) -> None:
    uri = NTURI([("job", "s")])

    def submit(text: str) -> str:
        return client.rpc("demo:SUBMIT", uri.wrap("demo:SUBMIT", kws={"job": text})).raw.value

    job = "schema: tutti.job/1\nname: from-epics\nsteps:\n  - {do: dwell, duration: 3 s}\n"
    job_id = submit(job)
    wait_until(lambda: job_id in [row["id"] for row in NTTable.unwrap(client.get("demo:QUEUE"))])
    (row,) = [row for row in NTTable.unwrap(client.get("demo:QUEUE")) if row["id"] == job_id]
    assert (row["name"], row["by"]) == ("from-epics", "epics")
    server.tutti.job(job_id).result()
    for text, words in (
        ("steps: 7", "steps"),
        ("", "job"),
        (job.replace("dwell", "dance"), "dance"),
        ("{", "not YAML"),
    ):
        with pytest.raises(RemoteError, match=words):
            submit(text)
    with pytest.raises(RemoteError, match="in a file"):
        submit("schema: tutti.job/1\nname: a\nsteps:\n  - {do: scan, points: {file: /etc/passwd}}\n")


def test_puts_by_channel_access(client: Context, server: LiveTestbed) -> None:
    async def check() -> None:
        await caput(f"{X}.VAL", 25, wait=True, timeout=20)
        assert await caget(f"{X}.RBV") == pytest.approx(25, abs=0.002)
        for value in (float("nan"), 1e4, "far"):
            with pytest.raises(CANothing):
                await caput(f"{X}.VAL", value, wait=True, timeout=5)
        with pytest.raises(CANothing):
            await caput(f"{X}.SPMG", 9, wait=True, timeout=5)
        with pytest.raises(CAException, match="Write access denied"):
            await caput(f"{X}.RBV", 3, wait=True, timeout=5)
        assert await caget(f"{X}.LVIO") == 1
        assert await caget(X) == 25
        while await caget("demo:STATE") != "idle":
            await asyncio.sleep(0.1)

    async def main() -> None:
        try:
            await check()
        finally:
            purge_channel_caches()

    asyncio.run(main())
    assert server.tutti.position("gantry.x") == pytest.approx(25, abs=0.002)


def test_a_flood_of_searches_delays_no_move(client: Context, server: LiveTestbed) -> None:
    move(client, X, 20)
    end_event = threading.Event()

    def flood() -> None:
        name = b"absent:pv:name\0"
        search = struct.pack(">HHHHII", 6, len(name), 5, 13, 1, 1) + name
        garbage = os.urandom(60)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not end_event.is_set():
                for _ in range(20):
                    sender.sendto(search * 10, ("127.0.0.1", CA_PORT))
                    sender.sendto(garbage, ("127.0.0.1", CA_PORT))
                time.sleep(0.005)

    flooding = threading.Thread(target=flood)
    flooding.start()
    try:
        began_s = time.monotonic()
        for target in (25, 20, 25, 20):
            move(client, X, target)
        assert time.monotonic() - began_s < 10
    finally:
        end_event.set()
        flooding.join()


def test_a_killed_server_stops_its_axes(demo_fleet: LiveTestbed) -> None:
    pva_port, ca_port = free_ports(2)
    words = [
        "epics",
        "serve",
        "--connect",
        demo_fleet.endpoint,
        "--pva-port",
        str(pva_port),
        "--ca-port",
        str(ca_port),
        "--json",
    ]
    code = f"import sys; sys.argv = ['tutti', *{words!r}]\nfrom orchestrator.cli.entry import main\nmain()"
    demo_fleet.tutti.move({"gantry.x": 20})
    with (
        other_client(code) as process,
        Context("pva", conf={"EPICS_PVA_NAME_SERVERS": f"127.0.0.1:{pva_port}"}, useenv=False) as client,
    ):
        client.put(f"{X}.VAL", 300)
        wait_until(lambda: demo_fleet.tutti.position("gantry.x") > 30)
        process.send_signal(signal.SIGKILL)
        wait_until(lambda: not demo_fleet.tutti.axes()["gantry.x"].moving, 5)
        assert demo_fleet.tutti.position("gantry.x") < 250
    wait_until(
        lambda: (
            not [
                job
                for job in demo_fleet.tutti.list_jobs(5)
                if job.state not in ("done", "cancelled", "failed", "aborted")
            ]
        )
    )


def test_a_put_takes_no_longer_than_a_move_of_the_fleet(client: Context, server: LiveTestbed) -> None:
    put_s, move_s = list[float](), list[float]()
    for number in range(50):
        for position, durations in ((30 + number % 2, put_s), (32 + number % 2, move_s)):
            began_s = time.monotonic()
            if durations is put_s:
                move(client, X, position)
            else:
                server.tutti.move({"gantry.x": position})
            durations.append(time.monotonic() - began_s)
    ratio = statistics.median(put_s) / statistics.median(move_s)
    assert ratio <= 1.1, (put_s, move_s)
