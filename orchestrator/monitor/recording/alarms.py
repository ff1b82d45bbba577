"""The alarms that a recorder asks the coordinator to raise, while their conditions last."""

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.executor import ThreadLock
from orchestrator.model.operation.alarms import AlarmRequest

REPEAT_NS = 30 * NS_PER_S  # an alarm whose request is not repeated is over after two minutes
ROLE = "recorder"
ACTION = "give the recordings room on the disk, or another folder; what happens meanwhile is not recorded"


class RecorderAlarms:
    """Takes alarms from the writer's thread, and publishes them from the event loop."""

    def __init__(self, bus: Bus, keys: FleetKeys, clock: Clock) -> None:
        self._bus, self._keys, self._clock = bus, keys, clock
        self._lock = ThreadLock()
        self._active: dict[str, str] = {}
        self._changed: set[str] = set()
        self._published_ns = 0

    def note_alarm(self, kind: str, text: str, *, active: bool) -> None:
        """An alarm of a kind is raised, or its condition is over. From any thread."""
        with self._lock:
            if active or kind in self._active:
                self._changed.add(kind)
            if active:
                self._active[kind] = text
            else:
                self._active.pop(kind, None)

    def publish_due(self) -> None:
        """Publish what has changed, and from time to time what lasts."""
        now_ns = self._clock.now_ns()
        with self._lock:
            repeat = now_ns - self._published_ns >= REPEAT_NS
            due = {*self._changed, *(self._active if repeat else ())}
            active = dict(self._active)
            self._changed.clear()
        if repeat:
            self._published_ns = now_ns
        for kind in sorted(due):
            request = AlarmRequest(
                kind=kind,
                subject=ROLE,
                text=active.get(kind, "recordings are written again"),
                action=ACTION,
                priority="medium",
                active=kind in active,
            )
            self._bus.put(self._keys.alarm_request(ROLE, kind), request.to_json(), Priority.EVENT)
