"""The same verb to several controllers of a host in one request: each does its own, and the host answers for all.

A step of sixteen controllers asks each of them five times. One by one that is 17 ms of processor time a stage for the
bus alone (router, both ends, and their threads); together it is 3 ms.
"""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from pydantic import ValidationError

from adapters.controller.publisher import explain
from orchestrator.bus.base import Handler, RequestRefused, Sample
from orchestrator.bus.keys import Keys
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.messages import Together, TogetherReply


class AnswersTogether:
    """Answers `host/{id}/cmd/*`. unit: gives what answers a controller's own commands, None where it is not there."""

    def __init__(self, keys: Keys, clock: Clock, unit: Callable[[str], Handler | None]) -> None:
        self._keys = keys
        self._clock = clock
        self._unit = unit
        self._tasks: set[asyncio.Task[None]] = set()

    async def answer(self, sample: Sample) -> bytes:
        """Hand each request to its controller, and give the answers of all who have answered in time."""
        verb = self._keys.verb_of(sample.key)
        try:
            asked = Together.model_validate_json(sample.payload)
        except ValidationError as error:
            raise RequestRefused(f"{verb}: {explain(error)}") from None
        asked_ns = self._clock.now_ns()
        replies: dict[str, str] = {}
        errors: dict[str, str] = {}
        took_ns: dict[str, int] = {}

        async def ask(controller: str, answer: Handler, payload: str) -> None:
            try:
                reply = await answer(Sample(self._keys.cmd(controller, verb), payload.encode()))
            except RequestRefused as refusal:
                errors[controller] = str(refusal)
            except Exception as error:
                # As the bus does with an answer of its own: one defect must not keep the others' answers.
                text = f"{type(error).__name__} while answering {verb} for {controller}: {error}"
                asyncio.get_running_loop().call_exception_handler({"message": text, "exception": error})
                errors[controller] = text
            else:
                replies[controller] = reply.decode()
            took_ns[controller] = self._clock.now_ns() - asked_ns

        there = ((name, self._unit(name), payload) for name, payload in asked.requests.items())
        tasks = [self._spawn(ask(name, answer, payload)) for name, answer, payload in there if answer is not None]
        if tasks:
            await asyncio.wait(tasks, timeout=asked.within_ns / NS_PER_S)
        return TogetherReply(replies=dict(replies), errors=dict(errors), took_ns=dict(took_ns)).to_json()

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        # Who has not answered in time goes on, as who is asked alone does.
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def close(self) -> None:
        """Nobody waits for answers any more."""
        for task in list(self._tasks):
            task.cancel()
