"""Discovery of the fleets on the bus."""

import asyncio

from orchestrator.bus.base import Bus, BusError
from orchestrator.bus.keys import ANY_STATE, ANY_TIME, ROOT

ANSWER_TIMEOUT_S = 2.0


async def find_fleets(bus: Bus) -> list[str]:
    """The fleets that have a coordinator or an adapter which answers, sorted by name."""
    question_keys = [ANY_TIME, ANY_STATE]
    answers = await asyncio.gather(
        *(bus.request_all(question_key, b"", ANSWER_TIMEOUT_S) for question_key in question_keys),
        return_exceptions=True,
    )
    keys: set[str] = set()
    for replies in answers:
        if isinstance(replies, dict):
            keys |= replies.keys()
        elif not isinstance(replies, BusError):
            raise replies
    return sorted({key.removeprefix(ROOT + "/").partition("/")[0] for key in keys})
