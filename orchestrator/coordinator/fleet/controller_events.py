"""The events of all controllers, each once and in order; those that were missed are queried."""

from collections.abc import Awaitable, Callable
from functools import partial

from pydantic import ValidationError

from orchestrator.bus.base import BusError, BusSample
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.fleet.listening import Remove, add_to
from orchestrator.model.problems import first_error_text
from orchestrator.model.state import ControllerEvent, ControllerState, EventsReply

OVERTAKEN_NS = 30 * NS_PER_MS  # a state may arrive this much before an event that it counts

EventListener = Callable[[ControllerEvent], None]


class ControllerEvents:
    """Passes events on. request_events: returns those of a controller after a number; raises `BusError`,
    `ValidationError`."""

    def __init__(
        self, request_events: Callable[[str, int], Awaitable[EventsReply]], clock: Clock, log: ProcessLog
    ) -> None:
        self._request_events = request_events
        self._clock, self._log = clock, log
        self._last: dict[str, tuple[str, int]] = {}
        self._awaited: dict[str, tuple[str, int]] = {}
        self._listeners: list[EventListener] = []
        self._tasks = TaskOwner()

    def add_listener(self, listener: EventListener) -> Remove:
        """Call `listener` with every event; the result removes the listener."""
        return add_to(self._listeners, listener)

    def has_all(self, state: ControllerState) -> bool:
        """Whether every event that a state counts has arrived."""
        instance, last = self._last.get(state.controller, ("", 0))
        return instance == state.instance and last >= state.event_seq

    def expect(self, state: ControllerState) -> None:
        """Take note of the events that a state counts: those that do not arrive soon are queried."""
        mark = (state.instance, state.event_seq)
        if mark not in (self._last.get(state.controller), self._awaited.get(state.controller)):
            self._awaited[state.controller] = mark
            self._clock.call_at_ns(
                self._clock.now_ns() + OVERTAKEN_NS, partial(self._query_last, state.controller, mark)
            )

    def receive(self, sample: BusSample) -> ControllerEvent | None:
        """Take an event as it was published; None: it cannot be read."""
        try:
            event = ControllerEvent.read_message(sample.payload)
        except ValidationError as error:
            self._log.warning(f"an event that cannot be read on {sample.key}: {first_error_text(error)}")
            return None
        instance, last = self._last.get(event.controller, ("", 0))
        if instance == event.instance and event.seq > last + 1:
            self._tasks.spawn(self._query_missed(event.controller, last))
        elif instance != event.instance or event.seq > last:
            self._deliver(event)
        return event

    def _query_last(self, controller: str, counted: tuple[str, int]) -> None:
        """Query the last event, which may not be followed by another, if it has not arrived by itself meanwhile."""
        instance, last = self._last.get(controller, ("", 0))
        if instance != counted[0]:
            self._last[controller] = counted  # events before the first contact with that adapter are not needed
        elif last < counted[1]:
            self._tasks.spawn(self._query_missed(controller, last))

    def _deliver(self, event: ControllerEvent) -> None:
        self._last[event.controller] = (event.instance, event.seq)
        for listener in list(self._listeners):
            listener(event)

    async def _query_missed(self, controller: str, after: int) -> None:
        """Query the events that were missed; the one that revealed the gap is among them."""
        try:
            reply = await self._request_events(controller, after)
        except BusError as error:
            self._log.warning(f"events after {after} of {controller} are missing: {error}", controller=controller)
            self._awaited.pop(controller, None)  # the next state triggers the query again
            return
        except ValidationError as error:
            self._log.warning(f"events after {after} of {controller} cannot be read: {first_error_text(error)}")
            self._awaited.pop(controller, None)
            return
        if reply.lost:
            self._log.warning(f"{reply.lost} events of {controller} are lost for good", controller=controller)
        for event in reply.events:
            last = self._last.get(controller, ("", 0))
            if event.instance != last[0] or event.seq > last[1]:
                self._deliver(event)
