"""The input that ends a probe, as the coordinator sees it in the states of its controller."""

import asyncio

from orchestrator.bus.base import BusError
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.leadership.leadership import Leadership
from orchestrator.model.errors import Refusal
from orchestrator.model.names import split_name
from orchestrator.model.state import INPUT_S, ControllerState, TimeInterval
from orchestrator.model.steps.probe import Probe


class InputWatch:
    """Looks at the input of a probe with each state of its controller that arrives, until it is closed.

    watch_s: for how long it may be unread while axes move. shows_moving: its controller shows it also while it moves
    itself. contact: when it changed, fleet time; None: it has not.
    released: it has changed back since. woken: set with each state that matters.
    """

    def __init__(
        self, fleet: FleetAccess, leadership: Leadership, step: Probe, watch_s: float, *, shows_moving: bool
    ) -> None:
        self.watch_s = watch_s
        self.contact: TimeInterval | None = None
        self.released = False
        self.woken = asyncio.Event()
        self._view = fleet.view
        self._leadership = leadership
        self._step = step
        self._controller, self._input = split_name(step.until)
        self._shows_moving = shows_moving
        self._read_ns = self._passive_ns = 0
        self._loss = ""
        self.close = self._view.add_state_listener(self._take_state, [self._controller])

    async def require_passive(self) -> None:
        """Raise `Refusal` unless the input is read, and is not yet what ends the probe."""
        try:
            state = await self._view.query_state(self._controller)
        except BusError as error:
            raise self._view.make_absence(self._controller, str(error)) from None
        if state.mode == "offline":
            raise self._view.make_absence(self._controller, "it is offline")
        if state.read_within is None:
            text = f"{self._step.until} was read at no known instant"
            raise Refusal("no-scale", text, "wait until its adapter has fleet time", self._controller)
        if self._loss:
            raise Refusal("probe-broken", self._loss, "wait until it rests", self._controller)
        if self.contact is not None:
            opposite = "passive" if self._step.level == "active" else "active"
            text = f"{self._step.until} is {self._step.level} already"
            raise Refusal("line-level", text, f"make it {opposite} before the step", self._controller)

    def find_loss(self, moving_since_ns: int) -> str:
        """Why nothing is known of the input any more; empty: it is read. moving_since_ns: since when axes move."""
        unread_ns = self._leadership.fleet_now_ns() - max(self._read_ns, moving_since_ns)
        if not self._loss and unread_ns >= round(self.watch_s * NS_PER_S):
            self._loss = f"{self._step.until} was not read for {self.watch_s:.3g} s"
        return self._loss

    def find_unread_s(self, moving_since_ns: int) -> float:
        """How long it may still be unread from now on, s."""
        unread_ns = self._leadership.fleet_now_ns() - max(self._read_ns, moving_since_ns)
        return max(0.0, self.watch_s - unread_ns / NS_PER_S)

    async def wait_for_reading(self) -> None:
        """Wait for a reading that begins from now on, as long as one may take: a contact at the end of the way is in
        that, and whether one was lost again."""
        since_ns = self._leadership.fleet_now_ns()
        while self._read_ns < since_ns and not self.find_loss(since_ns):
            self.woken.clear()
            try:
                async with asyncio.timeout(self.find_unread_s(since_ns)):
                    await self.woken.wait()
            except TimeoutError:
                continue

    def _take_state(self, state: ControllerState) -> None:
        level = state.inputs.get(self._input)
        if state.mode == "offline" or level is None:
            self._loss = self._loss or f"{self._controller} is offline, and {self._step.until} is not read"
        elif not self._shows_moving and (state.mode != "idle" or any(axis.moving for axis in state.axes.values())):
            self._loss = self._loss or f"{self._controller} moves, and does not show {self._step.until} meanwhile"
        elif state.read_within is not None:
            self._read_ns = max(self._read_ns, state.read_within.earliest_ns)
            self._take_level(is_contact=level == (self._step.level == "active"))
        self.woken.set()

    def _take_level(self, *, is_contact: bool) -> None:
        if self.contact is not None:
            self.released = self.released or not is_contact
        elif is_contact:
            # An input may be read behind the positions of its reading, at the latest when that arrives.
            earliest_ns = self._passive_ns - round(INPUT_S * NS_PER_S)
            self.contact = TimeInterval(earliest_ns=earliest_ns, latest_ns=self._leadership.fleet_now_ns())
        else:
            self._passive_ns = self._read_ns
