"""The last minute of bytes on a link, for `tutti trace` and for every fault."""

from collections import deque
from itertools import islice
from typing import Literal

from orchestrator.link.base import Link, ReceivedBytes

TRACE_NS = 60_000_000_000
TAIL_CHARACTERS = 3_500  # of the last entries in a log, whose lines have at most 8,000 with all escape sequences
MAX_TRACE_ENTRIES = 20_000  # bounds the memory of a link that is always busy

TraceDirection = Literal["out", "in"]
TraceEntry = tuple[int, TraceDirection, bytes]


class TraceRing:
    """Entries of the last 60 s: (host ns, direction, bytes). received_ns: host time of the last received bytes.

    Entries are numbered from 1 in the order in which they were recorded. Bytes that another process writes are recorded
    afterwards, so that this is not quite the order of their instants.

    bytes_out, bytes_in: on the link since the ring was made.
    """

    def __init__(self) -> None:
        self.received_ns = 0
        self.bytes_out = 0
        self.bytes_in = 0
        self.newest = 0
        """Number of the last entry."""
        self._entries: deque[TraceEntry] = deque(maxlen=MAX_TRACE_ENTRIES)

    def add_entry(self, at_ns: int, direction: TraceDirection, data: bytes) -> None:
        self._entries.append((at_ns, direction, data))
        self.newest += 1
        if direction == "in":
            self.received_ns = at_ns
            self.bytes_in += len(data)
        else:
            self.bytes_out += len(data)
        while self._entries[0][0] < at_ns - TRACE_NS:
            self._entries.popleft()

    @property
    def oldest(self) -> int:
        """Number of the first entry that is kept; beyond `newest` if there is none."""
        return self.newest - len(self._entries) + 1

    def entries_from(self, number: int, count: int) -> list[TraceEntry]:
        """At most `count` entries from this number on, in the order of their numbers."""
        start = max(0, number - self.oldest)
        return list(islice(self._entries, start, start + count))

    def first_since(self, at_ns: int) -> int:
        """Number of the first entry since an instant; beyond `newest` if there is none."""
        older = next((k for k, entry in enumerate(reversed(self._entries)) if entry[0] < at_ns), len(self._entries))
        return self.newest - older + 1

    def recent_entries(self) -> list[TraceEntry]:
        """All entries in the order of their instants."""
        return sorted(self._entries, key=lambda entry: entry[0])

    def tail_text(self) -> list[str]:
        """The last entries as readable lines, as many as a line of a log can hold; at least the beginning of one."""
        lines: list[str] = []
        characters_left = TAIL_CHARACTERS
        for at_ns, direction, data in reversed(self.recent_entries()):
            line = f"{at_ns} {direction} {data!r}"
            if lines and len(line) > characters_left:
                break
            lines.append(line[:TAIL_CHARACTERS])
            characters_left -= len(line)
        return lines[::-1]


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
        received_bytes = await self._link.read()
        self._ring.add_entry(received_bytes.at_ns, "in", received_bytes.data)
        return received_bytes

    def fileno(self) -> int:
        return self._link.fileno()

    def record_write(self, at_ns: int, data: bytes) -> None:
        self._ring.add_entry(at_ns, "out", data)

    async def close(self) -> None:
        await self._link.close()
