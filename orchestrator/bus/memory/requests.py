"""Requests on the in-memory bus: served expressions, and the transport of requests and replies."""

import asyncio
import contextvars
from collections.abc import Callable, Sequence
from functools import partial

from orchestrator.bus.answering import FindAnswers
from orchestrator.bus.base import BusSample, Priority, RequestHandler, RequestRefused
from orchestrator.bus.budgets import describe_large_request, find_most_bytes
from orchestrator.bus.expression import expressions_intersect, is_wild
from orchestrator.bus.memory.medium import BusProcess, Medium
from orchestrator.bus.outcome import RequestOutcome


class ServedExpression:
    """A process that serves an expression."""

    def __init__(self, requests: "RequestBoard", bus: BusProcess, expression: str, find_answers: FindAnswers) -> None:
        self.bus = bus
        self.expression = expression
        self.find_answers = find_answers
        self.context = contextvars.copy_context()
        self.stands = True
        self._requests = requests

    async def undeclare(self) -> None:
        self._requests.remove_server(self)


class _PendingRequest:
    """A request in progress: its sender, and the servers that may still answer."""

    def __init__(
        self, sender: BusProcess, payload: bytes, outcome: RequestOutcome, servers: list[ServedExpression]
    ) -> None:
        self.asker = sender
        self.payload = payload
        self.outcome = outcome
        self._open = servers

    def open_at(self, bus: BusProcess) -> bool:
        return any(served_expression.bus is bus for served_expression in self._open)

    def remove_process(self, bus: BusProcess) -> None:
        """The process can no longer answer."""
        self._set_servers([served_expression for served_expression in self._open if served_expression.bus is not bus])

    def remove_server(self, served: ServedExpression) -> None:
        """The server has answered, or will not."""
        self._set_servers([other_expression for other_expression in self._open if other_expression is not served])

    def _set_servers(self, still_open: list[ServedExpression]) -> None:
        self._open = still_open
        if not still_open:
            self.outcome.end_replies()


class RequestBoard:
    """All served expressions and requests of a net."""

    def __init__(self, net: Medium) -> None:
        self._net = net
        self._served: list[ServedExpression] = []
        self._serving: dict[str, list[ServedExpression]] = {}  # by requested key, since the last change of `_served`
        self._questions: dict[RequestOutcome, _PendingRequest] = {}
        self._handling: dict[asyncio.Task[None], ServedExpression] = {}

    def add_server(self, served: ServedExpression) -> None:
        self._net.traffic.count_declared(served.bus.name)
        self._served.append(served)
        self._serving.clear()

    def remove_server(self, served: ServedExpression) -> None:
        served.stands = False
        if served in self._served:
            self._served.remove(served)
            self._serving.clear()

    def remove_servers(self, bus: BusProcess) -> None:
        """A process has left or died: it gets no new requests."""
        for served_expression in [candidate for candidate in self._served if candidate.bus is bus]:
            self.remove_server(served_expression)

    def fail_requests(self, bus: BusProcess) -> None:
        """It was detected that a process will not answer its requests."""
        for outcome, question in list(self._questions.items()):
            if question.asker is bus and not bus.alive:
                del self._questions[outcome]
            elif question.open_at(bus):
                question.remove_process(bus)

    def send_request(self, sender: BusProcess, payload: bytes, outcome: RequestOutcome) -> None:
        """Send a request to all servers of its key."""
        if sender.given_up or outcome.is_over:
            return
        serving = self._serving.get(outcome.key)
        if serving is None:
            serving = [
                expression for expression in self._served if expressions_intersect(expression.expression, outcome.key)
            ]
            self._serving[outcome.key] = serving
        asked_expressions = [expression for expression in serving if not expression.bus.given_up]
        question = _PendingRequest(sender, payload, outcome, asked_expressions)
        self._questions[outcome] = question
        outcome.settled.add_done_callback(lambda _: self._questions.pop(outcome, None))
        if not asked_expressions:
            self._net.schedule_call(self._net.arrival_ns(sender, sender), outcome.end_replies)
        self._net.traffic.count_sent(sender.name, "request", len(payload))
        for served_expression in asked_expressions:
            if not self._net.is_cut(sender, served_expression.bus):
                at_ns = self._net.arrival_ns(sender, served_expression.bus)
                self._net.schedule_call(at_ns, partial(self._receive_request, served_expression, question))

    def _receive_request(self, served: ServedExpression, question: _PendingRequest) -> None:
        if question.outcome.is_over or self._net.is_cut(question.asker, served.bus):
            return
        self._net.traffic.count_received(served.bus.name, self._net.clock.now_ns())
        self._net.deliver_call(served.bus, Priority.EVENT, partial(self._enter_process, served, question))

    def _enter_process(self, served: ServedExpression, question: _PendingRequest) -> None:
        loop = asyncio.get_running_loop()
        loop.call_soon(self._start_handler, served, question, context=served.context)

    def _start_handler(self, served: ServedExpression, question: _PendingRequest) -> None:
        answers = served.find_answers(question.outcome.key) if served.stands else ()
        if not answers:
            self._queue_replies(served, question, [])
            return
        size, process_bytes = len(question.payload), served.bus.max_message_bytes
        key = answers[0][0]
        if size > find_most_bytes("request", key, process_bytes):
            text = describe_large_request(key, size, process_bytes)
            self._queue_replies(served, question, [partial(question.outcome.add_refusal, served.bus.server, text)])
            return
        context = served.context.copy()
        task = asyncio.get_running_loop().create_task(self._run_handlers(served, question, answers), context=context)
        self._handling[task] = served
        task.add_done_callback(self._handling.pop, context=context)

    async def _run_handlers(
        self, served: ServedExpression, question: _PendingRequest, answers: Sequence[tuple[str, RequestHandler]]
    ) -> None:
        replies = [await self._run_handler(served, question, key, handler) for key, handler in answers]
        self._queue_replies(served, question, [reply for reply in replies if reply is not None])

    async def _run_handler(
        self, served: ServedExpression, question: _PendingRequest, key: str, handler: RequestHandler
    ) -> Callable[[], None] | None:
        """The call that adds the reply to the outcome of its request; None: there is no reply."""
        outcome, server = question.outcome, served.bus.server
        try:
            payload = await handler(BusSample(key, question.payload))
            if len(payload) > find_most_bytes("answer", key, question.asker.max_message_bytes):
                raise RequestRefused(f"the answer on {key} is too large for this process")
        except RequestRefused as refusal:
            return None if is_wild(outcome.key) else partial(outcome.add_refusal, server, str(refusal))
        except Exception as error:
            text = f"{type(error).__name__} while answering {key}: {error}"
            asyncio.get_running_loop().call_exception_handler({"message": text, "exception": error})
            return partial(outcome.add_refusal, server, text)
        self._net.traffic.count_sent(served.bus.name, "reply", len(payload))
        return partial(outcome.add_reply, server, key, payload)

    def cancel_answers(self, bus: BusProcess) -> None:
        """A process leaves: pending answers are cancelled."""
        for task, served_expression in list(self._handling.items()):
            if served_expression.bus is bus:
                task.cancel()

    def _queue_replies(
        self, served: ServedExpression, question: _PendingRequest, replies: Sequence[Callable[[], None]]
    ) -> None:
        served.bus.send_call(Priority.EVENT, partial(self._send_back, served, question, replies))

    def _send_back(
        self, served: ServedExpression, question: _PendingRequest, replies: Sequence[Callable[[], None]]
    ) -> None:
        def deliver_replies() -> None:
            is_lost = question.outcome.key in self._net.disturbances.unanswered
            if not is_lost and not self._net.is_cut(served.bus, question.asker):
                self._net.traffic.count_received(question.asker.name, self._net.clock.now_ns())
                self._net.deliver_call(question.asker, Priority.EVENT, settle_request)

        def settle_request() -> None:
            for add_reply in replies:
                add_reply()
            question.remove_server(served)

        self._net.schedule_call(self._net.arrival_ns(served.bus, question.asker), deliver_replies)
