"""The last minute of bytes on a link, for `tutti trace` and for every fault."""

from collections import deque
from typing import Literal

from orchestrator.link.base import Link, Received

KEPT_NS = 60_000_000_000
KEPT_ENTRIES = 20_000  # bounds the memory of a link that is always busy

Direction = Literal["out", "in"]
Entry = tuple[int, Direction, bytes]


class TraceRing:
    """Entries of the last 60 s: (host ns, direction, bytes)."""

    def __init__(self) -> None:
        self._entries: deque[Entry] = deque(maxlen=KEPT_ENTRIES)

    def add(self, at_ns: int, direction: Direction, data: bytes) -> None:
        late = self._entries and at_ns < self._entries[-1][0]
        self._entries.append((at_ns, direction, data))
        if late:  # bytes written by another process are recorded afterwards
            self._entries = deque(sorted(self._entries, key=lambda entry: entry[0]), maxlen=KEPT_ENTRIES)
        while self._entries[0][0] < at_ns - KEPT_NS:
            self._entries.popleft()

    def entries(self) -> list[Entry]:
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
    def place(self) -> str:
        return self._link.place

    @property
    def char_ns(self) -> int:
        return self._link.char_ns

    def write(self, data: bytes) -> int:
        at_ns = self._link.write(data)
        self._ring.add(at_ns, "out", data)
        return at_ns

    async def read(self) -> Received:
        received = await self._link.read()
        self._ring.add(received.at_ns, "in", received.data)
        return received

    def fileno(self) -> int:
        return self._link.fileno()

    def wrote(self, at_ns: int, data: bytes) -> None:
        self._ring.add(at_ns, "out", data)

    async def close(self) -> None:
        await self._link.close()
