"""What a light controller does with requests: one move, and the search for the reference."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from struct import Struct

from orchestrator.clock.base import Clock
from sim.core.controller import CommandedMotion
from sim.core.devicetime import DeviceTime
from sim.core.oscillator import Oscillator
from sim.light.axis import LightAxis
from sim.light.wire import (
    AXIS,
    ENABLE,
    HOME,
    LEG,
    LOAD,
    LOAD_AXIS,
    RELEASE,
    STATE,
    STOP,
    AxisBit,
    MoveState,
    Status,
)

NS_PER_TICK = 1000
_NOW = Struct("<cBQ")
VERSION = b"tutti light 1"


@dataclass(slots=True)
class LoadedMove:
    """A move that is loaded. legs: by axis, with its target and the ramp of a stop."""

    number: int
    start_tick: int
    legs: dict[int, tuple[float, list[tuple[float, float]], float]]
    state: MoveState = MoveState.LOADED
    end_tick: int = 0


class LightMachine:
    """Up to four axes, and their controller. Its crystal has a rate and an offset, and does not wander.

    motions: all that were commanded, in the order in which they were recorded."""

    def __init__(self, clock: Clock, axes: Sequence[str], oscillator: Oscillator) -> None:
        self.time = DeviceTime(clock, Oscillator(oscillator.offset_ns, oscillator.drift_ppm))
        self.motions: list[CommandedMotion] = []
        self.axes = [LightAxis(self.time, name, self.motions) for name in axes]
        self._move: LoadedMove | None = None
        self._homing: list[LightAxis] = []
        self._at_rest: bytes | None = None
        """What its state is but for the time, while nothing moves or will move."""
        self._power_ups = 1
        self._on = True
        self._requests: dict[bytes, Callable[[bytes], Status]] = {
            b"L": self._load,
            b"G": self._release,
            b"U": self._unload,
            b"S": self._stop,
            b"E": self._enable,
            b"H": self._home,
        }

    # Requests

    def answer(self, request: bytes) -> bytes:
        """Return the reply to a request; none while its power is off."""
        letter = request[:1]
        if not self._on:
            return b""
        if letter == b"P":
            return self._state()
        if letter == b"I":
            return b"I\x00" + VERSION
        self._at_rest = None
        act = self._requests.get(letter)
        try:
            return letter + bytes([Status.UNKNOWN if act is None else act(request)])
        except struct.error:  # not as long as its request is
            return letter + bytes([Status.UNKNOWN])

    def _state(self) -> bytes:
        now_ns = self.time.now_ns()
        if self._at_rest is not None:
            return _NOW.pack(b"P", 0, now_ns // NS_PER_TICK) + self._at_rest
        self._follow(now_ns)
        move = self._move
        number, state, start, end = (
            (0, MoveState.EMPTY, 0, 0) if move is None else (move.number, move.state, move.start_tick, move.end_tick)
        )
        parts = [STATE.pack(b"P", 0, now_ns // NS_PER_TICK, self._power_ups, state, number, start, end)]
        for axis in self.axes:
            position, velocity = axis.find_state(now_ns)
            bits = AxisBit.MOVING * axis.is_moving(now_ns) | AxisBit.ENABLED * axis.enabled
            parts.append(AXIS.pack(round(position), velocity, bits))
        reply = b"".join(parts)
        if not self._homing and all(axis.is_idle for axis in self.axes):
            self._at_rest = reply[_NOW.size :]
        return reply

    def _follow(self, now_ns: int) -> None:
        """Bring the move, and the search for the reference, up to now."""
        if self._homing and all(axis.is_idle for axis in self._homing):
            for axis in self._homing:
                axis.set_position(0.0)
            self._homing = []
        move = self._move
        if move is None or move.state not in (MoveState.RELEASED, MoveState.MOVING):
            return
        if now_ns < move.start_tick * NS_PER_TICK:
            return
        axes = [self.axes[index] for index in move.legs]
        move.state = MoveState.MOVING
        if all(axis.is_idle for axis in axes):
            move.state = MoveState.DONE
            move.end_tick = max(axis.end_ns for axis in axes) // NS_PER_TICK

    def set_power(self, *, on: bool) -> None:
        """Switch the power: off, motion stops dead, and positions are lost."""
        self._on, self._at_rest = on, None
        if on:
            self._power_ups += 1
            return
        self._brake_all(dead=True)
        self._move = None
        for axis in self.axes:
            axis.find_state(self.time.now_ns())
            axis.set_position(0.0)

    @property
    def is_busy(self) -> bool:
        """Whether an axis moves, or will move."""
        self._follow(self.time.now_ns())
        return any(not axis.is_idle for axis in self.axes)

    def _load(self, request: bytes) -> Status:
        if self.is_busy:
            return Status.BUSY
        number, start_tick, count = LOAD.unpack_from(request)
        offset, legs = LOAD.size, dict[int, tuple[float, list[tuple[float, float]], float]]()
        for _ in range(count):
            index, begin, target, ramp, leg_count = LOAD_AXIS.unpack_from(request, offset)
            offset += LOAD_AXIS.size
            if index >= len(self.axes):
                return Status.UNKNOWN
            axis = self.axes[int(index)]
            if not axis.enabled:
                return Status.DISABLED
            if round(axis.find_state(self.time.now_ns())[0]) != begin:
                return Status.ELSEWHERE
            end = offset + leg_count * LEG.size
            legs[int(index)] = float(target), list(LEG.iter_unpack(request[offset:end])), ramp
            offset = end
        self._move = LoadedMove(number, start_tick, legs)
        return Status.DONE

    def _release(self, request: bytes) -> Status:
        number, advance = RELEASE.unpack(request)
        move = self._move
        if move is None or move.number != number or move.state is not MoveState.LOADED:
            return Status.EMPTY
        start_tick = move.start_tick - advance
        if self.time.now_ns() >= start_tick * NS_PER_TICK:
            return Status.LATE
        if any(not self.axes[index].enabled for index in move.legs):
            return Status.DISABLED
        move.start_tick, move.state = start_tick, MoveState.RELEASED
        for index, (target, legs, _) in move.legs.items():
            self.axes[index].start(start_tick * NS_PER_TICK, target, legs)
        return Status.DONE

    def _unload(self, request: bytes) -> Status:
        del request
        self._follow(self.time.now_ns())
        move = self._move
        if move is not None and move.state is MoveState.MOVING:
            return Status.BUSY
        if move is not None and move.state is MoveState.RELEASED:
            self._brake_all(dead=False)
        self._move = None
        return Status.DONE

    def _stop(self, request: bytes) -> Status:
        (is_dead,) = STOP.unpack(request)
        self._brake_all(dead=bool(is_dead))
        return Status.DONE

    def _brake_all(self, *, dead: bool) -> None:
        now_ns = self.time.now_ns()
        self._follow(now_ns)
        move, self._homing = self._move, []
        ramps = {} if move is None else {index: ramp for index, (_, _, ramp) in move.legs.items()}
        for index, axis in enumerate(self.axes):
            axis.brake(0.0 if dead else ramps.get(index, 0.0))
        if move is not None and move.state in (MoveState.RELEASED, MoveState.MOVING, MoveState.LOADED):
            move.end_tick = max([now_ns, *(self.axes[index].end_ns for index in move.legs)]) // NS_PER_TICK
            if move.state is not MoveState.MOVING:
                move.end_tick = now_ns // NS_PER_TICK
            move.state = MoveState.STOPPED

    def _enable(self, request: bytes) -> Status:
        mask, is_on = ENABLE.unpack(request)
        self._follow(self.time.now_ns())
        for index, axis in enumerate(self.axes):
            if mask >> index & 1:
                if not is_on:
                    axis.brake(0.0)
                axis.enabled = bool(is_on)
        return Status.DONE

    def _home(self, request: bytes) -> Status:
        mask, speed, ramp = HOME.unpack(request)
        if self.is_busy:
            return Status.BUSY
        axes = [axis for index, axis in enumerate(self.axes) if mask >> index & 1]
        if any(not axis.enabled for axis in axes):
            return Status.DISABLED
        self._move, self._homing = None, axes
        now_ns = self.time.now_ns()
        for axis in axes:
            way = -axis.physical_position
            position, _ = axis.find_state(now_ns)
            axis.start(now_ns, position + way, make_trapezoid(way, speed, ramp))
        return Status.DONE


def make_trapezoid(way: float, speed: float, ramp: float) -> list[tuple[float, float]]:
    """Return the legs of a move from rest to rest: durations in s, accelerations in counts/s²."""
    if way == 0.0:
        return []
    sign, peak = (1 if way > 0 else -1), min(speed, (abs(way) * ramp) ** 0.5)
    ramp_s = peak / ramp
    return [(ramp_s, sign * ramp), (abs(way) / peak - ramp_s, 0.0), (ramp_s, -sign * ramp)]
