"""Who reigns in a fleet, asked from outside before anything is started for it."""

import asyncio

from pydantic import ValidationError

from orchestrator.bus.base import Sample
from orchestrator.bus.keys import Keys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.leadership.leadership import LISTEN_NS
from orchestrator.model.messages import Reign


async def reigning(endpoint: str, fleet: str) -> Reign | None:
    """The heartbeat of the coordinator that reigns in `fleet`, or None. Raises `RouterUnreachable`."""
    heard: asyncio.Future[Reign] = asyncio.get_running_loop().create_future()

    def take(sample: Sample) -> None:
        try:
            reign = Reign.model_validate_json(sample.payload)
        except ValidationError:
            return
        if not heard.done():
            heard.set_result(reign)

    bus = await open_bus(endpoint)
    try:
        subscription = await bus.subscribe(Keys(fleet).reign, take)
        try:
            async with asyncio.timeout(LISTEN_NS / NS_PER_S):
                return await heard
        except TimeoutError:
            return None
        finally:
            await subscription.undeclare()
    finally:
        await bus.close()
