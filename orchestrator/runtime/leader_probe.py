"""A query for the leader of a fleet, made before any process of the fleet is started."""

import asyncio

from pydantic import ValidationError

from orchestrator.bus.base import Sample
from orchestrator.bus.keys import Keys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.leadership.leadership import LEADER_TIMEOUT_NS
from orchestrator.model.messages import LeaderHeartbeat


async def reigning(endpoint: str, fleet: str) -> LeaderHeartbeat | None:
    """Return the heartbeat of the coordinator that leads `fleet`, or None. Raises `RouterUnreachable`."""
    heard: asyncio.Future[LeaderHeartbeat] = asyncio.get_running_loop().create_future()

    def take(sample: Sample) -> None:
        try:
            reign = LeaderHeartbeat.model_validate_json(sample.payload)
        except ValidationError:
            return
        if not heard.done():
            heard.set_result(reign)

    bus = await open_bus(endpoint)
    try:
        subscription = await bus.subscribe(Keys(fleet).leader, take)
        try:
            async with asyncio.timeout(LEADER_TIMEOUT_NS / NS_PER_S):
                return await heard
        except TimeoutError:
            return None
        finally:
            await subscription.undeclare()
    finally:
        await bus.close()
