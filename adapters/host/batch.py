"""Batched requests: the same verb to several controllers of a host in one request; each executes its own part, and the
host replies for all.

A step of 16 controllers sends each of them five requests. Sent singly, a stage costs 17 ms of processor time for the
bus alone (router, both ends, and their threads); batched, it costs 3 ms.
"""

import asyncio
from collections.abc import Callable

from orchestrator.bus.base import BusSample, RequestHandler, RequestRefused
from orchestrator.bus.decoding import read_request
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.messages import BatchReply, BatchRequest


class BatchAnswers:
    """Answer `host/{id}/cmd/*`. handler_of: returns what handles a verb for a controller, None where that is not on
    the bus."""

    def __init__(self, keys: FleetKeys, clock: Clock, handler_of: Callable[[str, str], RequestHandler | None]) -> None:
        self._keys = keys
        self._clock = clock
        self._handler_of = handler_of
        # A handler without a reply at the timeout continues, as it does after a single request.
        self._tasks = TaskOwner()

    async def answer_batch(self, sample: BusSample) -> bytes:
        """Pass each request to its controller, and return the replies that arrived before the timeout."""
        verb = self._keys.verb_of(sample.key)
        batch = read_request(BatchRequest, sample, f"{verb}: ")
        asked_ns = self._clock.now_ns()
        replies: dict[str, str] = {}
        errors: dict[str, str] = {}
        took_ns: dict[str, int] = {}

        async def request_controller(controller: str, answer: RequestHandler, payload: str) -> None:
            try:
                reply = await answer(BusSample(self._keys.command(controller, verb), payload.encode()))
            except RequestRefused as refusal:
                errors[controller] = str(refusal)
            except Exception as error:
                # As the bus does with a single reply: one defect must not suppress the replies of the other
                # controllers.
                text = f"{type(error).__name__} while answering {verb} for {controller}: {error}"
                asyncio.get_running_loop().call_exception_handler({"message": text, "exception": error})
                errors[controller] = text
            else:
                replies[controller] = reply.decode()
            took_ns[controller] = self._clock.now_ns() - asked_ns

        calls = ((name, self._handler_of(name, verb), payload) for name, payload in batch.requests.items())
        tasks = [
            self._tasks.spawn(request_controller(name, answer, payload))
            for name, answer, payload in calls
            if answer is not None
        ]
        if tasks:
            await asyncio.wait(tasks, timeout=batch.answer_within_ns / NS_PER_S)
        return BatchReply(replies=dict(replies), errors=dict(errors), took_ns=dict(took_ns)).to_json()

    def cancel_all(self) -> None:
        """Cancel all handlers: no requester waits for their replies."""
        self._tasks.cancel_all()
