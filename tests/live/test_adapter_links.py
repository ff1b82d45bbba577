"""The adapters' links against simulated controllers, dead ends, and faults that occur on a bench."""

import asyncio
import os
import socket
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from children import LIMIT_S, Children, tell

from adapters.link.open import make_link_opener
from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.link.base import Link, LinkClosed, LinkRefused
from orchestrator.model.links import SerialLink, TcpLink

pytestmark = pytest.mark.live

Test = Callable[[], Coroutine[Any, Any, None]]


def run(test: Test) -> None:
    async def limited() -> None:
        async with asyncio.timeout(LIMIT_S):
            await test()

    asyncio.run(limited())


async def opened(model: TcpLink | SerialLink) -> Link:
    return await make_link_opener(model, LiveClock())()


async def ask(link: Link, command: bytes, end: bytes) -> bytes:
    """Write `command` and read up to `end`; the stamps are in order."""
    last_ns = link.write(command)
    answer = b""
    while not answer.endswith(end):
        received = await link.read()
        assert last_ns <= received.at_ns <= raw_ns()
        answer, last_ns = answer + received.data, received.at_ns
    return answer


def test_tcp_carries_an_exchange_and_reports_when_the_controller_is_gone(children: Children) -> None:
    process, place = children.simulator("smc4000", "tcp:127.0.0.1:0")

    async def test() -> None:
        link = await opened(TcpLink(host=place["host"], port=place["port"]))
        assert float((await ask(link, b"MG 3\r", b":")).split()[0]) == 3
        assert link.char_ns == 0
        assert link.endpoint == place["place"]
        tell(process, power=False)
        with pytest.raises(LinkClosed, match=r"tcp 127\.0\.0\.1:\d+: closed by the other side"):
            await link.read()
        with pytest.raises(LinkClosed):
            link.write(b"ST\r")
        with pytest.raises(LinkClosed):
            link.fileno()
        await link.close()
        await link.close()

    run(test)


def test_a_waiting_read_ends_when_the_link_is_closed(children: Children) -> None:
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0")

    async def test() -> None:
        link = await opened(TcpLink(host=place["host"], port=place["port"]))
        reading = asyncio.create_task(link.read())
        await asyncio.sleep(0)
        await link.close()
        with pytest.raises(LinkClosed):
            await reading

    run(test)


def test_a_ninth_link_is_hung_up(children: Children) -> None:
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0")

    async def test() -> None:
        links = [await opened(TcpLink(host=place["host"], port=place["port"])) for _ in range(8)]
        for link in links:
            await ask(link, b"MG 1\r", b":")
        # Whether the reset comes while it connects or just after is a matter of microseconds.
        with pytest.raises((LinkClosed, LinkRefused)):
            await (await opened(TcpLink(host=place["host"], port=place["port"]))).read()
        for link in links:
            await link.close()

    run(test)


def test_a_full_buffer_closes_the_link_with_its_reason() -> None:
    async def test() -> None:
        with socket.create_server(("127.0.0.1", 0)) as deaf:
            link = await opened(TcpLink(host="127.0.0.1", port=deaf.getsockname()[1]))
            with pytest.raises(LinkClosed, match="buffer is full"):
                for _ in range(100_000):
                    link.write(b"x" * 1000)
            with pytest.raises(LinkClosed, match="buffer is full"):
                await link.read()

    run(test)


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        (TcpLink(host="127.0.0.1", port=1), "tcp 127.0.0.1:1: connection refused; is the controller switched on"),
        (TcpLink(host="no..host", port=1), "tcp no..host:1: the name no..host cannot be resolved"),
        (SerialLink(kind="serial", device="/dev/no-such-port"), "serial /dev/no-such-port: no such device"),
        (SerialLink(kind="serial", device="/dev/null"), "cannot be set to 38400 baud"),
        (SerialLink(kind="serial", device="/etc/hostname"), "is not a serial port"),
    ],
)
def test_a_link_that_cannot_be_opened_reports_where_why_and_what_to_do(
    model: TcpLink | SerialLink, reason: str
) -> None:
    async def test() -> None:
        with pytest.raises(LinkRefused) as refusal:
            await opened(model)
        assert reason in str(refusal.value)

    run(test)


def test_serial_carries_an_exchange_at_the_pace_of_its_wire(children: Children) -> None:
    path = children.folder / "stage"
    children.simulator("shrc203", f"pty:{path}", "--baud", "9600", "--frame", "7O1")

    async def test() -> None:
        model = SerialLink(kind="serial", device=str(path), baud=9600, data_bits=7, parity="odd", rtscts=True)
        link = await opened(model)
        assert link.char_ns == 10 * 10**9 // 9600
        begun_ns = raw_ns()
        answer = await ask(link, b"*IDN?\r\n", b"\n")
        assert answer.startswith(b"SIGMAKOKI")
        assert raw_ns() - begun_ns >= (7 + len(answer)) * link.char_ns
        await link.close()

    run(test)


def test_a_port_in_use_names_its_holder_and_is_free_after_close(children: Children) -> None:
    path = children.folder / "stage"
    process, _ = children.simulator("shrc203", f"pty:{path}")
    model = SerialLink(kind="serial", device=str(path))

    async def test() -> None:
        link = await opened(model)
        with pytest.raises(LinkRefused, match=rf"in use by .*pid {process.pid} .*; end that process first"):
            await opened(model)
        await link.close()
        again = await opened(model)
        await ask(again, b"*IDN?\r\n", b"\n")
        await again.close()

    run(test)


def test_a_port_whose_cable_is_pulled_closes_the_link(children: Children) -> None:
    path = children.folder / "stage"
    process, _ = children.simulator("shrc203", f"pty:{path}")

    async def test() -> None:
        link = await opened(SerialLink(kind="serial", device=str(path)))
        process.kill()
        with pytest.raises(LinkClosed, match=str(path)):
            await link.read()

    run(test)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_a_port_that_is_not_ours_is_refused(tmp_path: Path) -> None:
    locked = tmp_path / "port"
    locked.touch(mode=0)

    async def test() -> None:
        with pytest.raises(LinkRefused, match="dialout"):
            await opened(SerialLink(kind="serial", device=str(locked)))

    run(test)
