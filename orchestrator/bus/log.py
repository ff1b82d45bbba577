"""Logging: JSON lines with source, time (UTC and fleet time) and subject; warnings and errors also on the bus."""

import json
from collections.abc import Callable
from typing import Any

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S, Clock

LogSink = Callable[[str], None]

MAX_LINES_PER_S = 100  # of one source in the file; the next line after that states how many were left out
MAX_PUBLISHED_PER_S = 20  # warnings of one source on the bus
MAX_LINE_CHARS = 8000


class _SecondLimit:
    """Allows a number of lines in each second of a clock, and counts the others."""

    def __init__(self, most: int) -> None:
        self.left_out = 0
        self._most = most
        self._second = -1
        self._used = 0

    def take_place(self, now_ns: int) -> bool:
        """Whether there is place for one more line in this second."""
        second = now_ns // NS_PER_S
        if second != self._second:
            self._second, self._used = second, 0
        self._used += 1
        if self._used > self._most:
            self.left_out += 1
            return False
        return True

    def clear_count(self) -> int:
        """How many lines were left out since the last call."""
        left_out, self.left_out = self.left_out, 0
        return left_out


class ProcessLog:
    """The log of one process or controller. `fleet_ns` returns fleet time where it is known.

    published: the bus and keys under which warnings are published."""

    def __init__(
        self, role: str, id: str, clock: Clock, sink: LogSink, published: tuple[Bus, FleetKeys] | None = None
    ) -> None:
        self._origin = {"role": role, "id": id}
        self._clock = clock
        self._sink = sink
        self._bus, keys = published or (None, None)
        self._key = keys.log(role, id) if keys else ""
        self._written = _SecondLimit(MAX_LINES_PER_S)
        self._published = _SecondLimit(MAX_PUBLISHED_PER_S)
        self.fleet_ns: Callable[[], int | None] = lambda: None

    def info(self, text: str, **fields: Any) -> None:
        """Write a line to the file only. Fields: job, step, epoch, controller, and others that explain it."""
        if self._written.take_place(self._clock.now_ns()):
            self._write_line("info", text, fields)

    def warning(self, text: str, **fields: Any) -> None:
        """Write a line to the file and publish it on the bus; of a flood of them, the first in each second."""
        now_ns = self._clock.now_ns()
        if not self._written.take_place(now_ns):
            return
        line = self._write_line("warning", text, fields)
        if self._bus is not None and self._published.take_place(now_ns):
            self._bus.put(self._key, line.encode(), Priority.EVENT)

    def _write_line(self, level: str, text: str, fields: dict[str, Any]) -> str:
        if left_out := self._written.clear_count():
            fields = {**fields, "left_out_before": left_out}
        entry = {"utc": self._clock.utc(), "fleet_ns": self.fleet_ns(), "level": level, **self._origin, "text": text}
        line = json.dumps(entry | fields, default=str)
        if len(line) > MAX_LINE_CHARS:
            excerpt = f"{text[: MAX_LINE_CHARS // 8]}… (the line had {len(line)} characters)"
            line = json.dumps({**entry, "text": excerpt})
        self._sink(line)
        return line
