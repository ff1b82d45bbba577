"""The last minute of bytes on a link, for `tutti trace` and for every fault."""

from collections import deque
from typing import Literal

from orchestrator.link.base import Link, ReceivedBytes

TRACE_NS = 60_000_000_000
MAX_TRACE_ENTRIES = 20_000  # bounds the memory of a link that is always busy

TraceDirection = Literal["out", "in"]
TraceEntry = tuple[int, TraceDirection, bytes]


class TraceRing:
    """Entries of the last 60 s: (host ns, direction, bytes). received_ns: host time of the last received bytes.
    bytes_out, bytes_in: on the link since the ring was made."""

    def __init__(self) -> None:
        self.received_ns = 0
        self.bytes_out = 0
        self.bytes_in = 0
        self._entries: deque[TraceEntry] = deque(maxlen=MAX_TRACE_ENTRIES)

    def add_entry(self, at_ns: int, direction: TraceDirection, data: bytes) -> None:
        late = self._entries and at_ns < self._entries[-1][0]
        self._entries.append((at_ns, direction, data))
        if direction == "in":
            self.received_ns = at_ns
            self.bytes_in += len(data)
        else:
            self.bytes_out += len(data)
        if late:  # bytes written by another process are recorded afterwards
            self._entries = deque(sorted(self._entries, key=lambda entry: entry[0]), maxlen=MAX_TRACE_ENTRIES)
        while self._entries[0][0] < at_ns - TRACE_NS:
            self._entries.popleft()

    def recent_entries(self) -> list[TraceEntry]:
        return list(self._entries)

    def tail_text(self, count: int = 200) -> list[str]:
        """The last `count` entries as readable lines, for a log."""
        return [f"{at_ns} {direction} {data!r}" for at_ns, direction, data in list(self._entries)[-count:]]


class TracedLink:
    """A link whose bytes are recorded in a ring."""

    def __init__(self, link: Link, ring: TraceRing) -> None:
        self._link = link
        self._ring = ring

    @property
    def endpoint(self) -> str:
        return self._link.endpoint

    @property
    def char_ns(self) -> int:
        return self._link.char_ns

    def write(self, data: bytes) -> int:
        at_ns = self._link.write(data)
        self._ring.add_entry(at_ns, "out", data)
        return at_ns

    async def read(self) -> ReceivedBytes:
        received = await self._link.read()
        self._ring.add_entry(received.at_ns, "in", received.data)
        return received

    def fileno(self) -> int:
        return self._link.fileno()

    def record_write(self, at_ns: int, data: bytes) -> None:
        self._ring.add_entry(at_ns, "out", data)

    async def close(self) -> None:
        await self._link.close()
