"""The e-stop latch in processes that have no other business on the bus: the router's, and guardians."""

import asyncio
from pathlib import Path

from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import FileLatchStore, LatchKeeper
from orchestrator.bus.limits import MAX_KEEPER_MESSAGE_BYTES
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.sessions import RouterUnreachable
from orchestrator.clock.live import LiveClock

RETRY_S = 1.0


async def keep_latch(endpoint: str, fleet: str, name: str, path: Path) -> None:
    """Keep the e-stop latch of `fleet` in the file `path`, and answer with it as keeper `name`, until cancelled. A
    router that is not there is waited for. Raises `ValueError` for names that are no ids."""
    keys = FleetKeys(fleet)
    keys.kept_estop(name)
    while True:
        try:
            bus = await open_bus(endpoint, max_message_bytes=MAX_KEEPER_MESSAGE_BYTES)
            break
        except RouterUnreachable:
            await asyncio.sleep(RETRY_S)
    try:
        keeper = LatchKeeper(bus, keys, LiveClock().utc, FileLatchStore(path))
        await keeper.start(name)
        await asyncio.Event().wait()
    finally:
        await bus.close()
