"""States of controllers as they come, for one consumer that may be slower than they are."""

import asyncio
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydantic import ValidationError

from orchestrator.bus.base import BusSample
from orchestrator.clock.utc import format_utc_ns, parse_utc_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.state import AxisState, ControllerState, Mode, TimeInterval

MAX_WAITING_STATES = 100  # of a controller; a consumer that is further behind goes on with the newest


@dataclass(frozen=True, slots=True)
class StateReading:
    """A state of one controller, with those of its axes that were asked for.

    axes: by `controller.axis`. read: the interval of fleet time, ns, in which their positions were sampled; None while
    it is not known: the controller is offline, or has no fleet time. utc: of the middle of `read` by the clock of its
    computer, RFC 3339; without `read`, of the publication. missed: states of this controller between the one before and
    this one, which came while too many waited to be taken, or were lost on the way.
    """

    controller: str
    mode: Mode
    axes: Mapping[str, AxisState]
    read: TimeInterval | None
    utc: str
    missed: int


class StateStream:
    """The states of the controllers of `axes`, each once, in the order in which they come. It is filled by a
    subscription, and never waits for its consumer."""

    def __init__(self, axes: Sequence[str]) -> None:
        self._names = group_by_controller(axes)
        self._waiting: deque[ControllerState] = deque()
        self._counts = Counter[str]()
        self._last: dict[str, tuple[str, int]] = {}
        self._change_event = asyncio.Event()
        self._is_closed = False

    @property
    def controllers(self) -> list[str]:
        """The controllers of the axes."""
        return list(self._names)

    def receive_state(self, sample: BusSample) -> None:
        """Take a state as it was published."""
        try:
            self.add_state(ControllerState.read_message(sample.payload))
        except ValidationError:
            return  # not of an adapter

    def add_state(self, state: ControllerState) -> None:
        """Add a state for the consumer, unless it is of a controller that was not asked for."""
        name = state.controller
        if name not in self._names:
            return
        if self._counts[name] >= MAX_WAITING_STATES:
            self._waiting = deque(entry for entry in self._waiting if entry.controller != name)
            self._counts[name] = 0
        self._waiting.append(state)
        self._counts[name] += 1
        self._change_event.set()

    def close(self) -> None:
        """The connection ends: nothing comes any more."""
        self._is_closed = True
        self._change_event.set()

    async def take_next(self) -> StateReading:
        """Wait for the next state. Raises `Refusal`, code `closed`."""
        while True:
            while not self._waiting:
                if self._is_closed:
                    text = "the connection to the fleet was closed while its states were followed"
                    raise Refusal("closed", text, "leave the loop over the states before the connection is closed")
                self._change_event.clear()
                await self._change_event.wait()
            state = self._waiting.popleft()
            self._counts[state.controller] -= 1
            missed_count = self._count_missed(state)
            if missed_count is not None:
                return self._make_reading(state, missed_count)

    def _count_missed(self, state: ControllerState) -> int | None:
        """How many states came between the one before of this controller and this one; None: it has been taken."""
        instance, last_seq = self._last.get(state.controller, ("", 0))
        if instance == state.instance and state.seq <= last_seq:
            return None
        self._last[state.controller] = (state.instance, state.seq)
        if not instance:
            return 0
        # An adapter that was started again counts from 1.
        return state.seq - last_seq - 1 if instance == state.instance else max(0, state.seq - 1)

    def _make_reading(self, state: ControllerState, missed_count: int) -> StateReading:
        name, interval, utc = state.controller, state.read_within, state.utc
        if interval is not None and state.fleet_ns is not None:
            middle_ns = (interval.earliest_ns + interval.latest_ns) // 2
            utc = format_utc_ns(parse_utc_ns(utc) + middle_ns - state.fleet_ns)
        axes = {f"{name}.{axis}": state.axes[axis] for axis in self._names[name] if axis in state.axes}
        return StateReading(name, state.mode, axes, interval, utc, missed_count)
