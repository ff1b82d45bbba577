"""The events of one controller: numbered without gaps, put on the bus, and kept in a ring for those who missed some."""

from collections import deque

from orchestrator.model.state import Event, EventsReply

KEPT = 1000


class EventRing:
    """The last events of one instance of an adapter."""

    def __init__(self, instance: str) -> None:
        self._instance = instance
        self._events: deque[Event] = deque(maxlen=KEPT)
        self.last_seq = 0

    def add(self, event: Event) -> None:
        self._events.append(event)
        self.last_seq = event.seq

    def after(self, seq: int) -> EventsReply:
        """Events numbered above `seq`, and how many of those the ring no longer has."""
        kept = [event for event in self._events if event.seq > seq]
        return EventsReply(instance=self._instance, events=kept, lost=max(0, self.last_seq - seq - len(kept)))
