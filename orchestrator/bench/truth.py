"""Ground truth of simulated controllers, read while it is written; instants are host time in ns."""

import asyncio
import json
from pathlib import Path
from typing import Any

from orchestrator.model.errors import TuttiError

POLL_S = 0.02
TIMEOUT_S = 20.0
REORDER_NS = 5_000_000_000  # an entry may be this much older than the one written before it, with some margin


class NothingHappened(TuttiError):
    """An expected event did not happen. The text names it."""


def read_motions(path: Path, motor: str) -> list[tuple[int, int]]:
    """Return start and end of each completed motion of a motor, ns, from a simulator's log."""
    entries = map(json.loads, path.read_text(encoding="utf-8").splitlines())
    return sorted(
        (entry["start_ns"], entry["end_ns"]) for entry in entries if entry["event"] == "end" and entry["axis"] == motor
    )


class TruthLog:
    """The ground truth log of one simulated controller, from now on."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = path.stat().st_size
        self._entries: list[dict[str, Any]] = []

    async def wait_for_event(self, event: str, at_ns: int) -> int:
        """Return the instant of the cause `start`, `slowing` or `end` of any axis after `at_ns`. Raises
        `NothingHappened`."""
        try:
            async with asyncio.timeout(TIMEOUT_S):
                while (cause := self._find_first(event, at_ns)) is None:
                    await asyncio.sleep(POLL_S)
                    self._read_entries()
        except TimeoutError:
            raise NothingHappened(f"{self._path.stem}: no {event!r} within {TIMEOUT_S:g} s") from None
        return cause

    def find_ends(self, at_ns: int) -> list[int]:
        """Return the ends of motions that moved after `at_ns`, as far as recorded."""
        self._read_entries()
        return [entry["end_ns"] for entry in self._entries if entry["event"] == "end" and entry["end_ns"] > at_ns]

    def count_events(self, event: str, at_ns: int) -> int:
        """Return the number of such events of any axis after `at_ns`."""
        self._read_entries()
        return sum(entry["event"] == event and entry[f"{event}_ns"] > at_ns for entry in self._entries)

    def _find_first(self, event: str, at_ns: int) -> int | None:
        """Find the cause such event. Looks back only as far as necessary: a scan of all entries would disturb the
        measurement."""
        cause: int | None = None
        for entry in reversed(self._entries):
            ns = entry[f"{entry['event']}_ns"]
            if ns < at_ns - REORDER_NS:
                break
            if entry["event"] == event and ns > at_ns:
                cause = ns if cause is None else min(cause, ns)
        return cause

    def _read_entries(self) -> None:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            lines, newline, _ = file.read().rpartition(b"\n")
        self._offset += len(lines) + len(newline)
        self._entries += [json.loads(line) for line in lines.splitlines()]
