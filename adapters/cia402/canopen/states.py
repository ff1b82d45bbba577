"""The state machine of CiA 402: states by statusword, and transitions by controlword."""

from enum import Enum


class DriveState(Enum):
    """States of the power drive system, by the statusword's bits 0 to 3, 5 and 6."""

    NOT_READY = "not ready to switch on"
    DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    REACTION = "fault reaction active"
    FAULT = "fault"


def drive_state_of(status: int) -> DriveState:
    """Return the state of a statusword."""
    low = status & 0x4F
    if low in (0x00, 0x40):
        return DriveState.DISABLED if low else DriveState.NOT_READY
    if low == 0x0F:
        return DriveState.REACTION
    if low == 0x08:
        return DriveState.FAULT
    return {
        0x21: DriveState.READY,
        0x23: DriveState.SWITCHED_ON,
        0x27: DriveState.ENABLED,
        0x07: DriveState.QUICK_STOP,
    }.get(status & 0x6F, DriveState.NOT_READY)


# Bits of the statusword.
TARGET_REACHED = 1 << 10
INTERNAL_LIMIT = 1 << 11
ACKNOWLEDGED = 1 << 12
"""Profile position: the set-point is accepted. Homing: attained."""
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
# Bits of the controlword in profile position mode; bit 4 also starts homing, and continues interpolation.
NEW_SET_POINT = 1 << 4
FOLLOW = NEW_SET_POINT
AT_ONCE = 1 << 5
HALT = 1 << 8

NEXT = {
    DriveState.DISABLED: SHUTDOWN,
    DriveState.READY: SWITCH_ON,
    DriveState.SWITCHED_ON: ENABLE,
    DriveState.QUICK_STOP: DISABLE_VOLTAGE,
}
"""The controlword from a state towards operation enabled."""
