"""A wire in memory: which lines were longer on their way than promised, and a port that is opened again at once."""

import asyncio
from collections.abc import Callable
from contextvars import copy_context
from dataclasses import replace

import pytest

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, VirtualProcess, run_virtual
from orchestrator.link.memory import DEFAULT_JITTER_NS, LAN, PIECE_CHARACTERS, FarConnection, MemoryWire, serial_wire
from orchestrator.link.supply import PowerSupply


class Echo:
    """Answers each line with itself.

    arrived_ns: when lines have arrived.
    taken: its one port is open.
    supply: it may lose its power."""

    def __init__(self, clock: VirtualClock) -> None:
        self.arrived_ns: list[int] = []
        self.taken = False
        self.supply = PowerSupply()
        self._clock = clock
        self._send: Callable[[bytes], None] = lambda _: None

    def connect(self, port: str, send: Callable[[bytes], None], closed: Callable[[], None]) -> FarConnection:
        if self.taken:
            raise ValueError("the port is in use")
        self._send, self.taken = send, True
        return self

    def say(self, data: bytes) -> None:
        self._send(data)

    def receive_bytes(self, data: bytes) -> None:
        self.arrived_ns.append(self._clock.now_ns())
        self._send(data)

    def close(self) -> None:
        self.taken = False


def test_lines_that_the_tail_has_kept_are_reported_and_answers_are_not() -> None:
    async def main(clock: VirtualClock) -> None:
        echo = Echo(clock)
        wire = MemoryWire(clock, replace(LAN, tail_chance=0.1), echo, "tcp", "unit", copy_context(), seed=5)
        link = await wire.open_link()
        sent_ns: list[int] = []
        for _ in range(50):
            sent_ns.append(link.write(b"?\r"))
            await sleep_ns(clock, 20 * NS_PER_MS)
        late_ns = [sent for sent, came in zip(sent_ns, echo.arrived_ns, strict=True) if came - sent > DEFAULT_JITTER_NS]
        assert 0 < len(late_ns) < 15 and wire.late_ns == late_ns
        assert wire.delayed_start(late_ns[0]) and wire.delayed_start(late_ns[0] + 200 * NS_PER_MS)
        assert not wire.delayed_start(late_ns[0] - 1) and not wire.delayed_start(late_ns[-1] + NS_PER_S)

    run_virtual(main)


def test_a_port_can_be_opened_as_soon_as_it_is_closed() -> None:
    """The controller receives the one before the other, like bytes."""

    async def main(clock: VirtualClock) -> None:
        wire = MemoryWire(clock, LAN, Echo(clock), "serial", "unit", copy_context())
        for _ in range(20):
            await (await wire.open_link()).close()

    run_virtual(main)


def test_a_link_that_was_given_up_while_the_controller_hung_is_not_opened() -> None:
    async def main(clock: VirtualClock) -> None:
        controller = VirtualProcess(clock.loop, "controller")
        echo = Echo(clock)
        wire = MemoryWire(clock, LAN, echo, "tcp", "unit", controller.run_inside(copy_context))
        controller.freeze()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1.0):
                await wire.open_link()
        controller.resume()
        await sleep_ns(clock, NS_PER_S)
        assert not echo.taken
        await wire.open_link()
        assert echo.taken

    run_virtual(main)


def test_bytes_still_in_a_serial_port_when_power_is_lost_are_never_sent() -> None:
    """Long answers come piece by piece; after the power cut the line is free at once."""

    async def main(clock: VirtualClock) -> None:
        echo = Echo(clock)
        model = serial_wire(9600)
        wire = MemoryWire(clock, model, echo, "serial", "unit", copy_context())
        link = await wire.open_link()
        said = bytes(range(65, 91)) * 20
        begun_ns = clock.now_ns()
        echo.say(said)
        first = await link.read()
        piece_ns = PIECE_CHARACTERS * model.char_ns
        assert first.data == said[:PIECE_CHARACTERS] and first.at_ns - begun_ns >= piece_ns
        await sleep_until_ns(clock, begun_ns + 100 * model.char_ns)
        echo.supply.set_power(on=False, at_ns=clock.now_ns())
        await sleep_until_ns(clock, begun_ns + 200 * model.char_ns)
        echo.say(b"again")
        assert first.data + (await link.read()).data == said[:100]
        again = await link.read()
        assert again.data == b"again" and again.at_ns - begun_ns < 210 * model.char_ns

    run_virtual(main)
