"""Idempotent requests: one that arrives twice, e.g. because its sender has timed out, is executed once and answered
twice. The same id with another content is refused: its sender would take the answer for one to its own request."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from orchestrator.bus.base import RequestRefused
from orchestrator.model.messages import Request

MAX_ANSWERS = 256


STOPS = frozenset({"stop", "latch", "stop-queue"})  # are never refused because of an id


@dataclass(slots=True)
class _GivenAnswer:
    """content: tells one request from another one with its id. answer: the task that makes it, then its bytes."""

    content: int
    answer: "bytes | asyncio.Task[bytes]"


class AnswerCache:
    """The newest `MAX_ANSWERS` answers, by verb, actor and request id."""

    def __init__(self) -> None:
        # Answers are kept as bytes: a host has thousands, and finished tasks would keep their whole state alive.
        self._given: OrderedDict[tuple[str, str, str], _GivenAnswer] = OrderedDict()

    async def answer_once(
        self, verb: str, request: Request, payload: bytes, work: Callable[[], Coroutine[Any, Any, bytes]]
    ) -> bytes:
        """Return the result of `work`, or the past or pending result of the same request. The work continues when
        its caller gives up. payload: of the request.

        Raises `RequestRefused`, `key-used`, for the id of another request; a stop is carried out all the same."""
        key, content = (verb, request.actor, request.request_id), hash(payload)
        given_answer = self._given.get(key)
        if given_answer is not None and given_answer.content != content:
            if verb not in STOPS:
                text = f"the request id {request.request_id[:60]!r} was used by {request.actor} for another {verb}"
                raise RequestRefused(f"key-used: {text}; use a new one for each request, the same only to repeat it")
            given_answer = None
        if given_answer is None:
            task = asyncio.get_running_loop().create_task(work())
            given_answer = self._given[key] = _GivenAnswer(content, task)
            task.add_done_callback(lambda done_task: self._store_answer(given_answer, done_task))
            while len(self._given) > MAX_ANSWERS:
                self._given.popitem(last=False)
        answer = given_answer.answer
        return answer if isinstance(answer, bytes) else await asyncio.shield(answer)

    def _store_answer(self, given: _GivenAnswer, done: "asyncio.Task[bytes]") -> None:
        # A task that failed is kept: a repeated request gets the same error.
        if not done.cancelled() and done.exception() is None:
            given.answer = done.result()
