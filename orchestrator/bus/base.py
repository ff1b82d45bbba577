"""What a bus is: keys, samples, requests, presence. Zenoh live, memory in virtual time; one contract suite for both.

Delivery guarantees are what both can keep: samples are in order per key and priority and nothing more; a
`STATE` sample may be lost; a request takes the first valid reply and never waits for the others.
Callbacks and handlers run on the event loop of the process that declared them, one at a time.

A bus latches nothing: who wants the last value of a key asks for it (`request`), and who puts it serves it.
Keys and expressions are checked (`orchestrator.bus.expression`); a malformed one raises `ValueError`.
"""

from collections.abc import Awaitable, Callable
from enum import Enum
from typing import NamedTuple, Protocol


class Priority(Enum):
    """How a sample is queued. `STATE` may be dropped when a peer does not keep up; the others never silently."""

    STATE = "state"
    EVENT = "event"
    ESTOP = "estop"


class Sample(NamedTuple):
    """One value put on a key."""

    key: str
    payload: bytes


class BusError(Exception):
    """A request that got no answer of use."""


class NoReply(BusError):
    """Nobody serves the key (an answer at once, not a time-out). The message names the key."""


class RequestTimeout(BusError):
    """Somebody serves the key, or is thought to, but no valid reply came in time. Names key and time."""


class RequestRefused(BusError):
    """The serving side answered with an error; its text is the message."""


class BusClosed(Exception):
    """Used after `close()`. Stop what puts and asks before the bus is closed."""


Handler = Callable[[Sample], Awaitable[bytes]]
"""Answers a request: takes key and payload, gives the reply's payload. Raises `RequestRefused` to answer an error.

Any other exception is reported to the event loop's exception handler and answered as an error that names it.
The sample's key is what was asked for, or the served expression where a wildcard was asked for.
"""


class Declared(Protocol):
    """A subscription, a served key, a presence token or a watch: stands until undeclared."""

    async def undeclare(self) -> None:
        """Take it back. After this returns no callback or handler of it starts any more."""
        ...


class Bus(Protocol):
    """One process's place on the bus. Keys are `/`-separated; expressions may hold `*` and `**` as Zenoh has them."""

    def put(self, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        """Hand a sample over and return at once; never blocks the event loop. Order holds per key and priority. An
        e-stop may be put on an expression: all hear it whose key it stands for."""
        ...

    async def subscribe(self, expression: str, callback: Callable[[Sample], None]) -> Declared:
        """Call `callback` with every sample on matching keys, from others and from this process itself."""
        ...

    async def serve(self, expression: str, handler: Handler) -> Declared:
        """Answer requests on matching keys. Requests are handled concurrently."""
        ...

    async def request(self, key: str, payload: bytes, timeout_s: float) -> bytes:
        """Ask on a key and take the first valid reply. An error reply counts only when no valid one comes.

        Raises `NoReply` as soon as the bus knows that nobody serves it, `RequestRefused`, or `RequestTimeout` after
        `timeout_s`: also where this process is cut off, because then nobody knows who serves.
        """
        ...

    async def request_all(self, expression: str, payload: bytes, timeout_s: float) -> dict[str, bytes]:
        """Ask everybody who serves a matching key; valid replies by key, those that came within `timeout_s`."""
        ...

    async def announce(self, key: str) -> Declared:
        """Be present under `key` until undeclared, closed, or dead."""
        ...

    async def watch(self, expression: str, callback: Callable[[str, bool], None]) -> Declared:
        """Call `callback(key, present)` for presence now and for every change of it."""
        ...

    @property
    def backlog(self) -> int:
        """Samples handed over and not yet taken by the transport: back-pressure, a fault when it grows."""
        ...

    async def close(self) -> None:
        """Undeclare all and leave. Safe to call twice."""
        ...
