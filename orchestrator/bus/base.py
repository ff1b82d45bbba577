"""The contract of a bus: keys, samples, requests, presence. Zenoh live, memory in virtual time; one contract suite
for both.

Both guarantee the same: samples are in order per key and priority, and no more; a `STATE` sample may be lost; a
request takes the first valid reply and does not wait for others. Callbacks and handlers run on the event loop of the
process that declared them, one at a time.

A bus stores no values: a reader queries the last value of a key (`request`), and its publisher serves it. Keys and
expressions are checked (`orchestrator.bus.expression`); a malformed one raises `ValueError`.
"""

from collections.abc import Awaitable, Callable, Iterable
from enum import Enum
from typing import NamedTuple, Protocol

from orchestrator.model.errors import TuttiError


class Priority(Enum):
    """How a sample is queued. `STATE` may be dropped when a peer cannot keep up; the others are never dropped
    silently."""

    STATE = "state"
    EVENT = "event"
    ESTOP = "estop"


class BusSample(NamedTuple):
    """One value published on a key."""

    key: str
    payload: bytes


class BusError(TuttiError):
    """A request that got no valid answer."""


class NoReply(BusError):
    """No process serves the key (reported at once, not after a timeout). The message names the key."""


class OtherServer(NoReply):
    """The key is served, but not by the process whose reply was expected. The message names the key."""


class DoubleServer(BusError):
    """Several processes serve a key that only one may serve. The message names the key."""


class RequestTimeout(BusError):
    """The key is served, or may be, but no valid reply arrived in time. The message names key and time."""


class RequestRefused(BusError):
    """The serving side answered with an error; its text is the message."""


class BusClosed(TuttiError):
    """The bus was used after `close()`. End publishers and requests before the bus is closed."""


RequestHandler = Callable[[BusSample], Awaitable[bytes]]
"""Answers a request: receives key and payload, returns the reply's payload. Raises `RequestRefused` to answer with
an error.

Any other exception is reported to the event loop's exception handler and answered as an error that names it. The
sample's key is the requested key, or the served one if a wildcard was requested.

A request on a wildcard, which any tool may send to look around, gets values and no errors: what serves an expression
(commands) is not called, and a handler's refusal is not sent.
"""


class ServedGroup(Protocol):
    """Keys that one declaration serves, and that may become others meanwhile."""

    def find_handler(self, key: str) -> RequestHandler | None:
        """What answers a request on `key`; None: nothing, as if the key was not served."""
        ...

    def list_values(self) -> Iterable[str]:
        """The keys that have values: a request on a wildcard is answered with those that match, and with no others."""
        ...


class BusDeclaration(Protocol):
    """A subscription, a served key, a presence token or a watch; it is active until undeclared."""

    async def undeclare(self) -> None:
        """End it. After this returns none of its callbacks or handlers starts any more."""
        ...


class Bus(Protocol):
    """One process's connection to the bus. Keys are `/`-separated; expressions may contain `*` and `**` with Zenoh's
    meaning."""

    def put(self, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        """Queue a sample and return at once; never blocks the event loop. Order is kept per key and priority. An
        e-stop may be published on an expression: all subscribers of matching keys receive it."""
        ...

    async def subscribe(
        self, expression: str, callback: Callable[[BusSample], None], *, direct: bool = False
    ) -> BusDeclaration:
        """Call `callback` with every sample on matching keys, from other processes and from this one.

        direct: call it at once, in the transport's own thread; for a process that only collects. It must be short and
        safe to call from any thread, and must not use the bus. It costs a third of the processor time.
        """
        ...

    async def serve(self, expression: str, handler: RequestHandler) -> BusDeclaration:
        """Answer requests on matching keys. Requests are handled concurrently."""
        ...

    async def serve_group(self, expression: str, group: ServedGroup) -> BusDeclaration:
        """Answer requests on the keys of `group` that match `expression`, by one declaration for all of them."""
        ...

    async def request(self, key: str, payload: bytes, timeout_s: float, server: str | None = None) -> bytes:
        """Send a request and return the first valid reply. An error reply counts only if no valid one arrives.

        server: the process whose reply counts, as `find_servers` names it; those of others are ignored, and it is
        waited for. None: any.

        Raises `OtherServer` if that process does not answer and another one does, `NoReply` as soon as the bus detects
        that the key is not served, `RequestRefused`, or `RequestTimeout` after `timeout_s`; the latter also if this
        process is disconnected, because it cannot tell then which keys are served.
        """
        ...

    async def request_all(self, expression: str, payload: bytes, timeout_s: float) -> dict[str, bytes]:
        """Send a request to all processes that serve a matching key; return the valid replies within `timeout_s`, by
        key."""
        ...

    async def find_servers(self, expression: str, timeout_s: float) -> dict[str, set[str]]:
        """Ask all processes that serve a matching key, with an empty request; return, by key, the names that the
        transport has for those that gave a valid reply within `timeout_s`. A name is of one connection of a process,
        and new with each start. Raises `NoReply`, `RequestTimeout` if there is none."""
        ...

    async def announce(self, key: str) -> BusDeclaration:
        """Announce presence under `key` until undeclared, closed, or dead."""
        ...

    async def watch(self, expression: str, callback: Callable[[str, bool], None]) -> BusDeclaration:
        """Call `callback(key, present)` with the present tokens and with every change."""
        ...

    async def watch_subscribers(self, expression: str, callback: Callable[[bool], None]) -> BusDeclaration:
        """Call `callback` with whether any process subscribes to a key that matches `expression`: soon with true if one
        does, and with every change."""
        ...

    def report_double_answers(self, callback: Callable[[str], None]) -> None:
        """Call `callback` with each key on which two processes have answered one request: only one may serve it."""
        ...

    @property
    def backlog(self) -> int:
        """Samples that are queued but not yet taken by the transport: back-pressure, a fault when it grows."""
        ...

    async def close(self) -> None:
        """Undeclare all and disconnect. Safe to call twice."""
        ...


async def find_only_server(bus: Bus, expression: str, timeout_s: float) -> str:
    """The one process that serves the keys of `expression`. Raises `DoubleServer`, `NoReply`, `RequestTimeout`."""
    servers = set[str]().union(*(await bus.find_servers(expression, timeout_s)).values())
    if len(servers) > 1:
        raise DoubleServer(f"{len(servers)} processes answer on {expression}, where only one may")
    return servers.pop()
