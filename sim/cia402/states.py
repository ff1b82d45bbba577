"""The state machine of the power drive system (CiA 402-2, table 30 and following): controlword in, statusword out."""

from collections.abc import Callable
from enum import Enum
from typing import Literal

Command = Literal["disable voltage", "quick stop", "shutdown", "switch on", "enable operation"]
Leave = Literal["at once", "slow down", "quick stop"]

FAULT_RESET = 0x80


class PowerState(Enum):
    """Power states, with the bits 0-3, 5 and 6 of the statusword."""

    NOT_READY = 0x00
    DISABLED = 0x40
    READY = 0x21
    ON = 0x23
    ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


POWERED = (PowerState.ENABLED, PowerState.QUICK_STOP, PowerState.FAULT_REACTION)
"""States in which the motor keeps torque."""

_WITHOUT_MOTION: dict[tuple[PowerState, Command], PowerState] = {
    (PowerState.DISABLED, "shutdown"): PowerState.READY,
    (PowerState.READY, "switch on"): PowerState.ON,
    (PowerState.READY, "enable operation"): PowerState.ENABLED,
    (PowerState.READY, "disable voltage"): PowerState.DISABLED,
    (PowerState.READY, "quick stop"): PowerState.DISABLED,
    (PowerState.ON, "enable operation"): PowerState.ENABLED,
    (PowerState.ON, "shutdown"): PowerState.READY,
    (PowerState.ON, "disable voltage"): PowerState.DISABLED,
    (PowerState.ON, "quick stop"): PowerState.DISABLED,
    (PowerState.ENABLED, "disable voltage"): PowerState.DISABLED,
    (PowerState.QUICK_STOP, "disable voltage"): PowerState.DISABLED,
}


def decode_command(word: int) -> Command:
    """Decode the command in bits 0-3 of a controlword."""
    if not word & 2:
        return "disable voltage"
    if not word & 4:
        return "quick stop"
    if not word & 1:
        return "shutdown"
    return "enable operation" if word & 8 else "switch on"


class PowerStates:
    """State machine of the power stage.

    option: returns the value of an option code object.
    stop: stops the motor in the given way, then calls back.
    changed: called after a change of state, with the previous one.
    """

    def __init__(
        self,
        option: Callable[[int], int],
        stop: Callable[[Leave, Callable[[], None]], None],
        changed: Callable[[PowerState], None],
        voltage: Callable[[], bool],
    ) -> None:
        self.state = PowerState.NOT_READY
        self._option = option
        self._stop = stop
        self._changed = changed
        self._voltage = voltage
        self._leaving: PowerState | None = None
        self._resetting = False

    def enter_state(self, state: PowerState) -> None:
        self._leaving = None
        if state is not self.state:
            state_before, self.state = self.state, state
            self._changed(state_before)

    def handle_controlword(self, word: int) -> None:
        """Process a controlword."""
        reset, self._resetting = bool(word & FAULT_RESET) and not self._resetting, bool(word & FAULT_RESET)
        state, command = self.state, decode_command(word)
        if state is PowerState.FAULT:
            if reset:
                self.enter_state(PowerState.DISABLED)
            return
        if command in ("shutdown", "switch on", "enable operation") and not self._voltage():
            return
        next_state = _WITHOUT_MOTION.get((state, command))
        if next_state is not None:
            self.enter_state(next_state)
        elif state is PowerState.ENABLED:
            self._leave_enabled(command)
        elif state is PowerState.QUICK_STOP and command == "enable operation" and self._stays_stopped:
            self.enter_state(PowerState.ENABLED)

    def _leave_enabled(self, wanted: Command) -> None:
        if wanted == "quick stop":
            self.quick_stop()
        elif wanted == "enable operation":
            self._leaving = None
        elif self._leaving is None:
            index, target = (0x605B, PowerState.READY) if wanted == "shutdown" else (0x605C, PowerState.ON)
            self._leaving = target
            self._stop("slow down" if self._option(index) == 1 else "at once", self._finish_leaving)

    def _finish_leaving(self) -> None:
        if self._leaving is not None:
            self.enter_state(self._leaving)

    def quick_stop(self) -> None:
        """Transition 11."""
        code = self._option(0x605A)
        if code == 0:
            self.enter_state(PowerState.DISABLED)
            return
        self.enter_state(PowerState.QUICK_STOP)
        self._stop("slow down" if code in (1, 5) else "quick stop", self._finish_quick_stop)

    def _finish_quick_stop(self) -> None:
        if self.state is PowerState.QUICK_STOP and not self._stays_stopped:
            self.enter_state(PowerState.DISABLED)

    @property
    def _stays_stopped(self) -> bool:
        """Whether a quick stop ends in quick stop active, and can be left by enabling (transition 16)."""
        return self._option(0x605A) in (5, 6, 7, 8)

    def enter_fault(self) -> None:
        """Transition 13."""
        if self.state in (PowerState.FAULT, PowerState.FAULT_REACTION):
            return
        is_powered = self.state in POWERED
        self.enter_state(PowerState.FAULT_REACTION)
        code = self._option(0x605E)
        if not is_powered or code == 0:
            self._finish_fault()
        else:
            self._stop("slow down" if code == 1 else "quick stop", self._finish_fault)

    def _finish_fault(self) -> None:
        if self.state is PowerState.FAULT_REACTION:
            self.enter_state(PowerState.FAULT)

    def lose_voltage(self) -> None:
        """Handle the loss of the power stage's voltage."""
        if self.state not in (PowerState.NOT_READY, PowerState.FAULT, PowerState.FAULT_REACTION):
            self.enter_state(PowerState.DISABLED)
