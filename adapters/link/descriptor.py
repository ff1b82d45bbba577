"""The common part of sockets and serial ports: a link over an open descriptor that never blocks."""

import asyncio
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Clock
from orchestrator.link.base import LinkClosed, ReceivedBytes

READ_BYTES = 65536


@dataclass(frozen=True, slots=True)
class OpenDescriptor:
    """An open file descriptor in non-blocking mode. release: closes it."""

    fd: int
    release: Callable[[], None]


class DescriptorLink:
    """A `Link` over an open descriptor. Needs a running asyncio loop.

    datagrams: an empty datagram is ignored, whereas an empty read of a stream is its end.

    Bytes are read as soon as the loop sees them, whether or not a reader waits, so that their stamps are exact.
    """

    def __init__(
        self, place: str, char_ns: int, descriptor: OpenDescriptor, clock: Clock, *, datagrams: bool = False
    ) -> None:
        self._place = place
        self._char_ns = char_ns
        self._fd = fd = descriptor.fd
        self._release = descriptor.release
        self._clock = clock
        self._datagrams = datagrams
        self._loop = asyncio.get_running_loop()
        self._received: deque[ReceivedBytes] = deque()
        self._waiting: asyncio.Future[None] | None = None
        self._closed_because: str | None = None
        self._loop.add_reader(fd, self._handle_readable)

    @property
    def endpoint(self) -> str:
        return self._place

    @property
    def char_ns(self) -> int:
        return self._char_ns

    def fileno(self) -> int:
        """Return the open descriptor. Raises `LinkClosed`: the number of a closed descriptor may be in use again."""
        self._require_open()
        return self._fd

    def record_write(self, at_ns: int, data: bytes) -> None:
        """Do nothing: a link keeps no record of itself; `TracedLink` does."""

    def write(self, data: bytes) -> int:
        self._require_open()
        at_ns = self._clock.now_ns()
        try:
            byte_count = os.write(self._fd, data)
        except BlockingIOError:
            byte_count = 0
        except OSError as error:
            self._shut_down(f"{self._place}: {error.strerror}")
            raise self._closed_error() from None
        if byte_count < len(data):
            # Half a command may have been sent: nothing sensible can follow it on this link.
            self._shut_down(
                f"{self._place}: only {byte_count} of {len(data)} bytes were accepted, the operating system's "
                "buffer is full; the controller does not read, or its handshake stops the transfer"
            )
            raise self._closed_error()
        return at_ns

    async def read(self) -> ReceivedBytes:
        while not self._received:
            self._require_open()
            self._waiting = self._loop.create_future()
            try:
                await self._waiting
            finally:
                self._waiting = None
        return self._received.popleft()

    async def close(self) -> None:
        self._shut_down(f"{self._place} is closed")

    def _handle_readable(self) -> None:
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._shut_down(f"{self._place}: {error.strerror}")
            return
        at_ns = self._clock.now_ns()
        if not data and self._datagrams:
            return
        if not data:
            self._shut_down(f"{self._place}: closed by the other side")
            return
        self._received.append(ReceivedBytes(data, at_ns))
        self._wake_reader()

    def _shut_down(self, because: str) -> None:
        if self._closed_because is not None:
            return
        self._closed_because = because
        self._loop.remove_reader(self._fd)
        self._release()
        self._wake_reader()

    def _wake_reader(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)

    def _require_open(self) -> None:
        if self._closed_because is not None:
            raise self._closed_error()

    def _closed_error(self) -> LinkClosed:
        return LinkClosed(self._closed_because or self._place)
