"""Follows the fleet file of the leader, for parts of a fleet on other computers."""

import asyncio
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orchestrator.runtime.live.fleet import LiveFleet

FOLLOW_S = 10.0  # between two looks at whether the fleet runs with another file by now


async def follow_file(live: "LiveFleet", actor: str) -> None:
    """Store the fleet file whenever the fleet runs with another one, so that a restarted part uses that."""
    from orchestrator.bus.zenoh.sessions import RouterUnreachable
    from orchestrator.client import Tutti
    from orchestrator.model.errors import Refusal

    while True:
        try:
            async with Tutti(live.connect, live.fleet.fleet, actor=actor) as tutti:
                while True:
                    await asyncio.sleep(FOLLOW_S)
                    fleet = await tutti.load_fleet()
                    if fleet.digest != live.fleet.digest:
                        live.say(f"the fleet runs with another file: {fleet.digest} instead of {live.fleet.digest}")
                        live.save_fleet(fleet)
        except (Refusal, RouterUnreachable):
            await asyncio.sleep(FOLLOW_S)
