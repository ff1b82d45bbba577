"""Idempotent requests: one that arrives twice, e.g. because its sender has timed out, is executed once and answered
twice."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from typing import Any

MAX_ANSWERS = 256


class AnswerCache:
    """The newest `MAX_ANSWERS` answers, by verb and request id."""

    def __init__(self) -> None:
        # Answers are kept as bytes: a host has thousands, and finished tasks would keep their whole state alive.
        self._given: OrderedDict[tuple[str, str], bytes | asyncio.Task[bytes]] = OrderedDict()

    async def answer_once(self, verb: str, request_id: str, work: Callable[[], Coroutine[Any, Any, bytes]]) -> bytes:
        """Return the result of `work`, or the past or pending result of the same request. The work continues when
        its caller gives up."""
        key = (verb, request_id)
        given_answer = self._given.get(key)
        if isinstance(given_answer, bytes):
            return given_answer
        if given_answer is None:
            given_answer = self._given[key] = asyncio.get_running_loop().create_task(work())
            given_answer.add_done_callback(lambda done_task: self._store_answer(key, done_task))
            while len(self._given) > MAX_ANSWERS:
                self._given.popitem(last=False)
        return await asyncio.shield(given_answer)

    def _store_answer(self, key: tuple[str, str], done: "asyncio.Task[bytes]") -> None:
        # A task that failed is kept: a repeated request gets the same error.
        if key in self._given and not done.cancelled() and done.exception() is None:
            self._given[key] = done.result()
