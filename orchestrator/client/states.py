"""States of controllers as they come, for one consumer that may be slower than they are."""

import asyncio
from collections import Counter, deque
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from pydantic import ValidationError

from orchestrator.bus.base import BusDeclaration, BusSample
from orchestrator.client.fleet import FleetRequests
from orchestrator.clock.utc import format_utc_ns, parse_utc_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.names import split_name
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.state import AxisState, ClockQuality, ControllerState, Mode, TimeInterval

MAX_WAITING_STATES = 100  # of a controller; a consumer that is further behind goes on with the newest
OLDEST_S = 1.0
"""Of a state that a jog goes on with; adapters publish ten or more a second while they move."""


@dataclass(frozen=True, slots=True)
class StateReading:
    """A state of one controller, with those of its axes that were asked for.

    axes: by `controller.axis`. read: the interval of fleet time, ns, in which their positions were sampled; None while
    it is not known: the controller is offline, or has no fleet time. utc: of the middle of `read` by the clock of its
    computer, RFC 3339; without `read`, of the publication. clock: how well the controller's clock is known. missed:
    states of this controller between the one before and this one, which came while too many waited to be taken, or were
    lost on the way.
    """

    controller: str
    mode: Mode
    axes: Mapping[str, AxisState]
    read: TimeInterval | None
    utc: str
    clock: ClockQuality | None
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
        return StateReading(name, state.mode, axes, interval, utc, state.clock, missed_count)


class VirtualFeed:
    """The states of the groups of virtual axes that a connection jogs. states: by group."""

    def __init__(self, connection: FleetRequests) -> None:
        self.states: dict[str, VirtualState] = {}
        self._connection = connection
        self._subscriptions: dict[str, BusDeclaration] = {}
        self._arrived_s: dict[str, float] = {}

    async def follow(self, axes: Collection[str]) -> bool:
        """Follow the states of the groups of `axes`; whether these are virtual. Raises `Refusal`, also for virtual axes
        together with real ones, and for a make that cannot change the speed of a jog."""
        groups = dict.fromkeys(split_name(axis)[0] for axis in axes)
        if all(group in self.states for group in groups):
            return True
        states = await self._connection.virtual_states()
        virtual_groups = [group for group in groups if group in states]
        if not virtual_groups:
            return False
        if len(virtual_groups) < len(groups):
            raise Refusal(
                "mixed", f"{', '.join(axes)}: virtual and real axes cannot be jogged together", "jog one kind"
            )
        for group in groups:
            if any(jog.is_common for jog in states[group].jogs.values()):
                await self._require_ramps(states[group])
        for group in groups:
            if group not in self._subscriptions:
                self._store(states[group])
                key = self._connection.keys.virtual(group)
                self._subscriptions[group] = await self._connection.bus.subscribe(key, self._receive)
        return True

    async def close(self) -> None:
        """End the subscriptions."""
        subscriptions, self._subscriptions = self._subscriptions, {}
        self.states.clear()
        for subscription in subscriptions.values():
            await subscription.undeclare()

    def require_fresh(self, axes: Collection[str]) -> None:
        """Raise `Refusal` if a state of the groups of `axes` is too old to jog by it."""
        oldest_s = asyncio.get_running_loop().time() - OLDEST_S
        for group in dict.fromkeys(split_name(axis)[0] for axis in axes):
            if self._arrived_s[group] < oldest_s:
                text = f"{group}: the coordinator publishes no state of it, so that its limits are not known"
                raise Refusal("no-state", text, "see `tutti status`")

    async def _require_ramps(self, state: VirtualState) -> None:
        for controller in dict.fromkeys(split_name(axis)[0] for axis in state.of):
            info = await self._connection.controller_info(controller)
            if not info.jog_ramps:
                raise Refusal(
                    "no-jog",
                    f"{controller} ({info.make}) changes the speed of a jog only at rest, so that the axes of "
                    f"{state.group} would leave their positions",
                    f"move them, or jog {', '.join(state.of)}",
                    controller,
                )

    def _receive(self, sample: BusSample) -> None:
        with suppress(ValidationError):  # not of a coordinator
            self._store(VirtualState.read_message(sample.payload))

    def _store(self, state: VirtualState) -> None:
        self.states[state.group] = state
        self._arrived_s[state.group] = asyncio.get_running_loop().time()
