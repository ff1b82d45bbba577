"""Bodies of requests: how much is read of them, how long, and how much of all of them together.

What is not signed in can send a sign-in, and nothing larger. A body that is signed in must arrive at a pace: one that
stands still would be kept in memory for as long as its sender likes.
"""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from starlette.types import Message, Receive

from orchestrator.gateway.replies import RefusedRequest
from orchestrator.model.errors import Refusal

MAX_BODY_BYTES = 4_000_000  # a job of 10,000 steps, and a part of points, fit
MAX_UNPROVEN_BYTES = 2_000  # of a request that is not signed in
MAX_BODIES_BYTES = 64_000_000  # of all requests at work
BODY_S = 5.0  # for a whole body that is not signed in; for the first byte of one that is
LEAST_BYTES_PER_S = 10_000  # of a body that is signed in
LONGEST_BODY_S = 120.0
BUSY_S = 0.1  # what has arrived is read also where this process itself was late


class BodyReader:
    """Reads bodies within the limits."""

    def __init__(self) -> None:
        self._bytes = 0

    @asynccontextmanager
    async def read_body(self, receive: Receive, *, signed_in: bool) -> AsyncGenerator[Receive]:
        """What receives the body of one request. It raises `RefusedRequest` for one that is too large or too slow."""
        body = _Body(self, receive, asyncio.get_running_loop().time(), signed_in=signed_in)
        try:
            yield body.receive
        finally:
            self._bytes -= body.size

    def add_bytes(self, count: int) -> None:
        """Count bytes of a body. Raises `RefusedRequest` if there are too many of all."""
        self._bytes += count
        if self._bytes > MAX_BODIES_BYTES:
            text = f"requests with {MAX_BODIES_BYTES // 1_000_000} MB are at work already"
            raise RefusedRequest(503, Refusal("too-many", text, "send large bodies one after the other"))


class _Body:
    """The body of one request."""

    def __init__(self, reader: BodyReader, receive: Receive, now_s: float, *, signed_in: bool) -> None:
        self.size = 0
        self._reader, self._receive, self._signed_in = reader, receive, signed_in
        self._begun_s = now_s
        self._second_s, self._second_bytes = now_s, 0  # the present second, and what has come in it
        self._complete = False

    async def receive(self) -> Message:
        """The next part; after the last one, the end of the connection."""
        if self._complete:
            return await self._receive()
        message = await self._receive_in_time()
        count = len(message.get("body", b""))
        self.size += count
        self._reader.add_bytes(count)
        self._complete = not message.get("more_body", False)
        if self.size > (MAX_BODY_BYTES if self._signed_in else MAX_UNPROVEN_BYTES):
            raise RefusedRequest(413, explain_size() if self._signed_in else explain_unproven())
        if self.size == count:
            self._second_s, self._second_bytes = asyncio.get_running_loop().time(), 0
        self._second_bytes += count
        return message

    async def _receive_in_time(self) -> Message:
        loop = asyncio.get_running_loop()
        while True:
            until_s = self._find_limit()
            try:
                async with asyncio.timeout_at(max(until_s, loop.time() + BUSY_S)):
                    return await self._receive()
            except TimeoutError:
                if not self._begin_second(loop.time()):
                    raise RefusedRequest(408, self._explain_pace()) from None

    def _find_limit(self) -> float:
        """When the next part must be here, in seconds of the loop."""
        if not self._signed_in or not self.size:
            return self._begun_s + BODY_S
        return min(self._second_s + 1.0, self._begun_s + LONGEST_BODY_S)

    def _begin_second(self, now_s: float) -> bool:
        """Begin the next second, if enough has come in the last one."""
        if not self._signed_in or self._second_bytes < LEAST_BYTES_PER_S or now_s >= self._begun_s + LONGEST_BODY_S:
            return False
        self._second_s, self._second_bytes = now_s, 0
        return True

    def _explain_pace(self) -> Refusal:
        if not self._signed_in or not self.size:
            text = f"the body did not come within {BODY_S:.0f} s"
        else:
            text = f"the body came slower than {LEAST_BYTES_PER_S // 1000} kB a second, or took {LONGEST_BODY_S:.0f} s"
        return Refusal("too-slow", text, "send it at once, and again by a better connection")


def explain_size() -> Refusal:
    """The refusal of a body that is too large."""
    text = f"the body has more than {MAX_BODY_BYTES // 1_000_000} MB"
    return Refusal("too-large", text, "split the job, or submit points of scans as a file: `tutti submit FILE`")


def explain_unproven() -> Refusal:
    """The refusal of a body that is too large for one that is not signed in."""
    text = f"the body has more than {MAX_UNPROVEN_BYTES // 1000} kB, and you are not signed in"
    return Refusal("too-large", text, "sign in, or send a token, first")
