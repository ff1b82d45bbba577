"""The bus over Zenoh, through a router.

It has two sessions, so that droppable samples never delay others: one takes the subscriptions and publishes state,
with DROP; the other publishes events and e-stops, sends requests, answers and carries presence, and blocks rather
than drops. Each publishes from a sender thread of its own. Presence is on the session that serves, so that a process
that is present can be queried.
"""

# Zenoh's type stubs omit many return types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportMissingModuleSource=false

import asyncio
import atexit
import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import zenoh
from zenoh.handlers import Callback

from orchestrator.bus.answering import FindAnswers, answer_expression, answer_group
from orchestrator.bus.base import BusClosed, BusDeclaration, BusSample, Priority, RequestHandler, ServedGroup
from orchestrator.bus.expression import check_expression, check_key, check_put, is_wild
from orchestrator.bus.limits import MAX_MESSAGE_BYTES, MAX_STATES_QUEUED, LossCounter
from orchestrator.bus.outcome import RequestOutcome
from orchestrator.bus.requesting import RequestingBus
from orchestrator.bus.zenoh.answerer import REFUSED, QueryAnswerer, require_sendable
from orchestrator.bus.zenoh.intake import PayloadIntake
from orchestrator.bus.zenoh.sessions import CONNECT_TIMEOUT_S, open_session
from orchestrator.bus.zenoh.threads import LoopInbox, SenderThread, run_in_thread

CLOSE_TIMEOUT_S = 1.0
"""For each of: sending what is left, closing the sessions. Zenoh's own close waits 10 s for a router that hangs."""

_FLUSH_TIMEOUT_S = 3.0
_DROP_TIMEOUT_S = 0.1
"""A process must not end before its sessions are closed and their objects are dropped: otherwise the interpreter
ends Zenoh's threads in the middle of that, and the process ends by SIGABRT. A hanging router is not waited for
beyond that: threads that wait for it do nothing else."""

_UNANSWERED_GRACE_S = 0.02
"""A request ends without replies either because the key is not served or because the router has just died, which the
session may detect some milliseconds later."""

_QUERY_MARGIN_S = 0.5
"""Zenoh gives up a query this long after its sender."""

T = TypeVar("T")
A = TypeVar("A")

_LOG = logging.getLogger(__name__)

_WIRE_PRIORITY = {
    Priority.STATE: zenoh.Priority.DATA,
    Priority.EVENT: zenoh.Priority.INTERACTIVE_HIGH,
    Priority.ESTOP: zenoh.Priority.REAL_TIME,
}


def _to_priority(sample: zenoh.Sample) -> Priority:
    if sample.priority == zenoh.Priority.REAL_TIME:
        return Priority.ESTOP
    return Priority.STATE if sample.priority == zenoh.Priority.DATA else Priority.EVENT


def _make_direct_callback(arrive: Callable[[A], None], end: Callable[[], None] | None = None) -> "Callback[A]":
    """Make a callback on Zenoh's own network thread, which must only hand over what has arrived, like an inbox. By
    default Zenoh makes a thread for each callback, for a query each time, which ends some time after its session;
    if the interpreter ends meanwhile, the process ends by SIGABRT."""
    return Callback(arrive, end, indirect=False)


class _ZenohDeclaration:
    """A declaration on a session. `active` holds all active ones, because Zenoh undeclares what is not referenced."""

    def __init__(self, active: "dict[_ZenohDeclaration, Callable[[], None]]") -> None:
        self.stands = True
        self._standing = active

    def attach(self, undeclare: Callable[[], None]) -> None:
        self._standing[self] = undeclare

    async def undeclare(self) -> None:
        self.stands = False
        undeclare = self._standing.pop(self, None)
        if undeclare is not None:
            await run_in_thread("bus-undeclare", undeclare)


class ZenohBus(RequestingBus):
    """One process's connection to the bus. Made by `open_bus`."""

    def __init__(self, endpoint: str, lossy: zenoh.Session, sure: zenoh.Session, max_message_bytes: int) -> None:
        super().__init__()
        self._endpoint = endpoint
        self._losses = LossCounter("bus", time.monotonic_ns)
        self._intake = PayloadIntake(max_message_bytes, self._losses)
        self._loop = asyncio.get_running_loop()
        self._lossy = lossy
        self._sure = sure
        self._lossy_sender = SenderThread("bus-state", MAX_STATES_QUEUED)
        self._sure_sender = SenderThread("bus-events", MAX_STATES_QUEUED)
        self._inbox = LoopInbox(self._loop, MAX_STATES_QUEUED)
        self._closed = False
        self._standing: dict[_ZenohDeclaration, Callable[[], None]] = {}
        self._disconnects = 0
        self._asking: list[RequestOutcome] = []
        self._answerer = QueryAnswerer(self._loop, self._sure_sender)
        # Held only so that it is not undeclared.
        self._transports = sure.info.declare_transport_events_listener(_make_direct_callback(self._transport_event))

    def put(self, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        self._check_open()
        if len(payload) > MAX_MESSAGE_BYTES:
            self._losses.count_loss(f"{len(payload)} bytes on {key} are not sent; at most {MAX_MESSAGE_BYTES} are")
            return
        droppable = priority is Priority.STATE
        session, sender = (self._lossy, self._lossy_sender) if droppable else (self._sure, self._sure_sender)
        call = partial(
            session.put,
            check_put(key, priority),
            payload,
            congestion_control=zenoh.CongestionControl.DROP if droppable else zenoh.CongestionControl.BLOCK,
            priority=_WIRE_PRIORITY[priority],
            express=True,
        )
        sender.queue_call(priority, call, len(payload))

    async def subscribe(
        self, expression: str, callback: Callable[[BusSample], None], *, direct: bool = False
    ) -> BusDeclaration:
        declaration = _ZenohDeclaration(self._standing)

        def deliver_sample(sample: BusSample) -> None:
            if declaration.stands:
                callback(sample)

        def receive_sample(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                key, priority = str(sample.key_expr), _to_priority(sample)
                payload = self._intake.take_sample(sample.payload, key, priority)
                if payload is None:
                    return
                if direct:
                    deliver_sample(BusSample(key, payload))
                    return
                self._inbox.queue_call(priority, partial(deliver_sample, BusSample(key, payload)), len(payload))

        check_expression(expression)
        subscriber = await self._run_declaration(
            lambda: self._lossy.declare_subscriber(expression, _make_direct_callback(receive_sample))
        )
        declaration.attach(subscriber.undeclare)
        return declaration

    async def serve(self, expression: str, handler: RequestHandler) -> BusDeclaration:
        return await self._serve(expression, answer_expression(expression, handler))

    async def serve_group(self, expression: str, group: ServedGroup) -> BusDeclaration:
        return await self._serve(expression, answer_group(group))

    async def _serve(self, expression: str, find_answers: FindAnswers) -> BusDeclaration:
        declaration = _ZenohDeclaration(self._standing)

        def start_answers(query: zenoh.Query, payload: bytes) -> None:
            if not declaration.stands or self._closed:
                query.drop()
            else:
                self._answerer.start_answers(query, payload, find_answers)

        def receive_query(query: zenoh.Query) -> None:
            question_key = str(query.key_expr)
            key = expression if is_wild(question_key) else question_key
            payload = b"" if query.payload is None else self._intake.take_payload(query.payload, key, "request")
            if payload is None:
                self._answerer.refuse_query(query, self._intake.describe_large_query(query, key))
                return
            self._inbox.queue_call(Priority.EVENT, partial(start_answers, query, payload), len(payload))

        check_expression(expression)
        queryable = await self._run_declaration(
            lambda: self._sure.declare_queryable(expression, _make_direct_callback(receive_query), complete=False)
        )
        declaration.attach(queryable.undeclare)
        return declaration

    def _take_answer(
        self, answer: zenoh.Sample, server: str, outcome: RequestOutcome
    ) -> tuple[int, Callable[[], None]]:
        """The size of an answer, and the call that adds it to the outcome of its request."""
        key = str(answer.key_expr)
        payload = self._intake.take_payload(answer.payload, key, "answer")
        if payload is None:
            return 0, partial(outcome.add_refusal, server, f"the answer on {key} is too large for this process")
        return len(payload), partial(outcome.add_reply, server, key, payload)

    async def _collect_replies(self, outcome: RequestOutcome, payload: bytes, timeout_s: float) -> None:
        self._check_open()
        require_sendable("request", payload)
        disconnects = self._disconnects
        unsure = False

        def receive_reply(reply: zenoh.Reply) -> None:
            size, replier = 0, reply.replier_id
            server = "" if replier is None else str(replier.zid)
            if reply.ok is not None:
                size, answer = self._take_answer(reply.ok, server, outcome)
            elif reply.err is not None and str(reply.err.encoding) == REFUSED:
                answer = partial(outcome.add_refusal, server, reply.err.payload.to_string())
            else:
                answer = wait_for_transport
            self._inbox.queue_call(Priority.EVENT, answer, size)

        def wait_for_transport() -> None:
            nonlocal unsure
            unsure = True

        def end_request() -> None:
            if outcome.has_reply:
                outcome.end_replies()
            else:
                self._loop.call_later(_UNANSWERED_GRACE_S, end_unanswered)

        def end_unanswered() -> None:
            # While disconnected it is unknown which keys are served: only the timeout ends the request.
            if not unsure and self._disconnects == disconnects and self._is_connected():
                outcome.end_replies()

        def start_query() -> None:
            if outcome.is_over:
                return
            self._sure.get(
                outcome.key,
                _make_direct_callback(receive_reply, partial(self._inbox.queue_call, Priority.EVENT, end_request)),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s + _QUERY_MARGIN_S,
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=_WIRE_PRIORITY[Priority.EVENT],
                express=True,
                payload=payload,
            )

        timer = self._loop.call_later(timeout_s, outcome.end_by_timeout)
        self._asking.append(outcome)
        self._sure_sender.queue_call(Priority.EVENT, start_query, len(payload))
        try:
            await outcome.settled
        finally:
            timer.cancel()
            self._asking.remove(outcome)

    async def announce(self, key: str) -> BusDeclaration:
        declaration = _ZenohDeclaration(self._standing)
        check_key(key)
        token = await self._run_declaration(lambda: self._sure.liveliness().declare_token(key))
        declaration.attach(token.undeclare)
        return declaration

    async def watch(self, expression: str, callback: Callable[[str, bool], None]) -> BusDeclaration:
        declaration = _ZenohDeclaration(self._standing)
        present_keys: set[str] = set()

        def notify_change(key: str, *, present: bool) -> None:
            # Zenoh may repeat an earlier notification, e.g. after a reconnect.
            if not declaration.stands or present == (key in present_keys):
                return
            if present:
                present_keys.add(key)
            else:
                present_keys.remove(key)
            callback(key, present)

        def receive_token(sample: zenoh.Sample) -> None:
            present = sample.kind == zenoh.SampleKind.PUT
            self._inbox.queue_call(Priority.EVENT, partial(notify_change, str(sample.key_expr), present=present))

        check_expression(expression)
        subscriber = await self._run_declaration(
            lambda: self._lossy.liveliness().declare_subscriber(
                expression, _make_direct_callback(receive_token), history=True
            )
        )
        declaration.attach(subscriber.undeclare)
        return declaration

    async def watch_subscribers(self, expression: str, callback: Callable[[bool], None]) -> BusDeclaration:
        declaration = _ZenohDeclaration(self._standing)

        def notify_change(*, matches: bool) -> None:
            if declaration.stands:
                callback(matches)

        def receive_status(status: zenoh.MatchingStatus) -> None:
            self._inbox.queue_call(Priority.EVENT, partial(notify_change, matches=status.matching))

        def declare() -> zenoh.Publisher:
            publisher = self._lossy.declare_publisher(expression)
            # It lasts as long as its publisher, which a background listener does not keep alive.
            publisher.declare_matching_listener(_make_direct_callback(receive_status))
            return publisher

        check_expression(expression)
        publisher = await self._run_declaration(declare)
        declaration.attach(publisher.undeclare)
        return declaration

    @property
    def backlog(self) -> int:
        return self._lossy_sender.backlog + self._sure_sender.backlog

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        for outcome in self._asking:
            outcome.end_by_error(BusClosed(f"the bus was closed during a request for {outcome.key}"))
        self._answerer.cancel_all()
        self._inbox.close()
        is_stuck = await run_in_thread("bus-close", self._flush_senders)
        closings = threading.Semaphore(0)

        def close_session(session: zenoh.Session) -> None:
            try:
                session.close()
            finally:
                closings.release()

        def close_all() -> None:
            until_s = time.monotonic() + _FLUSH_TIMEOUT_S
            for sender in (self._sure_sender, self._lossy_sender):
                sender.wait_for_call(max(0.0, until_s - time.monotonic()))
            for _ in closing:
                closings.acquire(timeout=max(0.0, until_s - time.monotonic()))
            time.sleep(_DROP_TIMEOUT_S)

        closing = [run_in_thread("bus-close", partial(close_session, session)) for session in (self._lossy, self._sure)]
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                for failure in await asyncio.gather(*closing, return_exceptions=True):
                    if isinstance(failure, Exception):
                        _LOG.warning("closing the bus at %s: %s", self._endpoint, failure)
        except TimeoutError:
            _LOG.warning("the router at %s does not answer; disconnected without it", self._endpoint)
            is_stuck = True
        if is_stuck:
            atexit.register(close_all)

    def _flush_senders(self) -> bool:
        """Send what is left. Returns whether some of it could not be sent in time and may still be in progress."""
        until_s = time.monotonic() + CLOSE_TIMEOUT_S
        counts = [
            sender.stop(max(0.0, until_s - time.monotonic())) for sender in (self._sure_sender, self._lossy_sender)
        ]
        if sum(counts):
            _LOG.warning("%d samples were not taken by the bus at %s", sum(counts), self._endpoint)
        return any(counts)

    async def _run_declaration(self, declare: Callable[[], T]) -> T:
        self._check_open()
        return await run_in_thread("bus-declare", declare)

    def _check_open(self) -> None:
        if self._closed:
            raise BusClosed(f"the bus at {self._endpoint} is closed")

    def _is_connected(self) -> bool:
        return not self._closed and bool(self._sure.info.routers_zid())

    def _transport_event(self, event: zenoh.TransportEvent) -> None:
        is_lost = event.kind == zenoh.SampleKind.DELETE
        self._inbox.queue_call(Priority.EVENT, partial(self._transport_changed, lost=is_lost))

    def _transport_changed(self, *, lost: bool) -> None:
        if lost:
            self._disconnects += 1
            _LOG.warning("lost the router at %s; samples published meanwhile are lost", self._endpoint)
        elif self._disconnects:
            _LOG.info("the router at %s is back", self._endpoint)


async def open_bus(
    endpoint: str, timeout_s: float = CONNECT_TIMEOUT_S, max_message_bytes: int = MAX_MESSAGE_BYTES
) -> ZenohBus:
    """Connect to the bus whose router listens at `endpoint`. Raises `RouterUnreachable` after `timeout_s`.

    max_message_bytes: larger messages are left out before they are read, and counted; an e-stop counts all the same.
    """
    connect = partial(open_session, endpoint, timeout_s)
    lossy = await run_in_thread("bus-open", connect)
    try:
        sure = await run_in_thread("bus-open", connect)
    except BaseException:
        await run_in_thread("bus-close", lossy.close)
        raise
    return ZenohBus(endpoint, lossy, sure, max_message_bytes)
