"""The events of one controller: numbered without gaps, put on the bus, and kept in a ring for those who missed some."""

from collections import deque

from orchestrator.model.state import Event, EventsReply

KEPT = 1000


class EventRing:
    """The last events of one instance of an adapter, as they were put: thousands of objects would slow down a host."""

    def __init__(self, instance: str) -> None:
        self._instance = instance
        self._events: deque[tuple[int, bytes]] = deque(maxlen=KEPT)
        self.last_seq = 0

    def add(self, event: Event) -> bytes:
        """Keep it; what is to be put of it."""
        payload = event.to_json()
        self._events.append((event.seq, payload))
        self.last_seq = event.seq
        return payload

    def after(self, seq: int) -> EventsReply:
        """Events numbered above `seq`, and how many of those the ring no longer has."""
        kept = [Event.model_validate_json(payload) for number, payload in self._events if number > seq]
        return EventsReply(instance=self._instance, events=kept, lost=max(0, self.last_seq - seq - len(kept)))
