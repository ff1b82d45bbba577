"""The one move of a light controller: loaded, released for a tick of its clock, and followed by its own evidence."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import Protocol

from adapters.contract import HostInterval, LoadPlace, Lowered, MoveOutcome
from adapters.light.clock import TICK_NS
from adapters.light.lowering import LightLowered
from adapters.light.wire import UNLOAD, LightState, MoveState, exchange, load_request, release_request
from adapters.toolkit.host_start import moving_intervals, resting_intervals
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.clock.estimator import TickMapping
from orchestrator.link.base import Link
from orchestrator.model.errors import ControllerFault, Refusal

BRAKING_POLL_NS = 20 * NS_PER_MS
OVERDUE_NS = 3 * NS_PER_S


class LightDevice(Protocol):
    """The connected controller, as its mover sees it."""

    @property
    def link(self) -> Link:
        """Its link. Raises `LinkClosed`."""
        ...

    async def read_state(self) -> LightState:
        """Read its state, and its clock."""
        ...

    def clock_mapping(self) -> TickMapping | None:
        """The present estimate of its clock."""
        ...


@dataclass(slots=True)
class LightMove:
    """The loaded move."""

    number: int
    lowered: LightLowered
    t0_ns: int
    start_tick: int
    mapping: TickMapping


class LightMover:
    """A `SlotMover`."""

    def __init__(self, device: LightDevice, clock: Clock) -> None:
        self._device = device
        self._clock = clock
        self._move: LightMove | None = None
        self._moves = 0
        self._woken: asyncio.Future[None] | None = None

    async def load(
        self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None, place: LoadPlace
    ) -> Mapping[str, int]:
        """Load a move. Raises `Refusal`."""
        del place
        if not isinstance(lowered, LightLowered) or mapping is None:
            raise Refusal("not-lowered", "this move was lowered for another make", "lower it again")
        began_ns = self._clock.now_ns()
        self._moves += 1
        move = LightMove(self._moves, lowered, t0_ns, round(mapping.to_ticks(t0_ns)), mapping)
        if lowered.parts:
            await exchange(self._device.link, load_request(move.number, move.start_tick, lowered.parts))
        self._move = move
        return {"load": self._clock.now_ns() - began_ns}

    async def verify(self) -> None:
        """Check that the controller still holds the move. Raises `Refusal`."""
        move = self._require_move()
        if move.lowered.parts:
            state = await self._device.read_state()
            if (state.move, state.move_state) != (move.number, MoveState.LOADED):
                raise Refusal("not-armed", "the controller does not hold the move any more", "arm it again")

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Release the move. Raises `Refusal` (code `late`)."""
        del start_tolerance_ns
        move = self._require_move()
        advance_ticks = round(advance_ns / move.mapping.tick_ns)
        if move.lowered.parts:
            await exchange(self._device.link, release_request(move.number, advance_ticks))
        move.start_tick -= advance_ticks
        move.t0_ns -= advance_ns

    async def unload(self) -> None:
        """Unload the move; nothing starts."""
        self._move = None
        self.wake()
        await exchange(self._device.link, UNLOAD)

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes started. Raises `ControllerFault`."""
        move = self._require_move()
        start = HostInterval(move.t0_ns, move.t0_ns)
        if not move.lowered.parts:
            return moving_intervals(move.lowered.durations_s, start, move.t0_ns)
        bound_ns = move.mapping.bound_at_ns(move.t0_ns)
        await self._sleep_until(move.mapping.to_host_ns(move.start_tick) + bound_ns + round(move.mapping.tick_ns))
        state = await self._device.read_state()
        if state.move != move.number or state.move_state not in (MoveState.MOVING, MoveState.DONE, MoveState.STOPPED):
            raise ControllerFault("not-started", "the controller has not begun to move", "was it stopped, or reset?")
        if state.move_state is MoveState.STOPPED and state.end_tick < state.start_tick:
            raise ControllerFault("not-started", "it was stopped before its start", "")
        return moving_intervals(move.lowered.durations_s, self._to_interval(state.start_tick), move.t0_ns)

    async def wait_for_end(self) -> MoveOutcome:
        """Follow the move to its end."""
        move = self._require_move()
        resting = resting_intervals(move.lowered.durations_s, move.t0_ns)
        if not move.lowered.parts:
            return MoveOutcome("done", resting)
        longest_ns = ceil(max(move.lowered.durations_s.values()) * NS_PER_S)
        end_ns = move.t0_ns + longest_ns + move.mapping.bound_at_ns(move.t0_ns + longest_ns) + NS_PER_MS
        await self._sleep_until(end_ns)
        state = await self._device.read_state()
        while state.move_state is MoveState.MOVING or (state.move_state is MoveState.STOPPED and state.is_moving):
            if self._clock.now_ns() > end_ns + OVERDUE_NS:
                raise ControllerFault("overdue", "the move does not end", "stop it: `tutti stop`")
            await self._sleep_until(self._clock.now_ns() + BRAKING_POLL_NS)
            state = await self._device.read_state()
        self._move = None
        if state.move != move.number or state.move_state not in (MoveState.DONE, MoveState.STOPPED):
            raise ControllerFault("reset", "the controller has lost its move", "home it again")
        movers = [name for name, seconds in move.lowered.durations_s.items() if seconds]
        if state.move_state is MoveState.STOPPED:
            end = self._to_interval(state.end_tick)
            return MoveOutcome("stopped", {**resting, **dict.fromkeys(movers, end)}, "stopped on request")
        start = self._to_interval(state.start_tick)
        ppm = move.mapping.drift_ppm
        ends = {name: _later(start, move.lowered.durations_s[name], ppm) for name in movers}
        return MoveOutcome("done", {**resting, **ends})

    def wake(self) -> None:
        """Something has happened to the move: look at it now."""
        if self._woken is not None and not self._woken.done():
            self._woken.set_result(None)

    async def _sleep_until(self, at_ns: int) -> None:
        """Sleep until a host instant, or until the move is stopped."""
        self._woken = woken = asyncio.get_running_loop().create_future()
        timer = self._clock.call_at_ns(at_ns, self.wake)
        try:
            await woken
        finally:
            timer.cancel()

    def _to_interval(self, tick: int) -> HostInterval:
        mapping = self._device.clock_mapping()
        assert mapping is not None  # its state was read
        at_ns = mapping.to_host_ns(tick)
        bound_ns = mapping.bound_at_ns(at_ns)
        return HostInterval(at_ns - bound_ns, at_ns + bound_ns)

    def _require_move(self) -> LightMove:
        if self._move is None:
            raise Refusal("not-armed", "no move is loaded", "arm it first")
        return self._move


def _later(interval: HostInterval, seconds: float, ppm: float) -> HostInterval:
    """The interval so much later. ppm: by how much both clocks may drift apart meanwhile; a tick is added."""
    ns, margin_ns = round(seconds * NS_PER_S), ceil(seconds * ppm * 1e3 + TICK_NS)
    return HostInterval(interval.earliest_ns + ns - margin_ns, interval.latest_ns + ns + margin_ns)
