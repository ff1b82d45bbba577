"""Alarms and events for the stream."""

from collections import deque
from collections.abc import Iterable
from typing import Any

from orchestrator.gateway.stream.merge_patch import drop_nulls
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.state import ControllerEvent

MAX_EVENTS, MAX_ALARMS = 100, 1000


class FleetMessages:
    """The newest events, numbered, and the alarms that are not normal."""

    def __init__(self) -> None:
        self.alarms: dict[str, dict[str, Any]] = {}
        self.events: deque[dict[str, Any]] = deque(maxlen=MAX_EVENTS)
        self._event_number = 0

    def take_alarm(self, alarm: AlarmRecord) -> None:
        """Store an alarm."""
        if alarm.state == "normal":
            self.alarms.pop(alarm.id, None)
        elif len(self.alarms) < MAX_ALARMS or alarm.id in self.alarms:
            self.alarms[alarm.id] = drop_nulls(alarm.to_plain())

    def take_alarms(self, alarms: Iterable[AlarmRecord]) -> None:
        """Store all alarms that are not normal."""
        self.alarms.clear()
        for alarm in alarms:
            self.take_alarm(alarm)

    def take_event(self, event: ControllerEvent) -> None:
        """Store an event."""
        self._event_number += 1
        entry = {"n": self._event_number, "controller": event.controller, "kind": event.kind, "text": event.text}
        self.events.append(drop_nulls(entry | {"utc": event.utc, "job": event.job, "step": event.step}))
