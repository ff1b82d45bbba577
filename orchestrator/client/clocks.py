"""Queries the adapters of all controllers for their clock mappings."""

from pydantic import ValidationError

from orchestrator.client.api import Tutti
from orchestrator.model.state import ClockReply

ANSWER_S = 2.0


async def query_clocks(tutti: Tutti) -> dict[str, ClockReply]:
    """Return the clock mappings by controller, without those whose adapter gives no valid reply."""
    replies = await tutti.bus.request_all(tutti.keys.clock(), b"", timeout_s=ANSWER_S)
    found_replies: dict[str, ClockReply] = {}
    for payload in replies.values():
        try:
            reply = ClockReply.read_message(payload)
        except ValidationError:
            continue
        found_replies[reply.controller] = reply
    return dict(sorted(found_replies.items()))
