"""The state machine of CiA 402: what a statusword says, and what a controlword asks for."""

from enum import Enum


class State(Enum):
    """States of the power drive system, by the statusword's bits 0 to 3, 5 and 6."""

    NOT_READY = "not ready to switch on"
    DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    REACTION = "fault reaction active"
    FAULT = "fault"


def state_of(status: int) -> State:
    """The state that a statusword names."""
    low = status & 0x4F
    if low in (0x00, 0x40):
        return State.DISABLED if low else State.NOT_READY
    if low == 0x0F:
        return State.REACTION
    if low == 0x08:
        return State.FAULT
    return {0x21: State.READY, 0x23: State.SWITCHED_ON, 0x27: State.ENABLED, 0x07: State.QUICK_STOP}.get(
        status & 0x6F, State.NOT_READY
    )


# Bits of the statusword.
TARGET_REACHED = 1 << 10
INTERNAL_LIMIT = 1 << 11
ACKNOWLEDGED = 1 << 12
"""Profile position: the set-point is taken. Homing: attained."""
FOLLOWS = ACKNOWLEDGED
"""Interpolated and cyclic synchronous position: the drive follows."""
MODE_ERROR = 1 << 13
"""Profile position: following error. Homing: error."""

# Controlwords.
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE = 0x000F
FAULT_RESET = 0x0080
# Bits of the controlword in profile position mode; bit 4 starts a homing as well, and has interpolation go on.
NEW_SET_POINT = 1 << 4
FOLLOW = NEW_SET_POINT
AT_ONCE = 1 << 5
HALT = 1 << 8

NEXT = {
    State.DISABLED: SHUTDOWN,
    State.READY: SWITCH_ON,
    State.SWITCHED_ON: ENABLE,
    State.QUICK_STOP: DISABLE_VOLTAGE,
}
"""What leads from a state towards operation enabled."""
