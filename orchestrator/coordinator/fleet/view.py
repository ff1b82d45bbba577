"""The coordinator's view of the fleet: every controller's last state, its information, its events."""

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusDeclaration, BusError, BusSample, find_only_server
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.start_limit import SLOW_NS
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.problems import first_error_text
from orchestrator.model.state import (
    AxisState,
    ControllerEvent,
    ControllerInfo,
    ControllerState,
    EventsReply,
    EventsRequest,
    ReadPosition,
)
from orchestrator.model.units import Unit

# An adapter that is silent for this long is dead or unreachable. It publishes 5 times a second; in motion only after
# polls, which wait for requests to other controllers on the line.
SILENT_NS = 700 * NS_PER_MS
# added for each of them: a poll takes up to four exchanges of 25 ms, on the slowest lines
OTHER_NS = 80 * NS_PER_MS

OVERTAKEN_NS = 30 * NS_PER_MS  # a state may arrive this much before an event that it counts

QUERY_S = 1.0  # for an adapter to answer a query

SLOW_REMEDY = "wait; its computer is slow, or overloaded"

EventListener = Callable[[ControllerEvent], None]


class FleetView:
    """Subscribes to all controllers of the fleet file, and to no others."""

    def __init__(self, fleet: Fleet, bus: Bus, keys: FleetKeys, clock: Clock, log: ProcessLog) -> None:
        self.fleet = fleet
        self._bus = bus
        self._keys = keys
        self._clock = clock
        self._log = log
        self._states: dict[str, ControllerState] = {}
        self._heard_ns: dict[str, int] = {}
        self._stated_ns: dict[str, int] = {}
        self._asked: dict[str, tuple[int, ControllerState]] = {}
        on_line = Counter(config.line for config in fleet.controllers.values())
        self.neighbours = {name: on_line[config.line] - 1 for name, config in fleet.controllers.items()}
        """Number of other controllers on the line of each controller."""
        self._silent_ns = {name: SILENT_NS + OTHER_NS * count for name, count in self.neighbours.items()}
        self.servers: dict[str, str] = {}
        """By controller: the process that answers for it since its adoption, and whose replies alone count."""
        self.adopted: dict[str, str] = {}
        """By controller: the instance of its adapter that this coordinator has adopted."""
        self.refused: dict[str, tuple[str, Refusal]] = {}
        """By controller: the instance of its adapter that is not adopted because of its version, and why."""
        self._infos: dict[str, ControllerInfo] = {}
        self._last_event: dict[str, tuple[str, int]] = {}
        self._awaited: dict[str, tuple[str, int]] = {}
        self._listeners: list[EventListener] = []
        self._state_listeners: list[Callable[[ControllerState], None]] = []
        self.on_unknown: Callable[[str], None] = lambda _: None
        """Called with the name of a controller that publishes states, and that the fleet file does not have."""
        self._declared: list[BusDeclaration] = []
        self._slow_starts_ns: dict[str, int] = {}
        """By adapter host that is slow to start: when its start began."""
        self._tasks = TaskOwner()

    async def start(self) -> None:
        self._declared = [
            await self._bus.subscribe(self._keys.state(), self._receive_state),
            await self._bus.subscribe(self._keys.event(), self._receive_event),
            await self._bus.watch(self._keys.slow_start(), self._receive_slow_start),
        ]
        for payload in (await self._bus.request_all(self._keys.state(), b"", QUERY_S)).values():
            self._receive_state(BusSample("", payload))

    async def close(self) -> None:
        for declaration in self._declared:
            await declaration.undeclare()

    def last_state(self, controller: str) -> ControllerState | None:
        """The last state, however old."""
        return self._states.get(controller)

    def is_silent(self, controller: str) -> bool:
        """Whether the controller's adapter has been silent for too long."""
        heard_ns = self._heard_ns.get(controller)
        return heard_ns is None or self._clock.now_ns() - heard_ns > self._silent_ns[controller]

    def axis_now(self, axis: str) -> AxisState | None:
        """The state of `controller.axis`; None while its controller is offline or silent."""
        controller, name = split_name(axis)
        state = self._states.get(controller)
        if state is None or self.is_silent(controller) or state.mode == "offline":
            return None
        return state.axes.get(name)

    def read_positions(self, axes: Iterable[str]) -> dict[str, ReadPosition]:
        """By axis, where it was read last; without those that are offline or silent, or were read at no known
        instant."""
        positions: dict[str, ReadPosition] = {}
        for axis in axes:
            axis_now, state = self.axis_now(axis), self._states.get(split_name(axis)[0])
            if axis_now is not None and state is not None and state.read_within is not None:
                unit = Unit(axis_now.unit)
                positions[axis] = ReadPosition(position=axis_now.position, unit=unit, read=state.read_within)
        return positions

    def describe_absence(self, controller: str, instance: str | None) -> str | None:
        """Why the adapter `instance` (None: any instance) is gone; None while it is there."""
        if self.is_silent(controller):
            return "its adapter is silent"
        # An adapter that restarted quickly was not silent for long, but has lost the state of its work.
        state = self._states.get(controller)
        anew = state is not None and instance is not None and state.instance != instance
        return "its adapter has restarted" if anew else None

    def has_all_events(self, controller: str, since_ns: int) -> bool:
        """Whether a state has arrived since `since_ns`, and every event that it counts."""
        state = self._states.get(controller)
        if state is None or self._stated_ns[controller] < since_ns:
            return False
        instance, last = self._last_event.get(controller, ("", 0))
        return instance == state.instance and last >= state.event_seq

    def find_refusal(self, controller: str) -> Refusal | None:
        """Why the controller's adapter, as it runs now, is not adopted because of its version; None: it may be."""
        state, refusal = self._states.get(controller), self.refused.get(controller)
        return refusal[1] if refusal is not None and state is not None and state.instance == refusal[0] else None

    def describe_slow_start(self, controller: str) -> str | None:
        """That the adapter host of a silent controller is slow to start, and for how long, in steps of ten seconds."""
        begun_ns = self._slow_starts_ns.get(self.fleet.controllers[controller].host)
        if begun_ns is None or not self.is_silent(controller):
            return None
        return f"its adapter is starting slowly ({(self._clock.now_ns() - begun_ns) // (10 * NS_PER_S) * 10} s)"

    def make_absence(self, controller: str, reason: str) -> Refusal:
        """The refusal for a controller whose adapter does not answer. reason: as far as the bus knows it."""
        if (slow_start := self.describe_slow_start(controller)) is not None:
            return Refusal("absent", f"{controller}: {slow_start}", SLOW_REMEDY, controller)
        return Refusal("absent", f"{controller}: {reason}", "is its adapter host running?", controller)

    async def bind_server(self, controller: str) -> None:
        """Find the process that answers for the controller: from now on only its replies count. Raises `DoubleServer`,
        and other `BusError`."""
        self.servers[controller] = await find_only_server(self._bus, self._keys.state(controller), QUERY_S)

    async def query_state(self, controller: str, since_ns: int | None = None) -> ControllerState:
        """Query the current state; or return the last one that was queried, or received with a lease, not before
        `since_ns`. Raises `BusError`."""
        asked_ns, state = self._asked.get(controller, (0, None))
        if state is not None and since_ns is not None and asked_ns >= since_ns:
            return state
        asked_ns = self._clock.now_ns()
        server = self.servers.get(controller)
        payload = await self._bus.request(self._keys.state(controller), b"", QUERY_S, server)
        state = ControllerState.read_message(payload)
        self.note_answer(state, asked_ns)
        return state

    def note_answer(self, state: ControllerState, asked_ns: int) -> None:
        """Record that this state is the answer to a query of `asked_ns`."""
        self._asked[state.controller] = (asked_ns, state)
        self._store_state(state)

    async def query_info(self, controller: str) -> ControllerInfo:
        """Identity and capabilities of the controller; queried once per instance of its adapter. Raises `BusError`."""
        info = self.find_info(controller)
        if info is None:
            info = self._infos[controller] = await self.ask_info(controller)
        return info

    def find_info(self, controller: str) -> ControllerInfo | None:
        """Identity and capabilities of the adapter that runs now, if they are known."""
        info, state = self._infos.get(controller), self._states.get(controller)
        return info if info is not None and state is not None and info.instance == state.instance else None

    async def require_info(self, controller: str) -> ControllerInfo:
        """The same. Raises `Refusal`."""
        try:
            return await self.query_info(controller)
        except BusError as error:
            raise self.make_absence(controller, str(error)) from None

    async def ask_info(self, controller: str) -> ControllerInfo:
        """Identity and capabilities of the controller as of now: it may not be connected yet. Raises `BusError`,
        `ValidationError`."""
        server = self.servers.get(controller)
        return ControllerInfo.read_message(await self._bus.request(self._keys.info(controller), b"", QUERY_S, server))

    def add_event_listener(self, listener: EventListener) -> Callable[[], None]:
        """Call `listener` with every event; the result removes the listener."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def add_state_listener(self, listener: Callable[[ControllerState], None]) -> Callable[[], None]:
        """Call `listener` with every state; the result removes the listener."""
        self._state_listeners.append(listener)
        return lambda: self._state_listeners.remove(listener)

    # Inside

    def _receive_state(self, sample: BusSample) -> None:
        try:
            state = ControllerState.read_message(sample.payload)
        except ValidationError as error:
            self._log.warning(f"a state that cannot be read on {sample.key}: {first_error_text(error)}")
        else:
            self._store_state(state)

    def _receive_slow_start(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback
        host = key.split("/")[-2]
        if present:
            self._slow_starts_ns[host] = self._clock.now_ns() - SLOW_NS
        else:
            self._slow_starts_ns.pop(host, None)

    def _store_state(self, state: ControllerState) -> None:
        if state.controller not in self.fleet.controllers:
            self.on_unknown(state.controller)
            return
        self._states[state.controller] = state
        self._heard_ns[state.controller] = self._stated_ns[state.controller] = self._clock.now_ns()
        mark = (state.instance, state.event_seq)
        if mark not in (self._last_event.get(state.controller), self._awaited.get(state.controller)):
            self._awaited[state.controller] = mark
            self._clock.call_at_ns(
                self._clock.now_ns() + OVERTAKEN_NS, partial(self._query_last_event, state.controller, mark)
            )
        for listener in list(self._state_listeners):
            listener(state)

    def _query_last_event(self, controller: str, told: tuple[str, int]) -> None:
        """Query the last event, which may not be followed by another, if it has not arrived by itself meanwhile."""
        instance, last = self._last_event.get(controller, ("", 0))
        if instance != told[0]:
            self._last_event[controller] = told  # events before the first contact with that adapter are not needed
        elif last < told[1]:
            self._tasks.spawn(self._query_missed_events(controller, last))

    def _receive_event(self, sample: BusSample) -> None:
        try:
            event = ControllerEvent.read_message(sample.payload)
        except ValidationError as error:
            self._log.warning(f"an event that cannot be read on {sample.key}: {first_error_text(error)}")
            return
        self._heard_ns[event.controller] = self._clock.now_ns()
        instance, last = self._last_event.get(event.controller, ("", 0))
        if instance == event.instance and event.seq <= last:
            return
        if instance == event.instance and event.seq > last + 1:
            self._tasks.spawn(self._query_missed_events(event.controller, last))
        else:
            self._deliver_event(event)

    def _deliver_event(self, event: ControllerEvent) -> None:
        self._last_event[event.controller] = (event.instance, event.seq)
        for listener in list(self._listeners):
            listener(event)

    async def _query_missed_events(self, controller: str, after: int) -> None:
        """Query the events that were missed; the one that revealed the gap is among them."""
        try:
            request, server = EventsRequest(after=after), self.servers.get(controller)
            payload = await self._bus.request(self._keys.event(controller), request.to_json(), QUERY_S, server)
            reply = EventsReply.read_message(payload)
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
            if (event.instance, event.seq) > self._last_event.get(controller, ("", 0)) or (
                event.instance != self._last_event.get(controller, ("", 0))[0]
            ):
                self._deliver_event(event)


async def prefetch_infos(view: FleetView, controllers: Iterable[str]) -> None:
    """Query the identities and capabilities that are not known yet, all at once. A controller that does not answer is
    left to the query that needs it."""
    new_controllers = [name for name in controllers if view.find_info(name) is None]
    if len(new_controllers) > 1:
        await asyncio.gather(*map(view.query_info, new_controllers), return_exceptions=True)


def find_answering_states(view: FleetView, axes: Iterable[str]) -> dict[str, ControllerState]:
    """The last states of the controllers of axes, without those that have been silent for too long."""
    return {
        name: state
        for name in dict.fromkeys(map(controller_of, axes))
        if (state := view.last_state(name)) is not None and not view.is_silent(name)
    }
