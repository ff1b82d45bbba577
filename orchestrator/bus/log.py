"""Logging: JSON lines with source, time (UTC and fleet time) and subject; warnings and errors also on the bus."""

import json
from collections.abc import Callable
from typing import Any

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import Clock

LogSink = Callable[[str], None]


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
        self.fleet_ns: Callable[[], int | None] = lambda: None

    def info(self, text: str, **fields: Any) -> None:
        """Write a line to the file only. Fields: job, step, epoch, controller, and others that explain it."""
        self._sink(self._make_line("info", text, fields))

    def warning(self, text: str, **fields: Any) -> None:
        """Write a line to the file and publish it on the bus."""
        line = self._make_line("warning", text, fields)
        self._sink(line)
        if self._bus is not None:
            self._bus.put(self._key, line.encode(), Priority.EVENT)

    def _make_line(self, level: str, text: str, fields: dict[str, Any]) -> str:
        entry = {"utc": self._clock.utc(), "fleet_ns": self.fleet_ns(), "level": level, **self._origin, "text": text}
        return json.dumps(entry | fields, default=str)
