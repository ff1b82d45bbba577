"""What simulated controllers really did, read while they write it down; instants are host time in ns."""

import asyncio
import json
from pathlib import Path
from typing import Any

LOOK_S = 0.02
GIVE_UP_S = 20.0


class NothingHappened(Exception):
    """What was waited for did not happen. Says what."""


class Truth:
    """The truth log of one simulated controller, from now on."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = path.stat().st_size
        self._entries: list[dict[str, Any]] = []

    async def after(self, event: str, at_ns: int) -> int:
        """When the first `start`, `slowing` or `end` of any axis came after `at_ns`. Raises `NothingHappened`."""
        try:
            async with asyncio.timeout(GIVE_UP_S):
                while (found := self._first(event, at_ns)) is None:
                    await asyncio.sleep(LOOK_S)
                    self._read()
        except TimeoutError:
            raise NothingHappened(f"{self._path.stem}: no {event!r} within {GIVE_UP_S:g} s") from None
        return found

    def ends_after(self, at_ns: int) -> list[int]:
        """When motions came to rest that moved after `at_ns`, as far as they are written down."""
        self._read()
        return [entry["end_ns"] for entry in self._entries if entry["event"] == "end" and entry["end_ns"] > at_ns]

    def count(self, event: str, at_ns: int) -> int:
        """How many such events of any axis came after `at_ns`."""
        self._read()
        return sum(entry["event"] == event and entry[f"{event}_ns"] > at_ns for entry in self._entries)

    def _first(self, event: str, at_ns: int) -> int | None:
        stamps = (entry[f"{event}_ns"] for entry in self._entries if entry["event"] == event)
        return min((ns for ns in stamps if ns > at_ns), default=None)

    def _read(self) -> None:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            whole, newline, _ = file.read().rpartition(b"\n")
        self._offset += len(whole) + len(newline)
        self._entries += [json.loads(line) for line in whole.splitlines()]
