"""Frames of the light controller, at the adapter's side: little-endian, one reply for each request."""

from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from typing import NamedTuple

from orchestrator.link.base import Link
from orchestrator.model.errors import LATE_REMEDY, ControllerFault, Refusal

IDENTITY = b"I"
POLL = b"P"
UNLOAD = b"U"
_STATE = Struct("<xxQIBIQQ")
_AXIS = Struct("<qdB")
_LOAD = Struct("<cIQB")
_LOAD_AXIS = Struct("<BqqdB")
_LEG = Struct("<dd")
_RELEASE = Struct("<cII")
_ENABLE = Struct("<cBB")
_HOME = Struct("<cBdd")
_STATE_BYTE = 14
_TICKS = slice(2, 10)
"""What differs between two states of a controller at rest."""

_REFUSALS = {
    2: ("busy", "a move is released or in progress", "disarm or stop it"),
    3: ("other-start", "an axis is not where the move begins", "plan again from the present position"),
    4: ("late", "the start has passed", LATE_REMEDY),
    5: ("not-armed", "no such move is loaded", "arm it first"),
    6: ("disabled", "an axis is not enabled", "enable it: `tutti axis enable`"),
}


class MoveState(IntEnum):
    """How far the controller's last move has come."""

    EMPTY = 0
    LOADED = 1
    RELEASED = 2
    MOVING = 3
    DONE = 4
    STOPPED = 5


_MOVE_STATES = tuple(MoveState)


@dataclass(frozen=True, slots=True)
class AxisPart:
    """One axis of a move. index: from 0. legs: duration (s of the controller's crystal) and acceleration of each."""

    index: int
    start_counts: int
    end_counts: int
    ramp: float
    legs: tuple[tuple[float, float], ...]


class LightState(NamedTuple):
    """The controller's state. sent_ns, received_ns: host instants around the reading. axes: position, velocity, and
    bits (1: moving, 2: enabled) of each. rest: the part of the reply that stays the same at rest."""

    sent_ns: int
    received_ns: int
    ticks: int
    power_ups: int
    move_state: MoveState
    move: int
    start_tick: int
    end_tick: int
    rest: bytes

    @property
    def axes(self) -> list[tuple[int, float, int]]:
        return list(_AXIS.iter_unpack(self.rest[_STATE.size - _TICKS.stop :]))

    @property
    def is_moving(self) -> bool:
        """Whether any axis moves."""
        return any(bits & 1 for _, _, bits in self.axes)


async def exchange(link: Link, request: bytes) -> tuple[int, int, bytes]:
    """Send a request; return when, when its reply came, and the reply. Raises `LinkClosed`, `ControllerFault`, and
    `Refusal` for a request that is refused."""
    sent_ns = link.write(request)
    data, received_ns = await link.read()
    if len(data) < 2 or data[:1] != request[:1]:
        raise ControllerFault("garbage", f"{data[:20]!r} answers {request[:1]!r}", "is it the right make?")
    if data[1]:
        refusal = _REFUSALS.get(data[1])
        if refusal is None:
            raise ControllerFault("garbage", f"it does not know {request[:1]!r}", "does it have as many axes?")
        raise Refusal(*refusal)
    return sent_ns, received_ns, data


async def read_state(link: Link) -> LightState:
    """Read the state."""
    sent_ns, received_ns, data = await exchange(link, POLL)
    if len(data) < _STATE.size or (len(data) - _STATE.size) % _AXIS.size or data[_STATE_BYTE] > MoveState.STOPPED:
        raise ControllerFault("garbage", f"{data[:40]!r} is no state", "is it the right make?")
    ticks, power_ups, state, move, start_tick, end_tick = _STATE.unpack_from(data)
    body = data[_TICKS.stop :]
    return LightState(sent_ns, received_ns, ticks, power_ups, _MOVE_STATES[state], move, start_tick, end_tick, body)


def load_request(move: int, start_tick: int, parts: tuple[AxisPart, ...]) -> bytes:
    """The request that loads a move."""
    data = [_LOAD.pack(b"L", move, start_tick, len(parts))]
    for part in parts:
        data.append(_LOAD_AXIS.pack(part.index, part.start_counts, part.end_counts, part.ramp, len(part.legs)))
        data += [_LEG.pack(*leg) for leg in part.legs]
    return b"".join(data)


def release_request(move: int, advance_ticks: int) -> bytes:
    """The request that releases a move, `advance_ticks` before the tick it was loaded for."""
    return _RELEASE.pack(b"G", move, advance_ticks)


def stop_request(*, abort: bool) -> bytes:
    """The request that stops everything."""
    return bytes([ord("S"), abort])


def enable_request(mask: int, *, on: bool) -> bytes:
    """The request that enables the axes of a mask, or disables them."""
    return _ENABLE.pack(b"E", mask, on)


def home_request(mask: int, speed: float, ramp: float) -> bytes:
    """The request that finds the reference of the axes of a mask, in counts/s and counts/s²."""
    return _HOME.pack(b"H", mask, speed, ramp)
