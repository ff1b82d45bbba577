"""What the coordinator knows of the fleet: every controller's last state, its information, its events."""

import asyncio
from collections import Counter
from collections.abc import Callable
from functools import partial

from pydantic import ValidationError

from orchestrator.bus.base import Bus, BusError, Declared, Sample
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.model.fleet import Fleet
from orchestrator.model.state import ControllerState, Event, EventsReply, EventsRequest, Info

# An adapter that says nothing for so long does not live, or can not be heard. It says something 5 times a second; in
# motion only what its controller has shown, which waits for what the others on its line are asked.
SILENT_NS = 700 * NS_PER_MS
OTHER_NS = 40 * NS_PER_MS  # more for each of them: eight SMC-2000 at 19,200 baud come to a word each in 0.7 s after T0

OVERTAKEN_NS = 30 * NS_PER_MS  # by so much may a state come before an event that it tells of

Listener = Callable[[Event], None]


class FleetView:
    """Listens to all controllers of the fleet file, and to nobody else."""

    def __init__(self, fleet: Fleet, bus: Bus, keys: Keys, clock: Clock, log: Log) -> None:
        self.fleet = fleet
        self._bus = bus
        self._keys = keys
        self._clock = clock
        self._log = log
        self._states: dict[str, ControllerState] = {}
        self._heard_ns: dict[str, int] = {}
        self._asked: dict[str, tuple[int, ControllerState]] = {}
        on_line = Counter(config.link.place for config in fleet.controllers.values())
        self.others = {name: on_line[config.link.place] - 1 for name, config in fleet.controllers.items()}
        """How many other controllers are on the line of each, whatever they are asked."""
        self._silent_ns = {name: SILENT_NS + OTHER_NS * others for name, others in self.others.items()}
        self._infos: dict[str, Info] = {}
        self._last_event: dict[str, tuple[str, int]] = {}
        self._awaited: dict[str, tuple[str, int]] = {}
        self._listeners: list[Listener] = []
        self._state_listeners: list[Callable[[ControllerState], None]] = []
        self._declared: list[Declared] = []
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        self._declared = [
            await self._bus.subscribe(self._keys.state(), self._take_state),
            await self._bus.subscribe(self._keys.event(), self._take_event),
        ]
        for payload in (await self._bus.request_all(self._keys.state(), b"", timeout_s=1.0)).values():
            self._take_state(Sample("", payload))

    async def close(self) -> None:
        for declared in self._declared:
            await declared.undeclare()

    def state(self, controller: str) -> ControllerState | None:
        """The last state, however old."""
        return self._states.get(controller)

    def silent(self, controller: str) -> bool:
        """Whether nothing was heard of the controller's adapter for too long."""
        heard_ns = self._heard_ns.get(controller)
        return heard_ns is None or self._clock.now_ns() - heard_ns > self._silent_ns[controller]

    def gone(self, controller: str, instance: str | None) -> str | None:
        """Why the adapter that was there as `instance` (None: as whichever) is there no more; None while it is."""
        if self.silent(controller):
            return "its adapter is silent"
        # Who died and is back already was never silent for long, and knows nothing of what it was doing.
        state = self._states.get(controller)
        anew = state is not None and instance is not None and state.instance != instance
        return "its adapter was started anew" if anew else None

    async def fresh(self, controller: str, since_ns: int | None = None) -> ControllerState:
        """The state as it is now, asked for; or as it was when it was last asked for, or for a lease, not before
        `since_ns`. Raises `BusError`."""
        asked_ns, state = self._asked.get(controller, (0, None))
        if state is not None and since_ns is not None and asked_ns >= since_ns:
            return state
        asked_ns = self._clock.now_ns()
        payload = await self._bus.request(self._keys.state(controller), b"", timeout_s=1.0)
        state = ControllerState.model_validate_json(payload)
        self.answered(state, asked_ns)
        return state

    def answered(self, state: ControllerState, asked_ns: int) -> None:
        """This is the answer to somebody who has asked then."""
        self._asked[state.controller] = (asked_ns, state)
        self._take(state)

    async def info(self, controller: str) -> Info:
        """Who the controller is; asked for once per instance of its adapter. Raises `BusError`."""
        known, state = self._infos.get(controller), self._states.get(controller)
        if known is not None and state is not None and known.instance == state.instance:
            return known
        payload = await self._bus.request(self._keys.info(controller), b"", timeout_s=1.0)
        info = self._infos[controller] = Info.model_validate_json(payload)
        return info

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with every event; the result ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def listen_states(self, listener: Callable[[ControllerState], None]) -> Callable[[], None]:
        """Call `listener` with every state; the result ends that."""
        self._state_listeners.append(listener)
        return lambda: self._state_listeners.remove(listener)

    # Inside

    def _take_state(self, sample: Sample) -> None:
        try:
            state = ControllerState.model_validate_json(sample.payload)
        except ValidationError as error:
            self._log.warning(f"a state that can not be read on {sample.key}: {error.errors()[0]['msg']}")
        else:
            self._take(state)

    def _take(self, state: ControllerState) -> None:
        if state.controller not in self.fleet.controllers:
            return
        self._states[state.controller] = state
        self._heard_ns[state.controller] = self._clock.now_ns()
        told = (state.instance, state.event_seq)
        if told not in (self._last_event.get(state.controller), self._awaited.get(state.controller)):
            self._awaited[state.controller] = told
            self._clock.call_at_ns(self._clock.now_ns() + OVERTAKEN_NS, partial(self._miss, state.controller, told))
        for listener in list(self._state_listeners):
            listener(state)

    def _miss(self, controller: str, told: tuple[str, int]) -> None:
        """Ask for the last event, which nothing may ever follow, if it has not come by itself meanwhile."""
        instance, last = self._last_event.get(controller, ("", 0))
        if instance != told[0]:
            self._last_event[controller] = told  # what was before that adapter was met first concerns nobody
        elif last < told[1]:
            self._spawn_fill(controller, last)

    def _take_event(self, sample: Sample) -> None:
        try:
            event = Event.model_validate_json(sample.payload)
        except ValidationError as error:
            self._log.warning(f"an event that can not be read on {sample.key}: {error.errors()[0]['msg']}")
            return
        self._heard_ns[event.controller] = self._clock.now_ns()
        instance, last = self._last_event.get(event.controller, ("", 0))
        if instance == event.instance and event.seq <= last:
            return
        if instance == event.instance and event.seq > last + 1:
            self._spawn_fill(event.controller, last)
            return
        self._deliver(event)

    def _deliver(self, event: Event) -> None:
        self._last_event[event.controller] = (event.instance, event.seq)
        for listener in list(self._listeners):
            listener(event)

    def _spawn_fill(self, controller: str, after: int) -> None:
        task = asyncio.get_running_loop().create_task(self._fill(controller, after))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _fill(self, controller: str, after: int) -> None:
        """Ask for the events that were missed; the one that showed the gap is among them."""
        try:
            payload = await self._bus.request(
                self._keys.event(controller), EventsRequest(after=after).to_json(), timeout_s=1.0
            )
        except BusError as error:
            self._log.warning(f"events after {after} of {controller} are missing: {error}", controller=controller)
            self._awaited.pop(controller, None)  # the next state has them asked for again
            return
        reply = EventsReply.model_validate_json(payload)
        if reply.lost:
            self._log.warning(f"{reply.lost} events of {controller} are lost for ever", controller=controller)
        for event in reply.events:
            if (event.instance, event.seq) > self._last_event.get(controller, ("", 0)) or (
                event.instance != self._last_event.get(controller, ("", 0))[0]
            ):
                self._deliver(event)
