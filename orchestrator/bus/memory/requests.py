"""Requests on the in-memory bus: served expressions, and the transport of requests and replies."""

import asyncio
import contextvars
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from orchestrator.bus.base import Handler, Priority, RequestRefused, Sample
from orchestrator.bus.expression import intersects, is_wild
from orchestrator.bus.outcome import Outcome

if TYPE_CHECKING:
    from orchestrator.bus.memory.bus import MemoryBus, MemoryNet


class Served:
    """A process that serves an expression."""

    def __init__(self, requests: "Requests", bus: "MemoryBus", expression: str, handler: Handler) -> None:
        self.bus = bus
        self.expression = expression
        self.handler = handler
        self.context = contextvars.copy_context()
        self.stands = True
        self._requests = requests

    async def undeclare(self) -> None:
        self._requests.forget(self)


class _Question:
    """A request in progress: its sender, and the servers that may still answer."""

    def __init__(self, asker: "MemoryBus", payload: bytes, outcome: Outcome, asked: list[Served]) -> None:
        self.asker = asker
        self.payload = payload
        self.outcome = outcome
        self._open = asked

    def open_at(self, bus: "MemoryBus") -> bool:
        return any(served.bus is bus for served in self._open)

    def give_up(self, bus: "MemoryBus") -> None:
        """The process can no longer answer."""
        self._keep([served for served in self._open if served.bus is not bus])

    def done(self, served: Served) -> None:
        """The server has answered, or will not."""
        self._keep([other for other in self._open if other is not served])

    def _keep(self, still_open: list[Served]) -> None:
        self._open = still_open
        if not still_open:
            self.outcome.complete()


class Requests:
    """All served expressions and requests of a net."""

    def __init__(self, net: "MemoryNet") -> None:
        self._net = net
        self._served: list[Served] = []
        self._serving: dict[str, list[Served]] = {}  # by requested key, since the last change of `_served`
        self._questions: dict[Outcome, _Question] = {}
        self._handling: dict[asyncio.Task[None], Served] = {}

    def add(self, served: Served) -> None:
        self._served.append(served)
        self._serving.clear()

    def forget(self, served: Served) -> None:
        served.stands = False
        if served in self._served:
            self._served.remove(served)
            self._serving.clear()

    def forget_all(self, bus: "MemoryBus") -> None:
        """A process has left or died: it gets no new requests."""
        for served in [served for served in self._served if served.bus is bus]:
            self.forget(served)

    def gone(self, bus: "MemoryBus") -> None:
        """It was detected that a process will not answer its requests."""
        for outcome, question in list(self._questions.items()):
            if question.asker is bus and not bus.alive:
                del self._questions[outcome]
            elif question.open_at(bus):
                question.give_up(bus)

    def ask(self, asker: "MemoryBus", payload: bytes, outcome: Outcome) -> None:
        """Send a request to all servers of its key."""
        if asker.given_up or outcome.over:
            return
        serving = self._serving.get(outcome.key)
        if serving is None:
            serving = [each for each in self._served if intersects(each.expression, outcome.key)]
            self._serving[outcome.key] = serving
        asked = [each for each in serving if not each.bus.given_up]
        question = _Question(asker, payload, outcome, asked)
        self._questions[outcome] = question
        outcome.settled.add_done_callback(lambda _: self._questions.pop(outcome, None))
        if not asked:
            self._net.at(self._net.arrival_ns(), outcome.complete)
        for served in asked:
            if not self._net.cut(asker, served.bus):
                self._net.at(self._net.arrival_ns(), partial(self._arrive, served, question))

    def _arrive(self, served: Served, question: _Question) -> None:
        if question.outcome.over or self._net.cut(question.asker, served.bus):
            return
        self._net.hand_over(served.bus, Priority.EVENT, partial(self._enter, served, question))

    def _enter(self, served: Served, question: _Question) -> None:
        loop = asyncio.get_running_loop()
        loop.call_soon(self._start, served, question, context=served.context)

    def _start(self, served: Served, question: _Question) -> None:
        if not served.stands:
            self._reply(served, question, None)
            return
        context = served.context.copy()
        task = asyncio.get_running_loop().create_task(self._handle(served, question), context=context)
        self._handling[task] = served
        task.add_done_callback(self._handling.pop, context=context)

    async def _handle(self, served: Served, question: _Question) -> None:
        asked = question.outcome.key
        key = served.expression if is_wild(asked) else asked
        try:
            payload = await served.handler(Sample(key, question.payload))
        except RequestRefused as refusal:
            self._reply(served, question, partial(question.outcome.refuse, str(refusal)))
        except Exception as error:
            text = f"{type(error).__name__} while answering {key}: {error}"
            asyncio.get_running_loop().call_exception_handler({"message": text, "exception": error})
            self._reply(served, question, partial(question.outcome.refuse, text))
        else:
            self._reply(served, question, partial(question.outcome.take, key, payload))

    def cancel(self, bus: "MemoryBus") -> None:
        """A process leaves: pending answers are cancelled."""
        for task, served in list(self._handling.items()):
            if served.bus is bus:
                task.cancel()

    def _reply(self, served: Served, question: _Question, answer: Callable[[], None] | None) -> None:
        served.bus.go_out(Priority.EVENT, partial(self._send_back, served, question, answer))

    def _send_back(self, served: Served, question: _Question, answer: Callable[[], None] | None) -> None:
        def arrive() -> None:
            if not self._net.cut(served.bus, question.asker):
                self._net.hand_over(question.asker, Priority.EVENT, settle)

        def settle() -> None:
            if answer is not None and not question.outcome.over:
                answer()
            question.done(served)

        self._net.at(self._net.arrival_ns(), arrive)
