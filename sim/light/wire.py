"""Frames of the light controller, at its own side."""

from enum import IntEnum
from struct import Struct

STATE = Struct("<cBQIBIQQ")  # letter, status; tick, power-ups; state and number of the move, first and last tick of it
AXIS = Struct("<qdB")  # position (counts), velocity (counts/s), bits of `AxisBit`
LOAD = Struct("<xIQB")
LOAD_AXIS = Struct("<BqqdB")
LEG = Struct("<dd")
RELEASE = Struct("<xII")
STOP = Struct("<xB")
ENABLE = Struct("<xBB")
HOME = Struct("<xBdd")


class Status(IntEnum):
    """What a reply says of its request."""

    DONE = 0
    UNKNOWN = 1  # no such request, or no such axis
    BUSY = 2  # an axis moves, or a move is released
    ELSEWHERE = 3  # an axis is not where the move begins
    LATE = 4  # the start has passed
    EMPTY = 5  # no such move is loaded
    DISABLED = 6  # an axis is not enabled


class MoveState(IntEnum):
    """How far the last move has come."""

    EMPTY = 0
    LOADED = 1
    RELEASED = 2
    MOVING = 3
    DONE = 4
    STOPPED = 5


class AxisBit(IntEnum):
    """Bits of the state of an axis."""

    MOVING = 1
    ENABLED = 2
