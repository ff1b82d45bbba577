"""The events of one controller: numbered without gaps, published on the bus, and kept in a ring for subscribers that
missed some."""

from collections import deque

from orchestrator.model.state import ControllerEvent, EventsReply

EVENTS_KEPT = 1000


class EventRing:
    """Keep the last events of one adapter instance in their encoded form: thousands of objects would slow down a
    host."""

    def __init__(self, instance: str) -> None:
        self._instance = instance
        self._events: deque[tuple[int, bytes]] = deque(maxlen=EVENTS_KEPT)
        self.last_seq = 0

    def add_event(self, event: ControllerEvent) -> bytes:
        """Number and keep the event; return the bytes to publish."""
        payload = event.to_json()
        self._events.append((event.seq, payload))
        self.last_seq = event.seq
        return payload

    def events_after(self, seq: int) -> EventsReply:
        """Return the events numbered above `seq`, and how many of those the ring no longer has."""
        kept_events = [ControllerEvent.read_message(payload) for number, payload in self._events if number > seq]
        return EventsReply(
            instance=self._instance, events=kept_events, lost=max(0, self.last_seq - seq - len(kept_events))
        )
