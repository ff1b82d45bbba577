"""A link to a controller: bytes out and in, each with a host time stamp."""

from typing import NamedTuple, Protocol


class LinkRefused(Exception):
    """The link can not be opened. Says which, why, and what to do."""


class LinkClosed(Exception):
    """The link is closed, by us, by the other side, or by the wire. Names it."""


class Received(NamedTuple):
    """Bytes as they came. at_ns: host time when the last of them was taken from the operating system."""

    data: bytes
    at_ns: int


class Link(Protocol):
    """One open way to one controller. Not shared between tasks, but for `write` of a stop."""

    @property
    def place(self) -> str:
        """Where it leads, for people: `tcp 127.0.0.1:2300`, `serial /dev/ttyUSB0`."""
        ...

    @property
    def char_ns(self) -> int:
        """How long one byte takes on the wire, ns; 0 where that does not matter (Ethernet)."""
        ...

    def write(self, data: bytes) -> int:
        """Hand `data` to the operating system, without blocking. Host time just before it. Raises `LinkClosed`."""
        ...

    async def read(self) -> Received:
        """Wait for bytes. Raises `LinkClosed`."""
        ...

    def fileno(self) -> int:
        """The descriptor that a firing process may write to; -1 for a link in memory."""
        ...

    def wrote(self, at_ns: int, data: bytes) -> None:
        """Take note that a firing process has written `data` to the descriptor at host time `at_ns`."""
        ...

    async def close(self) -> None:
        """Close; a waiting `read` raises `LinkClosed`. Safe to call twice."""
        ...


class OpenLink(Protocol):
    """How an adapter gets its links; live they are sockets and ports, in virtual time memory."""

    async def __call__(self) -> Link:
        """A further link to the controller. Raises `LinkRefused`."""
        ...
