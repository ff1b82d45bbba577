"""The processes that the bus contract is tested with. They end when their standard input does.

`bus_child.py router ENDPOINT` or `bus_child.py peer ENDPOINT NAME`; prints `up` when it is ready.
"""

import asyncio
import sys
import threading

from orchestrator.bus.base import Bus, BusSample, Priority, RequestRefused


async def behave(bus: Bus, name: str) -> None:
    """The behaviour of a peer: it counts and keeps the samples on `t/in`, echoes, refuses, and is present."""
    latest = b""
    count = 0

    def take(sample: BusSample) -> None:
        nonlocal latest, count
        latest = sample.payload
        count += 1

    async def answer_latest(_: BusSample) -> bytes:
        return latest

    async def answer_count(_: BusSample) -> bytes:
        return str(count).encode()

    async def echo(sample: BusSample) -> bytes:
        return name.encode() + b":" + sample.payload

    async def refuse(sample: BusSample) -> bytes:
        raise RequestRefused(f"{name} will not, whatever {sample.payload.decode()} says")

    async def say(sample: BusSample) -> bytes:
        bus.put(f"t/{name}/said", sample.payload, Priority.EVENT)
        return b""

    await bus.subscribe("t/in", take)
    await bus.serve(f"t/{name}/latest", answer_latest)
    await bus.serve(f"t/{name}/count", answer_count)
    await bus.serve(f"t/{name}/echo", echo)
    await bus.serve("t/shared", echo)
    await bus.serve(f"t/{name}/refuse", refuse)
    await bus.serve(f"t/{name}/say", say)
    await bus.announce(f"t/live/{name}")


def _router(endpoint: str) -> None:
    from orchestrator.bus.zenoh.sessions import open_router

    with open_router(endpoint):
        sys.stdout.write("up\n")
        sys.stdout.flush()
        sys.stdin.read()


async def _peer(endpoint: str, name: str) -> None:
    from orchestrator.bus.zenoh.bus import open_bus

    bus = await open_bus(endpoint)
    try:
        await behave(bus, name)
        loop = asyncio.get_running_loop()
        ended = asyncio.Event()

        def wait() -> None:
            sys.stdin.read()
            loop.call_soon_threadsafe(ended.set)

        sys.stdout.write("up\n")
        sys.stdout.flush()
        threading.Thread(target=wait, daemon=True).start()
        await ended.wait()
    finally:
        await bus.close()


if __name__ == "__main__":
    if sys.argv[1] == "router":
        _router(sys.argv[2])
    else:
        asyncio.run(_peer(sys.argv[2], sys.argv[3]))
