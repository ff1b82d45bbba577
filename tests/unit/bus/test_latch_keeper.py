"""Keepers of the e-stop latch: a slow disk delays no process, and the last change is the one on disk."""

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import LatchKeeper
from orchestrator.bus.memory.bus import MemoryNet
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.messages import EstopMessage, EstopReset
from orchestrator.model.state import EstopLatch

T = TypeVar("T")


class SlowStore:
    """Each save takes a second."""

    def __init__(self) -> None:
        self.saved: list[str | None] = []
        self._turn = asyncio.Lock()

    def load(self) -> EstopLatch | None:
        return None

    def save(self, latch: EstopLatch | None) -> None:
        self.saved.append(None if latch is None else latch.event)

    async def execute(self, function: Callable[..., T], *values: Any) -> T:
        async with self._turn:
            await asyncio.sleep(1.0)
            return function(*values)


def test_a_slow_disk_delays_neither_the_latch_nor_its_order() -> None:
    async def main(clock: VirtualClock) -> None:
        net, keys, store = MemoryNet(clock), FleetKeys("demo"), SlowStore()
        keeper = LatchKeeper(net.join_process("keeper"), keys, clock.utc, store, store.execute)
        await keeper.start("keeper")
        sender = net.join_process("sender")
        for event in ("e1", "e2"):
            sender.put(keys.estop, EstopMessage(event=event, actor="anna").to_json())
            await asyncio.sleep(0.01)
            assert keeper.find_event() == event
            sender.put(keys.estop_reset, EstopReset(event=event, actor="anna").to_json())
            await asyncio.sleep(0.01)
            assert keeper.find_event() == ""
        assert store.saved == []
        await keeper.close()
        assert store.saved == ["e1", None, "e2", None]

    run_virtual(main)
