"""The frames of an adapter host: its controllers' states in one stream, their events in another.

A state that has changed goes out at once where people or the coordinator wait for it (a mode, a flag, an input), and
gathered with those of the other controllers otherwise: the more there are, the longer, at most for the period of the
fastest poll. Where nothing changes, a frame every 0.4 s says so.

On the keys of its own a controller is published as well while some process subscribes to them.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from adapters.host.single_keys import SingleKeys
from adapters.host.state_changes import StateChange, find_change, has_new_reading
from orchestrator.bus.base import Bus, BusSample, Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.states.frame import FRAME_NS, KEY_FRAME_NS, FrameHeader, encode_entry, encode_frame
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, ClockTimer
from orchestrator.model.fleet import Controller
from orchestrator.model.state import ControllerState

AT_ONCE_NS = NS_PER_MS
"""For changes and events of controllers that change together: they go in one message."""
GATHER_NS = 2 * NS_PER_MS  # for each controller of the host
MAX_FRAME_BYTES = 1_000_000  # of payloads in one frame; the others go in the next one


@dataclass(slots=True)
class _Published:
    """A controller in the frames. framed: its state that was put into one last. seen: its state as it was offered last,
    at seen_ns. is_answered: another state was given out since."""

    framed: ControllerState
    seen: ControllerState
    seen_ns: int
    is_answered: bool = False


@dataclass(slots=True)
class _WaitingLines:
    """Lines that wait for the next frame."""

    names: list[str] = field(default_factory=list[str])
    payloads: list[bytes] = field(default_factory=list[bytes])

    def add_line(self, name: str, payload: bytes) -> None:
        self.names.append(name)
        self.payloads.append(payload)

    def take_lines(self) -> tuple[list[str], list[bytes]]:
        """Take the first ones, as many as go into one frame; at least one, if there is any."""
        count, size = 0, 0
        for payload in self.payloads:
            size += len(payload)
            if count and size > MAX_FRAME_BYTES:
                break
            count += 1
        first_lines = self.names[:count], self.payloads[:count]
        del self.names[:count], self.payloads[:count]
        return first_lines


@dataclass(frozen=True, slots=True)
class FrameSource:
    """The host of the frames. instance: of this start of it. fleet_ns: returns fleet time, where it is known."""

    name: str
    instance: str
    bus: Bus
    keys: FleetKeys
    clock: Clock
    fleet_ns: Callable[[], int | None]


class HostFrames:
    """Publishes for the controllers of a host: the `StateOutlet` of each."""

    def __init__(self, source: FrameSource, controllers: Mapping[str, Controller]) -> None:
        self._source, self._clock = source, source.clock
        self._singles = SingleKeys(source.bus, source.keys, source.clock, controllers)
        self._published: dict[str, _Published] = {}
        self._states, self._events = _WaitingLines(), _WaitingLines()
        self._gather_ns = find_gather_ns(controllers.values())
        self._number = 0
        self._framed_ns = self._keyed_ns = source.clock.now_ns()
        self._due_ns = 0
        self._timers: dict[str, ClockTimer] = {}
        self._is_urgent = False
        self._is_open = False

    async def start(self) -> None:
        """Publish from now on."""
        await self._singles.start()
        self._is_open = True
        self._schedule_frame(self._clock.now_ns() + FRAME_NS)
        if self._events.names:
            self._schedule_events()

    async def close(self) -> None:
        """Send what waits to be sent at once, and end it."""
        self.send_before_reply()
        self._is_open = False
        for timer in self._timers.values():
            timer.cancel()
        await self._singles.close()

    # What is published

    def offer_state(self, state: ControllerState) -> None:
        """Put a state into the next frame if it has changed in more than its instants."""
        controller, now_ns = state.controller, self._clock.now_ns()
        entry = self._published.get(controller)
        change = find_change(None if entry is None else entry.framed, state)
        if entry is not None and change is StateChange.NONE:
            has_news = entry.is_answered or not has_new_reading(entry.seen, state)
            change = StateChange.GRADUAL if has_news else change
        is_watched = self._singles.is_watched(controller)
        payload = state.to_json() if is_watched or change is not StateChange.NONE else b""
        if is_watched:
            self._put_single(controller, "state", payload)
        if entry is None or change is not StateChange.NONE:
            self._published[controller] = _Published(framed=state, seen=state, seen_ns=now_ns)
            self._states.add_line(f"{controller}/state", payload)
            self._is_urgent = self._is_urgent or change is StateChange.AT_ONCE
            wait_ns = AT_ONCE_NS if change is StateChange.AT_ONCE else self._framed_ns + self._gather_ns - now_ns
            self._schedule_frame(now_ns + max(wait_ns, AT_ONCE_NS))
        else:
            entry.seen, entry.seen_ns = state, now_ns

    def note_answer(self, controller: str) -> None:
        """A state was given out as an answer."""
        if (entry := self._published.get(controller)) is not None:
            entry.is_answered = True

    def put_event(self, controller: str, payload: bytes) -> None:
        """Put an event into the next frame of events."""
        if self._singles.is_watched(controller):
            self._put_single(controller, "event", payload, Priority.EVENT)
        self._events.add_line(f"{controller}/event", payload)
        self._schedule_events()

    def put_value(self, controller: str, leaf: str, payload: bytes) -> None:
        """Put what changes slowly into the next frame of states, whenever that is due."""
        if self._singles.is_watched(controller):
            self._put_single(controller, leaf, payload)
        self._states.add_line(f"{controller}/{leaf}", payload)

    def send_before_reply(self) -> None:
        """Send what waits to be sent at once: what a command has changed is published before it is answered, as if each
        controller published for itself."""
        if self._is_open and self._is_urgent:
            self._timers["states"].cancel()
            self._send_states()
        if "events" in self._timers:
            self._timers["events"].cancel()
            self._send_events()

    async def answer_states(self, _: BusSample) -> bytes:
        """All states as of the last frame."""
        names = [f"{controller}/state" for controller in self._published]
        payloads = [entry.framed.to_json() for entry in self._published.values()]
        return encode_frame(self._make_header(self._number, names, self._published, is_key=True), payloads)

    # Frames

    def _put_single(self, controller: str, leaf: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        self._source.bus.put(f"{self._source.keys.prefix}/ctl/{controller}/{leaf}", payload, priority)

    def _schedule_frame(self, at_ns: int) -> None:
        """Send the next frame at an instant, or earlier."""
        timer = self._timers.get("states")
        if not self._is_open or (timer is not None and self._due_ns <= at_ns):
            return
        if timer is not None:
            timer.cancel()
        self._due_ns = at_ns
        self._timers["states"] = self._clock.call_at_ns(at_ns, self._send_states)

    def _schedule_events(self) -> None:
        if self._is_open and "events" not in self._timers:
            at_ns = self._clock.now_ns() + AT_ONCE_NS
            self._timers["events"] = self._clock.call_at_ns(at_ns, self._send_events)

    def _send_events(self) -> None:
        del self._timers["events"]
        source = self._source
        while self._events.names:
            names, payloads = self._events.take_lines()
            header = self._make_header(0, names, {}, is_key=False)
            source.bus.put(source.keys.host_events(source.name), encode_frame(header, payloads), Priority.EVENT)

    def _send_states(self) -> None:
        del self._timers["states"]
        now_ns = self._clock.now_ns()
        self._framed_ns, self._is_urgent = now_ns, False
        self._schedule_frame(now_ns + FRAME_NS)  # first: whatever happens below, the next frame is due
        is_key = now_ns - self._keyed_ns >= KEY_FRAME_NS
        if is_key:
            self._keyed_ns = now_ns
            waiting_names = set(self._states.names)
            for controller, entry in self._published.items():
                if f"{controller}/state" not in waiting_names:
                    entry.framed = entry.seen
                    self._states.add_line(f"{controller}/state", entry.seen.to_json())
        source = self._source
        while True:
            names, payloads = self._states.take_lines()
            later_controllers = {name.partition("/")[0] for name in self._states.names}
            confirmed_states = {name: entry for name, entry in self._published.items() if name not in later_controllers}
            self._number += 1
            header = self._make_header(self._number, names, confirmed_states, is_key=is_key and not later_controllers)
            source.bus.put(source.keys.host_states(source.name), encode_frame(header, payloads), Priority.STATE)
            if not later_controllers:
                return

    def _make_header(
        self, number: int, names: list[str], confirmed_states: Mapping[str, _Published], *, is_key: bool
    ) -> FrameHeader:
        now_ns = self._clock.now_ns()
        return FrameHeader(
            host=self._source.name,
            instance=self._source.instance,
            number=number,
            key=is_key,
            utc=self._clock.utc(),
            fleet_ns=self._source.fleet_ns(),
            lines=names,
            states={
                name: encode_entry(entry.seen, entry.framed.seq, now_ns - entry.seen_ns)
                for name, entry in confirmed_states.items()
            },
        )


def find_gather_ns(controllers: Iterable[Controller]) -> int:
    """How long gradual changes are gathered, ns: the longer the more controllers there are, at most for the period of
    the fastest poll."""
    rates = [controller.state.moving_hz for controller in controllers]
    return min(GATHER_NS * len(rates), round(NS_PER_S / max(rates))) if rates else 0
