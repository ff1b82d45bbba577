"""The status word as texts, with remedies (L519-L567)."""

from adapters.shrc203.wire.replies import AxisStatus
from orchestrator.model.state import FaultReport

SCALE_ERROR = 1 << 2
DISCONNECTED = 1 << 3
EMERGENCY = 1 << 5
UNSETTLED = 1 << 16  # out of the in-position range while BUSY (L551)
LOGICAL_RETURN = 1 << 17
MECHANICAL_RETURN = 1 << 18
CW_LIMIT = 1 << 19
CCW_LIMIT = 1 << 20
CW_SOFT = 1 << 21
CCW_SOFT = 1 << 22

_POWER = (
    "switch the controller off and on; if it returns, see the controller's manual, volume Preparation and Operation"
)
_RESET = "remove the cause, then `tutti reset`"

# Warnings count as faults here: a controller with a warning begins no further move before an operator has checked it.
_FAULTS: tuple[tuple[int, str, str, str], ...] = (
    (SCALE_ERROR, "scale-error", "scale error (S1)", "check the scale's cable, then switch the controller off and on"),
    (DISCONNECTED, "disconnected", "a cable of the stage is disconnected (S2)", "check the stage's cable; " + _POWER),
    (1 << 4, "overflow", "overflow error (S4)", _RESET),
    (EMERGENCY, "emergency-stop", "emergency stop", _RESET + ", and enable the axis again"),
    (1 << 6, "hunting", "hunting error (S3): the axis does not settle", _POWER),
    (1 << 7, "limit-error", "limit error (S5)", _RESET),
    (1 << 8, "counter-overflow", "counter overflow (S6): beyond 999,999,999 pulses", _POWER),
    (1 << 9, "auto-config", "the stage's automatic configuration failed", "check the stage's cable; " + _POWER),
    (
        1 << 10,
        "io-overload",
        "24 V overload at the input and output connector (W1)",
        "check the wiring of the connector",
    ),
    (
        1 << 11,
        "terminal-overload",
        "24 V overload at the terminal block (W2)",
        "check the wiring of the terminal block",
    ),
    (1 << 12, "system-error", "system error (S7)", _POWER),
    (1 << 13, "driver-warm", "the motor driver is hot (W3)", "let it cool down; check load and ventilation"),
    (1 << 14, "driver-overheat", "the motor driver has overheated (S10)", "let it cool down; " + _POWER),
    (1 << 15, "out-of-position", "out of its in-position range after positioning", "check load and settling"),
)
ERRORS = sum(bit for bit, *_ in _FAULTS if bit not in (1 << 10, 1 << 11, 1 << 13, 1 << 15))


def status_faults(axis: str, word: int) -> list[FaultReport]:
    """Return the faults that the status word of `axis` reports."""
    return [
        FaultReport(code=code, text=f"axis {axis}: {text}", remedy=remedy, axis=axis)
        for bit, code, text, remedy in _FAULTS
        if word & bit
    ]


def is_position_lost(word: int, *, excited: bool, closed_loop: bool) -> bool:
    """Return whether the coordinate may differ from the position of the stage: a motor without torque, or a failed
    scale, loses steps."""
    if word & DISCONNECTED:
        return True
    return bool(word & SCALE_ERROR) if closed_loop else not excited


def stop_reason(axis: str, now: AxisStatus) -> str:
    """Return why an axis is not at its target, as far as its status shows it; empty otherwise."""
    faults = status_faults(axis, now.word)
    if faults:
        return faults[0].text
    if now.word & (CW_LIMIT | CCW_LIMIT):
        return f"axis {axis} is on its {'CW' if now.word & CW_LIMIT else 'CCW'} limit sensor"
    if now.word & (CW_SOFT | CCW_SOFT):
        return f"axis {axis} was stopped by its {'CW' if now.word & CW_SOFT else 'CCW'} software limit"
    return ""
