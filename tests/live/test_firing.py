"""The firing process writes at its instant, to a real socket, or not at all."""

# pyright: reportPrivateUsage=false

import asyncio
import signal
import socket
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from children import LIMIT_S

from adapters.host.timed_writer import ProcessTimedWriter
from adapters.link.open import make_link_opener
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.live import LiveClock, raw_ns
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.links import TcpLink

pytestmark = pytest.mark.live

SOON_NS = 50 * NS_PER_MS
GENEROUS_NS = 500 * NS_PER_MS


class Bench:
    """A firer, a link, and the far end of the link."""

    def __init__(self, firer: ProcessTimedWriter, link: Link, far: socket.socket) -> None:
        self.firer = firer
        self.link = link
        self.far = far

    async def heard(self) -> bytes:
        return await asyncio.get_running_loop().sock_recv(self.far, 100)


def run(test: Callable[[Bench], Coroutine[Any, Any, None]]) -> None:
    async def limited() -> None:
        loop = asyncio.get_running_loop()
        with socket.create_server(("127.0.0.1", 0)) as server:
            server.setblocking(False)
            link = await make_link_opener(TcpLink(host="127.0.0.1", port=server.getsockname()[1]), LiveClock())()
            far, _ = await loop.sock_accept(server)
        firer = ProcessTimedWriter()
        try:
            far.setblocking(False)
            async with asyncio.timeout(LIMIT_S):
                # The first request waits for the process to start.
                start_ns = raw_ns()
                await firer.schedule_write(link, b"first", start_ns, start_ns + 60_000 * NS_PER_MS).wait_until_written()
                assert await loop.sock_recv(far, 100) == b"first"
                await test(Bench(firer, link, far))
        finally:
            far.close()
            await link.close()
            firer.close()

    asyncio.run(limited())


def test_it_writes_at_its_instant() -> None:
    late_ns: list[int] = []

    async def test(bench: Bench) -> None:
        for _ in range(40):
            at_ns = raw_ns() + 10 * NS_PER_MS
            fired = await bench.firer.schedule_write(
                bench.link, b"BG\r", at_ns, at_ns + GENEROUS_NS
            ).wait_until_written()
            assert not fired.late
            assert await bench.heard() == b"BG\r"
            late_ns.append(fired.written_ns - at_ns)

    run(test)
    late_ns.sort()
    assert late_ns[0] >= 0
    assert late_ns[20] < 5 * NS_PER_MS


def test_cancelled_bytes_are_not_sent() -> None:
    async def test(bench: Bench) -> None:
        at_ns = raw_ns() + GENEROUS_NS
        order = bench.firer.schedule_write(bench.link, b"cancelled", at_ns, at_ns + GENEROUS_NS)
        assert order.cancel_write()
        with pytest.raises(asyncio.CancelledError):
            await order.wait_until_written()
        soon_ns = raw_ns() + SOON_NS
        await bench.firer.schedule_write(bench.link, b"next", soon_ns, soon_ns + GENEROUS_NS).wait_until_written()
        assert await bench.heard() == b"next"

    run(test)


def test_late_bytes_are_not_sent() -> None:
    async def test(bench: Bench) -> None:
        past_ns = raw_ns() - SOON_NS
        fired = await bench.firer.schedule_write(bench.link, b"late", past_ns, past_ns + 1).wait_until_written()
        assert fired.late
        soon_ns = raw_ns() + SOON_NS
        await bench.firer.schedule_write(bench.link, b"next", soon_ns, soon_ns + GENEROUS_NS).wait_until_written()
        assert await bench.heard() == b"next"

    run(test)


def test_a_link_closed_meanwhile_is_reported() -> None:
    async def test(bench: Bench) -> None:
        at_ns = raw_ns() + SOON_NS
        order = bench.firer.schedule_write(bench.link, b"into the void", at_ns, at_ns + GENEROUS_NS)
        await bench.link.close()
        with pytest.raises(LinkClosed):
            await order.wait_until_written()

    run(test)


def test_a_firing_process_that_hangs_is_killed_and_its_writes_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adapters.host.timed_writer.ANSWER_S", 0.2)

    async def main(bench: Bench) -> None:
        assert bench.firer.is_alive and bench.firer.answer_s == 0.2
        bench.firer._process.send_signal(signal.SIGSTOP)
        at_ns = raw_ns() + SOON_NS
        order = bench.firer.schedule_write(bench.link, b"GO", at_ns, at_ns + SOON_NS)
        with pytest.raises(LinkClosed, match="the firing process has died"):
            await order.wait_until_written()
        assert not bench.firer.is_alive

    run(main)
