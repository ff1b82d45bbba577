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

from orchestrator.bus.base import BusClosed, Declared, Handler, Priority, RequestRefused, Sample
from orchestrator.bus.expression import check_expression, check_key, check_put, is_wild
from orchestrator.bus.outcome import Outcome
from orchestrator.bus.zenoh.sessions import CONNECT_TIMEOUT_S, open_session
from orchestrator.bus.zenoh.threads import Inbox, Sender, off_loop

QUEUE_LIMIT = 1000
"""Maximum state samples that wait in this process, outwards or inwards; beyond that the oldest are lost."""

CLOSE_TIMEOUT_S = 1.0
"""For each of: sending what is left, closing the sessions. Zenoh's own close waits 10 s for a router that hangs."""

_LEFT_S = 3.0
_DROPPED_S = 0.1
"""A process must not end before its sessions are closed and their objects are dropped: otherwise the interpreter
ends Zenoh's threads in the middle of that, and the process ends by SIGABRT. A hanging router is not waited for
beyond that: threads that wait for it do nothing else."""

_GRACE_S = 0.02
"""A request ends without replies either because the key is not served or because the router has just died, which the
session may detect some milliseconds later."""

_QUERY_MARGIN_S = 0.5
"""Zenoh gives up a query this long after its sender."""

_REFUSED = "text/plain;refused"
"""Encoding of a refusal. Error replies that Zenoh makes itself (a timeout) have another one."""

T = TypeVar("T")
A = TypeVar("A")

_LOG = logging.getLogger(__name__)

_WIRE_PRIORITY = {
    Priority.STATE: zenoh.Priority.DATA,
    Priority.EVENT: zenoh.Priority.INTERACTIVE_HIGH,
    Priority.ESTOP: zenoh.Priority.REAL_TIME,
}


def _priority(sample: zenoh.Sample) -> Priority:
    if sample.priority == zenoh.Priority.REAL_TIME:
        return Priority.ESTOP
    return Priority.STATE if sample.priority == zenoh.Priority.DATA else Priority.EVENT


def _direct(arrive: Callable[[A], None], end: Callable[[], None] | None = None) -> "Callback[A]":
    """Make a callback on Zenoh's own network thread, which must only hand over what has arrived, like an inbox. By
    default Zenoh makes a thread for each callback, for a query each time, which ends some time after its session;
    if the interpreter ends meanwhile, the process ends by SIGABRT."""
    return Callback(arrive, end, indirect=False)


class _Declaration:
    """A declaration on a session. `standing` holds all active ones, because Zenoh undeclares what is not referenced."""

    def __init__(self, standing: "dict[_Declaration, Callable[[], None]]") -> None:
        self.stands = True
        self._standing = standing

    def take(self, undeclare: Callable[[], None]) -> None:
        self._standing[self] = undeclare

    async def undeclare(self) -> None:
        self.stands = False
        undeclare = self._standing.pop(self, None)
        if undeclare is not None:
            await off_loop("bus-undeclare", undeclare)


class ZenohBus:
    """One process's connection to the bus. Made by `open_bus`."""

    def __init__(self, endpoint: str, lossy: zenoh.Session, sure: zenoh.Session) -> None:
        self._endpoint = endpoint
        self._loop = asyncio.get_running_loop()
        self._lossy = lossy
        self._sure = sure
        self._lossy_sender = Sender("bus-state", QUEUE_LIMIT)
        self._sure_sender = Sender("bus-events", QUEUE_LIMIT)
        self._inbox = Inbox(self._loop, QUEUE_LIMIT)
        self._closed = False
        self._standing: dict[_Declaration, Callable[[], None]] = {}
        self._disconnects = 0
        self._asking: list[Outcome] = []
        self._answering: set[asyncio.Task[None]] = set()
        # Held only so that it is not undeclared.
        self._transports = sure.info.declare_transport_events_listener(_direct(self._transport_event))

    def put(self, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        self._check_open()
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
        sender.hand(priority, call)

    async def subscribe(self, expression: str, callback: Callable[[Sample], None]) -> Declared:
        declaration = _Declaration(self._standing)

        def deliver(sample: Sample) -> None:
            if declaration.stands:
                callback(sample)

        def arrive(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                ours = Sample(str(sample.key_expr), sample.payload.to_bytes())
                self._inbox.add(_priority(sample), partial(deliver, ours))

        check_expression(expression)
        subscriber = await self._declare(lambda: self._lossy.declare_subscriber(expression, _direct(arrive)))
        declaration.take(subscriber.undeclare)
        return declaration

    async def serve(self, expression: str, handler: Handler) -> Declared:
        declaration = _Declaration(self._standing)

        def start(query: zenoh.Query) -> None:
            if not declaration.stands or self._closed:
                query.drop()
                return
            task = self._loop.create_task(self._answer(query, expression, handler))
            self._answering.add(task)
            task.add_done_callback(self._answering.discard)

        def arrive(query: zenoh.Query) -> None:
            self._inbox.add(Priority.EVENT, partial(start, query))

        check_expression(expression)
        queryable = await self._declare(
            lambda: self._sure.declare_queryable(expression, _direct(arrive), complete=False)
        )
        declaration.take(queryable.undeclare)
        return declaration

    async def _answer(self, query: zenoh.Query, expression: str, handler: Handler) -> None:
        asked = str(query.key_expr)
        key = expression if is_wild(asked) else asked
        payload = b"" if query.payload is None else query.payload.to_bytes()
        try:
            reply = partial(query.reply, key, await handler(Sample(key, payload)), express=True)
        except RequestRefused as refusal:
            reply = partial(query.reply_err, str(refusal), encoding=_REFUSED)
        except asyncio.CancelledError:
            query.drop()
            raise
        except Exception as error:
            text = f"{type(error).__name__} while answering {key}: {error}"
            self._loop.call_exception_handler({"message": text, "exception": error})
            reply = partial(query.reply_err, text, encoding=_REFUSED)

        def send() -> None:
            # Dropping the query tells its sender that no more replies come from here.
            with query:
                reply()

        self._sure_sender.hand(Priority.EVENT, send)

    async def request(self, key: str, payload: bytes, timeout_s: float) -> bytes:
        replies = await self._ask(check_key(key), payload, timeout_s, first_only=True)
        return next(iter(replies.values()))

    async def request_all(self, expression: str, payload: bytes, timeout_s: float) -> dict[str, bytes]:
        return await self._ask(check_expression(expression), payload, timeout_s, first_only=False)

    async def _ask(self, key: str, payload: bytes, timeout_s: float, *, first_only: bool) -> dict[str, bytes]:
        self._check_open()
        outcome = Outcome(key, timeout_s, first_only=first_only)
        disconnects = self._disconnects
        unsure = False

        def arrive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                answer = partial(outcome.take, str(reply.ok.key_expr), reply.ok.payload.to_bytes())
            elif reply.err is not None and str(reply.err.encoding) == _REFUSED:
                answer = partial(outcome.refuse, reply.err.payload.to_string())
            else:
                answer = doubt
            self._inbox.add(Priority.EVENT, answer)

        def doubt() -> None:
            nonlocal unsure
            unsure = True

        def end() -> None:
            if outcome.answered:
                outcome.complete()
            else:
                self._loop.call_later(_GRACE_S, end_unanswered)

        def end_unanswered() -> None:
            # While disconnected it is unknown which keys are served: only the timeout ends the request.
            if not unsure and self._disconnects == disconnects and self._connected():
                outcome.complete()

        def get() -> None:
            if outcome.over:
                return
            self._sure.get(
                key,
                _direct(arrive, partial(self._inbox.add, Priority.EVENT, end)),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s + _QUERY_MARGIN_S,
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=_WIRE_PRIORITY[Priority.EVENT],
                express=True,
                payload=payload,
            )

        timer = self._loop.call_later(timeout_s, outcome.expire)
        self._asking.append(outcome)
        self._sure_sender.hand(Priority.EVENT, get)
        try:
            return await outcome.settled
        finally:
            timer.cancel()
            self._asking.remove(outcome)

    async def announce(self, key: str) -> Declared:
        declaration = _Declaration(self._standing)
        check_key(key)
        token = await self._declare(lambda: self._sure.liveliness().declare_token(key))
        declaration.take(token.undeclare)
        return declaration

    async def watch(self, expression: str, callback: Callable[[str, bool], None]) -> Declared:
        declaration = _Declaration(self._standing)
        believed: set[str] = set()

        def tell(key: str, present: bool) -> None:
            # Zenoh may repeat an earlier notification, e.g. after a reconnect.
            if not declaration.stands or present == (key in believed):
                return
            if present:
                believed.add(key)
            else:
                believed.remove(key)
            callback(key, present)

        def arrive(sample: zenoh.Sample) -> None:
            present = sample.kind == zenoh.SampleKind.PUT
            self._inbox.add(Priority.EVENT, partial(tell, str(sample.key_expr), present))

        check_expression(expression)
        subscriber = await self._declare(
            lambda: self._lossy.liveliness().declare_subscriber(expression, _direct(arrive), history=True)
        )
        declaration.take(subscriber.undeclare)
        return declaration

    @property
    def backlog(self) -> int:
        return self._lossy_sender.backlog + self._sure_sender.backlog

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        for outcome in self._asking:
            outcome.fail(BusClosed(f"the bus was closed during a request for {outcome.key}"))
        for task in list(self._answering):
            task.cancel()
        self._inbox.close()
        left = await off_loop("bus-close", self._flush)
        gone = threading.Semaphore(0)

        def leave(session: zenoh.Session) -> None:
            try:
                session.close()
            finally:
                gone.release()

        def end() -> None:
            until_s = time.monotonic() + _LEFT_S
            for sender in (self._sure_sender, self._lossy_sender):
                sender.join(max(0.0, until_s - time.monotonic()))
            for _ in closing:
                gone.acquire(timeout=max(0.0, until_s - time.monotonic()))
            time.sleep(_DROPPED_S)

        closing = [off_loop("bus-close", partial(leave, session)) for session in (self._lossy, self._sure)]
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                for failure in await asyncio.gather(*closing, return_exceptions=True):
                    if isinstance(failure, Exception):
                        _LOG.warning("closing the bus at %s: %s", self._endpoint, failure)
        except TimeoutError:
            _LOG.warning("the router at %s does not answer; disconnected without it", self._endpoint)
            left = True
        if left:
            atexit.register(end)

    def _flush(self) -> bool:
        """Send what is left. Returns whether some of it could not be sent in time and may still be in progress."""
        until_s = time.monotonic() + CLOSE_TIMEOUT_S
        left = [sender.stop(max(0.0, until_s - time.monotonic())) for sender in (self._sure_sender, self._lossy_sender)]
        if sum(left):
            _LOG.warning("%d samples were not taken by the bus at %s", sum(left), self._endpoint)
        return any(left)

    async def _declare(self, declare: Callable[[], T]) -> T:
        self._check_open()
        return await off_loop("bus-declare", declare)

    def _check_open(self) -> None:
        if self._closed:
            raise BusClosed(f"the bus at {self._endpoint} is closed")

    def _connected(self) -> bool:
        return not self._closed and bool(self._sure.info.routers_zid())

    def _transport_event(self, event: zenoh.TransportEvent) -> None:
        lost = event.kind == zenoh.SampleKind.DELETE
        self._inbox.add(Priority.EVENT, partial(self._transport_changed, lost))

    def _transport_changed(self, lost: bool) -> None:
        if lost:
            self._disconnects += 1
            _LOG.warning("lost the router at %s; samples published meanwhile are lost", self._endpoint)
        elif self._disconnects:
            _LOG.info("the router at %s is back", self._endpoint)


async def open_bus(endpoint: str, timeout_s: float = CONNECT_TIMEOUT_S) -> ZenohBus:
    """Connect to the bus whose router listens at `endpoint`. Raises `RouterUnreachable` after `timeout_s`."""
    lossy = await off_loop("bus-open", partial(open_session, endpoint, timeout_s))
    try:
        sure = await off_loop("bus-open", partial(open_session, endpoint, timeout_s))
    except BaseException:
        await off_loop("bus-close", lossy.close)
        raise
    return ZenohBus(endpoint, lossy, sure)
