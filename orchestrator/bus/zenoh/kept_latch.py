"""The e-stop latch in processes that have no other business on the bus: the router's, and guardians."""

import asyncio
from pathlib import Path

from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import FileLatchStore, LatchKeeper
from orchestrator.bus.zenoh.patience import open_bus_patiently
from orchestrator.clock.live import LiveClock


async def keep_latch(endpoint: str, fleet: str, name: str, path: Path) -> None:
    """Keep the e-stop latch of `fleet` in the file `path`, and answer with it as keeper `name`, until cancelled. A
    router that is not there is waited for. Raises `ValueError` for names that are no ids."""
    keys = FleetKeys(fleet)
    keys.kept_estop(name)
    bus = await open_bus_patiently(endpoint)
    try:
        keeper = LatchKeeper(bus, keys, LiveClock().utc, FileLatchStore(path))
        await keeper.start(name)
        await asyncio.Event().wait()
    finally:
        await bus.close()
