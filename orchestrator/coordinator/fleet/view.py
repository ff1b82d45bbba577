"""The coordinator's view of the fleet: every controller's last state, its information, its events."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusDeclaration, BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.log import ProcessLog
from orchestrator.bus.states.feed import Arrival, ControllerFeed
from orchestrator.bus.states.frame import SEEN_NS, Confirmation
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.coordinator.fleet.controller_events import ControllerEvents, EventListener
from orchestrator.coordinator.fleet.infos import QUERY_S, ControllerInfos
from orchestrator.coordinator.fleet.listening import Remove, add_to, add_to_each
from orchestrator.coordinator.fleet.slow_starts import SlowStarts
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.problems import first_error_text
from orchestrator.model.state import (
    AxisState,
    ControllerState,
    EventsReply,
    EventsRequest,
    ReadPosition,
)
from orchestrator.model.units import Unit

# An adapter that is silent for this long is dead or unreachable. Its host says at least every 0.4 s which states still
# hold; in motion only after polls, which wait for requests to other controllers on the line.
SILENT_NS = 700 * NS_PER_MS
# added for each of them: a poll takes up to four exchanges of 25 ms, on the slowest lines
OTHER_NS = 80 * NS_PER_MS

SLOW_REMEDY = "wait; its computer is slow, or overloaded"

StateListener = Callable[[ControllerState], None]


class FleetView:
    """Follows all controllers of the fleet file, and no others: a `FeedReceiver`."""

    def __init__(self, fleet: Fleet, bus: Bus, keys: FleetKeys, clock: Clock, log: ProcessLog) -> None:
        self.fleet = fleet
        self._bus = bus
        self._keys = keys
        self._clock = clock
        self._log = log
        self._feed = ControllerFeed(bus, keys, clock.now_ns, self, self._find_host)
        self.arrived_states: dict[str, ControllerState] = {}
        """By controller: the last state as it has arrived; its instants may be older than what is known."""
        self._confirmed: dict[str, Confirmation] = {}
        """By controller: what the last frame says of its state, if that was not applied to it yet."""
        self._heard_ns: dict[str, int] = {}
        self._vouched_ns: dict[str, int] = {}
        """By controller: the last frame, while that says that its adapter has kept its rate."""
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
        self.infos = ControllerInfos(bus, keys, self.servers, self.arrived_states, lambda: self.fleet.controllers)
        self.infos.make_absence = self.make_absence
        self._events = ControllerEvents(self._request_events, clock, log)
        self._state_listeners: list[StateListener] = []
        self._listeners_by_controller: dict[str, list[StateListener]] = {}
        self._arrival_listeners: list[Callable[[Collection[str]], None]] = []
        self.on_unknown: Callable[[str], None] = lambda _: None
        """Called with the name of a controller that publishes states, and that the fleet file does not have."""
        self._slow_starts = SlowStarts(bus, keys, clock)

    async def start(self) -> None:
        await self._slow_starts.start()
        await self._feed.start()

    async def close(self) -> None:
        await self._feed.close()
        await self._slow_starts.close()

    def last_state(self, controller: str) -> ControllerState | None:
        """The last state, however old, with the instants of its last reading."""
        state = self.arrived_states.get(controller)
        confirmation = self._confirmed.pop(controller, None)
        if state is not None and confirmation is not None:
            state = self.arrived_states[controller] = confirmation.apply(state)
        return state

    def is_silent(self, controller: str) -> bool:
        """Whether the controller's adapter has been silent for too long."""
        heard_ns = self._heard_ns.get(controller)
        if heard_ns is None:
            return True
        latest_ns = max(heard_ns, self._vouched_ns.get(controller, 0))
        return self._clock.now_ns() - latest_ns > self._silent_ns[controller]

    def axis_now(self, axis: str) -> AxisState | None:
        """The state of `controller.axis`; None while its controller is offline or silent."""
        controller, name = split_name(axis)
        state = self.arrived_states.get(controller)
        if state is None or self.is_silent(controller) or state.mode == "offline":
            return None
        return state.axes.get(name)

    def read_positions(self, axes: Iterable[str]) -> dict[str, ReadPosition]:
        """By axis, where it was read last; without those that are offline or silent, or were read at no known
        instant."""
        positions: dict[str, ReadPosition] = {}
        for axis in axes:
            axis_now, state = self.axis_now(axis), self.last_state(split_name(axis)[0])
            if axis_now is not None and state is not None and state.read_within is not None:
                unit = Unit(axis_now.unit)
                positions[axis] = ReadPosition(position=axis_now.position, unit=unit, read=state.read_within)
        return positions

    def describe_absence(self, controller: str, instance: str | None) -> str | None:
        """Why the adapter `instance` (None: any instance) is gone; None while it is there."""
        if self.is_silent(controller):
            return "its adapter is silent"
        # An adapter that restarted quickly was not silent for long, but has lost the state of its work.
        state = self.arrived_states.get(controller)
        anew = state is not None and instance is not None and state.instance != instance
        return "its adapter has restarted" if anew else None

    def has_all_events(self, controller: str, since_ns: int) -> bool:
        """Whether a state has arrived since `since_ns`, and every event that it counts."""
        state = self.arrived_states.get(controller)
        if state is None or self._stated_ns[controller] < since_ns:
            return False
        return self._events.has_all(state)

    def find_refusal(self, controller: str) -> Refusal | None:
        """Why the controller's adapter, as it runs now, is not adopted because of its version; None: it may be."""
        state, refusal = self.arrived_states.get(controller), self.refused.get(controller)
        return refusal[1] if refusal is not None and state is not None and state.instance == refusal[0] else None

    def describe_slow_start(self, controller: str) -> str | None:
        """That the adapter host of a silent controller is slow to start, and for how long, in steps of ten seconds."""
        is_silent = self.is_silent(controller)
        return self._slow_starts.describe(self.fleet.controllers[controller].host) if is_silent else None

    def make_absence(self, controller: str, reason: str) -> Refusal:
        """The refusal for a controller whose adapter does not answer. reason: as far as the bus knows it."""
        if (slow_start := self.describe_slow_start(controller)) is not None:
            return Refusal("absent", f"{controller}: {slow_start}", SLOW_REMEDY, controller)
        return Refusal("absent", f"{controller}: {reason}", "is its adapter host running?", controller)

    async def find_servers(self, controllers: Sequence[str]) -> dict[str, set[str]]:
        """By controller, the processes that answer for it; without those for which none does. Raises `BusError`."""
        expression = self._keys.state(controllers[0] if len(controllers) == 1 else None)
        return {
            key.split("/")[-2]: servers for key, servers in (await self._bus.find_servers(expression, QUERY_S)).items()
        }

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

    def add_event_listener(self, listener: EventListener) -> Remove:
        """Call `listener` with every event; the result removes the listener."""
        return self._events.add_listener(listener)

    def add_state_listener(self, listener: StateListener, controllers: Iterable[str] | None = None) -> Remove:
        """Call `listener` with every state of `controllers` (None: of all) that has changed, and now and then with one
        that has not; the result removes the listener."""
        if controllers is None:
            return add_to(self._state_listeners, listener)
        lists = [self._listeners_by_controller.setdefault(controller, []) for controller in controllers]
        return add_to_each(lists, listener)

    def add_arrival_listener(self, listener: Callable[[Collection[str]], None]) -> Remove:
        """Call `listener` with the controllers whose states have arrived, or hold still, once for each message of a
        host: the listener that needs that they are there, and not only what has changed."""
        return add_to(self._arrival_listeners, listener)

    async def follow_closely(self, controller: str) -> BusDeclaration:
        """Let every reading of a controller arrive as a state, until the result is undeclared; otherwise those of one
        at rest arrive only when they differ."""
        return await self._bus.subscribe(
            self._keys.state(controller), lambda sample: self.take_arrival(Arrival("", [sample], {}))
        )

    # Inside

    def take_arrival(self, arrival: Arrival) -> None:
        """Take what one message of a host has brought."""
        arrived_names = dict.fromkeys(arrival.confirmations)
        for sample in arrival.samples:
            kind = sample.key.rpartition("/")[2]
            if kind == "event":
                self._receive_event(sample)
            elif kind == "state" and (controller := self._receive_state(sample)) is not None:
                arrived_names[controller] = None
        now_ns = self._clock.now_ns()
        for controller, confirmation in arrival.confirmations.items():
            seen_ns = now_ns - confirmation.age_ns
            self._vouched_ns[controller] = now_ns if confirmation.age_ns <= SEEN_NS else 0
            if controller in self.arrived_states and seen_ns > self._heard_ns[controller]:
                self._heard_ns[controller] = self._stated_ns[controller] = seen_ns
                self._confirmed[controller] = confirmation
                self._events.expect(self.arrived_states[controller])
        for listener in list(self._arrival_listeners):
            listener(arrived_names)

    def _find_host(self, controller: str) -> str | None:
        config = self.fleet.controllers.get(controller)
        return None if config is None else config.host

    def take_bad_frame(self, text: str) -> None:
        """A frame of a host was left out."""
        self._log.warning(text)

    def _receive_state(self, sample: BusSample) -> str | None:
        """Store a state; return its controller, None if it cannot be read."""
        try:
            state = ControllerState.read_message(sample.payload)
        except ValidationError as error:
            self._log.warning(f"a state that cannot be read on {sample.key}: {first_error_text(error)}")
            return None
        self._store_state(state)
        return state.controller

    def _receive_event(self, sample: BusSample) -> None:
        event = self._events.receive(sample)
        if event is not None:
            self._heard_ns[event.controller] = self._clock.now_ns()

    async def _request_events(self, controller: str, after: int) -> EventsReply:
        request, server = EventsRequest(after=after), self.servers.get(controller)
        payload = await self._bus.request(self._keys.event(controller), request.to_json(), QUERY_S, server)
        return EventsReply.read_message(payload)

    def _store_state(self, state: ControllerState) -> None:
        controller, known_state = state.controller, self.arrived_states.get(state.controller)
        if controller not in self.fleet.controllers:
            self.on_unknown(controller)
            return
        if known_state is not None and state.is_older_than(known_state):
            return  # it was gathered in a frame while a newer one came as an answer
        self.arrived_states[controller] = state
        self._confirmed.pop(controller, None)
        self._heard_ns[controller] = self._stated_ns[controller] = self._clock.now_ns()
        self._events.expect(state)
        for listener in [*self._state_listeners, *self._listeners_by_controller.get(controller, ())]:
            listener(state)


def find_answering_states(view: FleetView, axes: Iterable[str]) -> dict[str, ControllerState]:
    """The last states of the controllers of axes, without those that have been silent for too long."""
    return {
        name: state
        for name in dict.fromkeys(map(controller_of, axes))
        if (state := view.last_state(name)) is not None and not view.is_silent(name)
    }
