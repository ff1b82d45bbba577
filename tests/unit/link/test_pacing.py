"""Pacing of a simulated serial line, in virtual time."""

import asyncio

from orchestrator.clock.base import sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from sim.link.pacing import PacedLine

CHAR_NS = 1000


def test_lines_arrive_each_at_its_own_end_and_in_order() -> None:
    arrived: list[tuple[int, bytes]] = []

    async def test(clock: VirtualClock) -> None:
        line = PacedLine(clock, CHAR_NS, lambda data: arrived.append((clock.now_ns(), data)))
        begun_ns = clock.now_ns()
        line.queue_lines(b"AB\rCDE\rF")
        assert line.waiting == 8
        await sleep_until_ns(clock, begun_ns + 5 * CHAR_NS)
        line.queue_bytes(b"G")
        await asyncio.sleep(1)
        assert line.waiting == 0
        line.queue_bytes(b"H")
        await asyncio.sleep(1)
        assert [(at_ns - begun_ns, data) for at_ns, data in arrived[:-1]] == [
            (3 * CHAR_NS, b"AB\r"),
            (7 * CHAR_NS, b"CDE\r"),
            (8 * CHAR_NS, b"F"),
            (9 * CHAR_NS, b"G"),
        ]

    run_virtual(test)
    assert arrived[-1][1] == b"H"


def test_unsent_bytes_of_a_sender_without_power_are_lost() -> None:
    arrived: list[tuple[int, bytes]] = []

    async def test(clock: VirtualClock) -> None:
        line = PacedLine(clock, CHAR_NS, lambda data: arrived.append((clock.now_ns() - begun_ns, data)))
        begun_ns = clock.now_ns()
        line.queue_bytes(b"AB\r")
        line.queue_bytes(b"CDEFG\r")
        line.queue_bytes(b"HI\r")
        await sleep_until_ns(clock, begun_ns + 5 * CHAR_NS)
        silent_ns = clock.now_ns()
        line.cut_transmission(silent_ns)
        assert line.waiting == 0
        line.queue_bytes(b"J")
        line.cut_transmission(silent_ns)
        await asyncio.sleep(1)

    run_virtual(test)
    assert arrived == [(3 * CHAR_NS, b"AB\r"), (5 * CHAR_NS, b"CD"), (6 * CHAR_NS, b"J")]
