"""The two surroundings that the bus contract runs in: virtual time in memory, and real processes over Zenoh."""

import asyncio
import os
import signal
import socket
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, Protocol

from bus_child import behave
from forks import ForkedProcess

from orchestrator.bus.base import Bus, BusSample, Priority
from orchestrator.bus.memory.bus import MemoryNet
from orchestrator.clock.virtual import VirtualClock, run_virtual

LIMIT_S = 20.0
"""Generous: an event that takes longer does not occur."""


async def until(condition: Callable[[], bool]) -> None:
    """Wait for `condition`, which another task or process makes true."""
    async with asyncio.timeout(LIMIT_S):
        while not condition():
            await asyncio.sleep(0.002)


async def request_until(bus: Bus, key: str, wanted: bytes) -> None:
    """Repeat the query until the answer is `wanted`."""
    async with asyncio.timeout(LIMIT_S):
        while await bus.request(key, b"", LIMIT_S) != wanted:
            await asyncio.sleep(0.002)


async def linked(sender: Bus, receiver: Bus) -> None:
    """Wait until the earlier declarations of `receiver` have reached `sender`, for every priority."""
    seen: list[BusSample] = []
    fence = await receiver.subscribe("t/fence", seen.append)
    async with asyncio.timeout(LIMIT_S):
        for priority in Priority:
            while priority.value.encode() not in [sample.payload for sample in seen]:
                sender.put("t/fence", priority.value.encode(), priority)
                await asyncio.sleep(0.002)
    await fence.undeclare()


class World(Protocol):
    """Where sessions are joined, and the faults that can be injected."""

    async def join(self, name: str) -> Bus:
        """A bus of the test itself."""
        ...

    async def peer(self, name: str) -> None:
        """Another process that runs `bus_child.behave`; it is ready when this returns."""
        ...

    def kill(self, name: str) -> None: ...
    def hang(self, name: str) -> None: ...
    def resume(self, name: str) -> None: ...
    def cut(self) -> None: ...
    def heal(self) -> None: ...


class MemoryWorld:
    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.net = MemoryNet(clock, seed=7)
        self._names: list[str] = []

    async def join(self, name: str) -> Bus:
        self._names.append(name)
        return self.net.join_process(name)

    async def peer(self, name: str) -> None:
        await behave(await self.join(name), name)

    def kill(self, name: str) -> None:
        self.net.kill_process(name)

    def hang(self, name: str) -> None:
        self.net.suspend_process(name)

    def resume(self, name: str) -> None:
        self.net.resume_process(name)

    def cut(self) -> None:
        self.net.partition_net(*({name} for name in self._names))

    def heal(self) -> None:
        self.net.heal_partition()


class LiveWorld:
    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        self._children: dict[str, ForkedProcess] = {}
        self._buses: list[Bus] = []

    async def join(self, name: str) -> Bus:
        from orchestrator.bus.zenoh.bus import open_bus

        bus = await open_bus(self.endpoint)
        self._buses.append(bus)
        return bus

    async def peer(self, name: str) -> None:
        self._start(name, "peer", self.endpoint, name)
        # Its presence is declared last: what it serves has reached the router, too.
        present: dict[str, bool] = {}
        bus = self._buses[0] if self._buses else await self.join("observer")
        watch = await bus.watch(f"t/live/{name}", present.__setitem__)
        await until(lambda: present.get(f"t/live/{name}", False))
        await watch.undeclare()

    def kill(self, name: str) -> None:
        child = self._children.pop(name)
        child.kill()
        child.communicate()

    def hang(self, name: str) -> None:
        self._children[name].send_signal(signal.SIGSTOP)

    def resume(self, name: str) -> None:
        self._children[name].send_signal(signal.SIGCONT)

    def cut(self) -> None:
        self.kill("router")

    def heal(self) -> None:
        self._start("router", "router", self.endpoint)

    def pid(self, name: str) -> int:
        """The process number of a child."""
        return self._children[name].pid

    async def leave(self) -> None:
        for bus in self._buses:
            await bus.close()
        for name in list(self._children):
            self.kill(name)

    def _start(self, name: str, *arguments: str) -> None:
        child = ForkedProcess([str(Path(__file__).with_name("bus_child.py")), *arguments], os.environ)
        self._children[name] = child
        assert child.stdout is not None
        assert child.stdout.readline() == "up\n"


Body = Callable[[Any], Coroutine[Any, Any, None]]


def run_memory(body: Body) -> None:
    async def main(clock: VirtualClock) -> None:
        await body(MemoryWorld(clock))

    run_virtual(main)


def run_live(body: Body) -> None:
    async def main() -> None:
        world = LiveWorld()
        try:
            world.heal()
            async with asyncio.timeout(3 * LIMIT_S):
                await body(world)
        finally:
            await world.leave()

    asyncio.run(main())
