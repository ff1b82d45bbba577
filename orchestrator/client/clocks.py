"""How well the clocks of all controllers are known, asked of their adapters."""

from pydantic import ValidationError

from orchestrator.client.api import Tutti
from orchestrator.model.state import ClockReply

ANSWER_S = 2.0


async def query_clocks(tutti: Tutti) -> dict[str, ClockReply]:
    """By controller; one whose adapter does not answer, or can not be understood, is not there."""
    replies = await tutti.bus.request_all(tutti.keys.clock(), b"", timeout_s=ANSWER_S)
    found: dict[str, ClockReply] = {}
    for payload in replies.values():
        try:
            reply = ClockReply.model_validate_json(payload)
        except ValidationError:
            continue
        found[reply.controller] = reply
    return dict(sorted(found.items()))
