"""Discovery of the fleets on the bus."""

import asyncio

from orchestrator.bus.base import Bus, BusError
from orchestrator.bus.keys import ANY_STATE, ANY_TIME, ROOT

ANSWER_TIMEOUT_S = 2.0


async def find_fleets(bus: Bus) -> list[str]:
    """The fleets that have a coordinator or an adapter which answers, sorted by name."""
    question_keys = [ANY_TIME, ANY_STATE]
    gather = await asyncio.gather(
        *(bus.request_all(each, b"", ANSWER_TIMEOUT_S) for each in question_keys), return_exceptions=True
    )
    keys: set[str] = set()
    for replies in gather:
        if isinstance(replies, dict):
            keys |= replies.keys()
        elif not isinstance(replies, BusError):
            raise replies
    return sorted({key.removeprefix(ROOT + "/").partition("/")[0] for key in keys})
