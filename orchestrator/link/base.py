"""A link to a controller: bytes out and in, each with a host time stamp."""

from typing import NamedTuple, Protocol

from orchestrator.model.errors import TuttiError


class LinkRefused(TuttiError):
    """The link cannot be opened. The text names it, the reason, and the remedy."""


class LinkClosed(TuttiError):
    """The link is closed, by this side, by the other side, or by the wire. The text names it."""


class ReceivedBytes(NamedTuple):
    """Received bytes. at_ns: host time when the last of them was read from the operating system."""

    data: bytes
    at_ns: int


class Link(Protocol):
    """One open connection to one controller. Not shared between tasks, except for `write` of a stop."""

    @property
    def endpoint(self) -> str:
        """A description of the endpoint for people: `tcp 127.0.0.1:2300`, `serial /dev/ttyUSB0`."""
        ...

    @property
    def char_ns(self) -> int:
        """How long one byte takes on the wire, ns; 0 where it does not matter (Ethernet)."""
        ...

    def write(self, data: bytes) -> int:
        """Pass `data` to the operating system, without blocking. Returns the host time just before. Raises
        `LinkClosed`."""
        ...

    async def read(self) -> ReceivedBytes:
        """Wait for bytes. Raises `LinkClosed`."""
        ...

    def fileno(self) -> int:
        """The descriptor that a firing process may write to; -1 for a link in memory."""
        ...

    def record_write(self, at_ns: int, data: bytes) -> None:
        """Record that a firing process has written `data` to the descriptor at host time `at_ns`."""
        ...

    async def close(self) -> None:
        """Close; a waiting `read` raises `LinkClosed`. Safe to call twice."""
        ...


class OpenLink(Protocol):
    """How an adapter opens its links: live they are sockets and ports, in virtual time memory."""

    async def __call__(self) -> Link:
        """Open a further link to the controller. Raises `LinkRefused`."""
        ...
