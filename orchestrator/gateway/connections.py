"""The connections of requests: how many there are, of which address, and which one gives way to a new one.

A new connection always finds a place, so that a stop gets through: an older one gives it its own. First come those that
have proven no right and wait for their client; a request that is at work is never ended.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

MAX_CONNECTIONS = 300
STOP_RESERVE = 50  # beyond them, for stops only
MAX_NOT_SIGNED_IN = 20  # of one address
GRACE_S = 0.1  # so long a new connection keeps its place: its request, perhaps a stop, may be on its way
NOTE_S = 10.0  # period of the lines in the log


@dataclass(slots=True, eq=False)
class Connection:
    """One connection. close: ends it at once. signed_in: its last request had the right to be there. working: the
    gateway has all of a request, and answers it. reading: it sends a request that has begun."""

    address: str
    begun_s: float
    close: Callable[[], None]
    signed_in: bool = False
    working: bool = False
    reading: bool = False
    beyond: bool = False

    @property
    def rank(self) -> tuple[int, float]:
        """The least one gives way first."""
        if not self.signed_in:
            return (1 if self.working else 0), self.begun_s
        return (4 if self.working else 3 if self.reading else 2), self.begun_s


@dataclass(slots=True)
class ConnectionTable:
    """All connections that are no sockets. note: called with a line for the log.

    Times are those of the event loop, in seconds.
    """

    note: Callable[[str], None] = lambda _: None
    connections: dict[Connection, None] = field(default_factory=dict[Connection, None])
    _counts: Counter[str] = field(default_factory=Counter[str])
    _closed: Counter[str] = field(default_factory=Counter[str])
    _noted_s: float = -NOTE_S

    def add_connection(self, connection: Connection, now_s: float) -> None:
        """Take a new connection, and end those that give way to it."""
        self.connections[connection] = None
        self._counts[connection.address] += 1
        self.make_room(now_s)
        connection.beyond = len(self.connections) > MAX_CONNECTIONS

    def remove_connection(self, connection: Connection) -> None:
        """Forget one that has ended, or became a socket."""
        if connection in self.connections:
            del self.connections[connection]
            self._counts[connection.address] -= 1
            if not self._counts[connection.address]:
                del self._counts[connection.address]

    def make_room(self, now_s: float) -> None:
        """End those that are too many: of an address, and of all."""
        for address in [address for address, count in self._counts.items() if count > MAX_NOT_SIGNED_IN]:
            self._limit_address(address, now_s)
        while len(self.connections) > MAX_CONNECTIONS:
            spares = (connection for connection in self.connections if self._may_end(connection, now_s))
            spare = min(spares, key=lambda connection: connection.rank, default=None)
            if spare is None:
                break
            self._end(spare)
        if self._closed and now_s - self._noted_s >= NOTE_S:
            address, count = self._closed.most_common(1)[0]
            text = f"{self._closed.total()} connections ended for new ones, {count} of them of {address}"
            self.note(f"{text}: an address has at most {MAX_NOT_SIGNED_IN} that are not signed in")
            self._noted_s = now_s
            self._closed.clear()

    def _limit_address(self, address: str, now_s: float) -> None:
        candidates = [
            connection for connection in self.connections if connection.address == address and not connection.signed_in
        ]
        candidates.sort(key=lambda connection: connection.rank)
        for connection in candidates[: max(0, len(candidates) - MAX_NOT_SIGNED_IN)]:
            if now_s - connection.begun_s >= GRACE_S:
                self._end(connection)

    def _may_end(self, connection: Connection, now_s: float) -> bool:
        """Whether it gives way to a new one now. Beyond the reserve none has a time of grace."""
        if connection.rank[0] == 4:
            return False
        is_over = len(self.connections) > MAX_CONNECTIONS + STOP_RESERVE
        return is_over or now_s - connection.begun_s >= GRACE_S

    def _end(self, connection: Connection) -> None:
        self.remove_connection(connection)
        self._closed[connection.address] += 1
        connection.close()
