"""A query for the leader of a fleet, made before any process of the fleet is started."""

import asyncio

from pydantic import ValidationError

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.leadership.leadership import LEADER_TIMEOUT_NS
from orchestrator.model.messages import LeaderHeartbeat


async def find_leader(endpoint: str, fleet: str) -> LeaderHeartbeat | None:
    """Return the heartbeat of the coordinator that leads `fleet`, or None. Raises `RouterUnreachable`."""
    future: asyncio.Future[LeaderHeartbeat] = asyncio.get_running_loop().create_future()

    def receive_heartbeat(sample: BusSample) -> None:
        try:
            heartbeat = LeaderHeartbeat.read_message(sample.payload)
        except ValidationError:
            return
        if not future.done():
            future.set_result(heartbeat)

    bus = await open_bus(endpoint)
    try:
        subscription = await bus.subscribe(FleetKeys(fleet).leader, receive_heartbeat)
        try:
            async with asyncio.timeout(LEADER_TIMEOUT_NS / NS_PER_S):
                return await future
        except TimeoutError:
            return None
        finally:
            await subscription.undeclare()
    finally:
        await bus.close()
