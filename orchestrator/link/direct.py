"""Links to simulated controllers in the same process: a reply is there as soon as its request is written.

They cost next to nothing, so that fleets of hundreds of controllers can be measured. There is no wire to model; in
virtual time the faults of one can be injected all the same.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Clock, sleep_ns
from orchestrator.link.base import LinkClosed, LinkRefused, ReceivedBytes
from orchestrator.link.memory import FarConnection, LinkAcceptor, MemoryWire

PORT = "process"


class DirectLink:
    """One open connection. A reply that is not there after the request never comes: `read` raises `LinkClosed` then.

    clock: of its time stamps. wire: where faults are injected.
    """

    def __init__(self, endpoint: str, clock: Clock, far: LinkAcceptor, wire: "DirectWire | None" = None) -> None:
        self._endpoint = endpoint
        self._clock = clock
        self._wire = wire
        self._received: deque[tuple[bytes, int]] = deque()
        """Each with how late it is, ns."""
        self._late_ns = 0
        try:
            self._far: FarConnection | None = far.connect(PORT, self._receive, self._lose)
        except Exception as error:
            raise LinkRefused(f"{endpoint}: {error}") from error

    @property
    def endpoint(self) -> str:
        return self._endpoint

    @property
    def char_ns(self) -> int:
        return 0

    def write(self, data: bytes) -> int:
        """Pass a request to the controller, which answers before this returns."""
        if self._far is None:
            raise LinkClosed(f"{self._endpoint} is closed")
        at_ns, wire = self._clock.now_ns(), self._wire
        if wire is not None and wire.to_far is not None:
            data = wire.to_far(data)
        self._late_ns = 0 if wire is None or wire.find_late_ns is None else wire.find_late_ns(data)
        if wire is None or not wire.cut:
            self._far.receive_bytes(data)
        return at_ns

    async def read(self) -> ReceivedBytes:
        if not self._received:
            raise LinkClosed(f"{self._endpoint} {'is closed' if self._far is None else 'does not answer'}")
        data, late_ns = self._received.popleft()
        if late_ns:
            await sleep_ns(self._clock, late_ns)
        return ReceivedBytes(data, self._clock.now_ns())

    def fileno(self) -> int:
        return -1

    def record_write(self, at_ns: int, data: bytes) -> None:
        """A link keeps no record of itself; `TracedLink` does."""

    async def close(self) -> None:
        self.hang_up()

    def hang_up(self) -> None:
        """Close at once; the kernel does this for a process that died."""
        far_end = self._far
        self._lose()
        if far_end is not None and (self._wire is None or not self._wire.lose_close):
            far_end.close()

    def _receive(self, data: bytes) -> None:
        wire = self._wire
        if wire is not None and wire.to_near is not None:
            data = wire.to_near(data)
        if data:
            self._received.append((data, self._late_ns))

    def _lose(self) -> None:
        self._far = None
        if self._wire is not None and self in self._wire.links:
            self._wire.links.remove(self)


@dataclass(slots=True)
class DirectWire(MemoryWire):
    """In virtual time, what connects an adapter with a controller that is in its process when it is live. find_late_ns:
    how late the answer to a request is; None: none is."""

    find_late_ns: Callable[[bytes], int] | None = None

    async def open_link(self, clock: Clock | None = None) -> DirectLink:
        """Open a link. Raises `LinkRefused`."""
        if self.refuse or self.cut:
            raise LinkRefused(f"{self.endpoint}: connection refused; is the controller switched on?")
        link = DirectLink(self.endpoint, clock or self.clock, self.far, self)
        self.links.append(link)
        return link
