"""Answers of a process to Zenoh queries."""

# Zenoh's type stubs omit many return types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportMissingModuleSource=false

import asyncio
from collections.abc import Callable, Sequence
from functools import partial

import zenoh

from orchestrator.bus.answering import FindAnswers
from orchestrator.bus.base import BusSample, Priority, RequestHandler, RequestRefused
from orchestrator.bus.expression import is_wild
from orchestrator.bus.limits import MAX_ANSWERING, MAX_MESSAGE_BYTES, is_stop
from orchestrator.bus.zenoh.threads import SenderThread
from orchestrator.clock.owner import TaskOwner

REFUSED = "text/plain;refused"
"""Encoding of a refusal. Error replies that Zenoh makes itself (a timeout) have another one."""


def require_sendable(what: str, payload: bytes) -> None:
    """Raises `RequestRefused` for a payload that no process would take."""
    if len(payload) > MAX_MESSAGE_BYTES:
        raise RequestRefused(f"the {what} has {len(payload)} bytes; at most {MAX_MESSAGE_BYTES} are sent")


class QueryAnswerer:
    """Runs the handlers of what a process serves, and sends their replies by `sender`."""

    def __init__(self, loop: asyncio.AbstractEventLoop, sender: SenderThread) -> None:
        self._loop = loop
        self._sender = sender
        self._tasks = TaskOwner()

    def start_answers(self, query: zenoh.Query, payload: bytes, find_answers: FindAnswers) -> None:
        """Answer a query in a task of its own, if there is an answer."""
        asked_key = str(query.key_expr)
        answers = find_answers(asked_key)
        if not answers:
            query.drop()
            return
        if len(self._tasks.pending) >= MAX_ANSWERING and not is_stop(asked_key):
            self.refuse_query(query, f"busy: {MAX_ANSWERING} requests are being answered; try again")
            return
        self._tasks.spawn(self._answer_query(query, payload, answers))

    def refuse_query(self, query: zenoh.Query, text: str) -> None:
        """Answer a query with an error."""
        self._send_replies(query, [partial(query.reply_err, text, encoding=REFUSED)])

    def cancel_all(self) -> None:
        """Leave what is not answered yet unanswered."""
        self._tasks.cancel_all()

    async def _answer_query(
        self, query: zenoh.Query, payload: bytes, answers: Sequence[tuple[str, RequestHandler]]
    ) -> None:
        try:
            replies = [await self._find_reply(query, payload, key, handler) for key, handler in answers]
        except asyncio.CancelledError:
            query.drop()
            raise
        self._send_replies(query, [reply for reply in replies if reply is not None])

    async def _find_reply(
        self, query: zenoh.Query, payload: bytes, key: str, handler: RequestHandler
    ) -> Callable[[], None] | None:
        """The call that sends the reply on one key; None: there is none."""
        try:
            answer = await handler(BusSample(key, payload))
            require_sendable("answer", answer)
        except RequestRefused as refusal:
            return None if is_wild(str(query.key_expr)) else partial(query.reply_err, str(refusal), encoding=REFUSED)
        except Exception as error:
            text = f"{type(error).__name__} while answering {key}: {error}"
            self._loop.call_exception_handler({"message": text, "exception": error})
            return partial(query.reply_err, text, encoding=REFUSED)
        return partial(query.reply, key, answer, express=True)

    def _send_replies(self, query: zenoh.Query, replies: Sequence[Callable[[], None]]) -> None:
        def send() -> None:
            # Dropping the query tells its sender that no more replies come from here.
            with query:
                for send_reply in replies:
                    send_reply()

        self._sender.queue_call(Priority.EVENT, send)
