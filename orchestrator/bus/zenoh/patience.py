"""Sessions of processes that wait for their router, however long it is away."""

import asyncio

from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.limits import MAX_KEEPER_MESSAGE_BYTES
from orchestrator.bus.zenoh.bus import ZenohBus, open_bus
from orchestrator.bus.zenoh.sessions import RouterUnreachable

RETRY_S = 1.0


async def open_bus_patiently(endpoint: str) -> ZenohBus:
    """Open a session for a process with small messages only, as soon as its router is there."""
    while True:
        try:
            return await open_bus(endpoint, max_message_bytes=MAX_KEEPER_MESSAGE_BYTES)
        except RouterUnreachable:
            await asyncio.sleep(RETRY_S)


async def announce_slow_start(endpoint: str, fleet: str, host: str) -> None:
    """Announce that the adapter host `host` is slow to start, until cancelled."""
    bus = await open_bus_patiently(endpoint)
    try:
        await bus.announce(FleetKeys(fleet).slow_start(host))
        await asyncio.Event().wait()
    finally:
        await bus.close()
