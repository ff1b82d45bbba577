"""The state machine of the power drive system (CiA 402-2, table 30 and following): controlword in, statusword out."""

from collections.abc import Callable
from enum import Enum
from typing import Literal

Command = Literal["disable voltage", "quick stop", "shutdown", "switch on", "enable operation"]
Leave = Literal["at once", "slow down", "quick stop"]

FAULT_RESET = 0x80


class State(Enum):
    """With the bits 0-3, 5 and 6 of the statusword."""

    NOT_READY = 0x00
    DISABLED = 0x40
    READY = 0x21
    ON = 0x23
    ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


POWERED = (State.ENABLED, State.QUICK_STOP, State.FAULT_REACTION)
"""States in which the motor is held."""

_WITHOUT_MOTION: dict[tuple[State, Command], State] = {
    (State.DISABLED, "shutdown"): State.READY,
    (State.READY, "switch on"): State.ON,
    (State.READY, "enable operation"): State.ENABLED,
    (State.READY, "disable voltage"): State.DISABLED,
    (State.READY, "quick stop"): State.DISABLED,
    (State.ON, "enable operation"): State.ENABLED,
    (State.ON, "shutdown"): State.READY,
    (State.ON, "disable voltage"): State.DISABLED,
    (State.ON, "quick stop"): State.DISABLED,
    (State.ENABLED, "disable voltage"): State.DISABLED,
    (State.QUICK_STOP, "disable voltage"): State.DISABLED,
}


def command(word: int) -> Command:
    """What bits 0-3 of a controlword order."""
    if not word & 2:
        return "disable voltage"
    if not word & 4:
        return "quick stop"
    if not word & 1:
        return "shutdown"
    return "enable operation" if word & 8 else "switch on"


class PowerStates:
    """option: value of an option code object. stop: bring the motor to rest in the way given, then call back.
    changed: the state is another one; gets the one before.
    """

    def __init__(
        self,
        option: Callable[[int], int],
        stop: Callable[[Leave, Callable[[], None]], None],
        changed: Callable[[State], None],
        voltage: Callable[[], bool],
    ) -> None:
        self.state = State.NOT_READY
        self._option = option
        self._stop = stop
        self._changed = changed
        self._voltage = voltage
        self._leaving: State | None = None
        self._resetting = False

    def enter(self, state: State) -> None:
        self._leaving = None
        if state is not self.state:
            before, self.state = self.state, state
            self._changed(before)

    def order(self, word: int) -> None:
        """A controlword."""
        reset, self._resetting = bool(word & FAULT_RESET) and not self._resetting, bool(word & FAULT_RESET)
        state, wanted = self.state, command(word)
        if state is State.FAULT:
            if reset:
                self.enter(State.DISABLED)
            return
        if wanted in ("shutdown", "switch on", "enable operation") and not self._voltage():
            return
        after = _WITHOUT_MOTION.get((state, wanted))
        if after is not None:
            self.enter(after)
        elif state is State.ENABLED:
            self._leave_enabled(wanted)
        elif state is State.QUICK_STOP and wanted == "enable operation" and self._option(0x605A) in (5, 6):
            self.enter(State.ENABLED)

    def _leave_enabled(self, wanted: Command) -> None:
        if wanted == "quick stop":
            self.quick_stop()
        elif wanted == "enable operation":
            self._leaving = None
        elif self._leaving is None:
            index, target = (0x605B, State.READY) if wanted == "shutdown" else (0x605C, State.ON)
            self._leaving = target
            self._stop("slow down" if self._option(index) == 1 else "at once", self._left)

    def _left(self) -> None:
        if self._leaving is not None:
            self.enter(self._leaving)

    def quick_stop(self) -> None:
        """Transition 11."""
        code = self._option(0x605A)
        if code == 0:
            self.enter(State.DISABLED)
            return
        self.enter(State.QUICK_STOP)
        self._stop("slow down" if code in (1, 5) else "quick stop", self._quickly_stopped)

    def _quickly_stopped(self) -> None:
        if self.state is State.QUICK_STOP and self._option(0x605A) not in (5, 6):
            self.enter(State.DISABLED)

    def fault(self) -> None:
        """Transition 13."""
        if self.state in (State.FAULT, State.FAULT_REACTION):
            return
        powered = self.state in POWERED
        self.enter(State.FAULT_REACTION)
        code = self._option(0x605E)
        if not powered or code == 0:
            self._faulted()
        else:
            self._stop("slow down" if code == 1 else "quick stop", self._faulted)

    def _faulted(self) -> None:
        if self.state is State.FAULT_REACTION:
            self.enter(State.FAULT)

    def lose_voltage(self) -> None:
        """The power stage has no voltage any more."""
        if self.state not in (State.NOT_READY, State.FAULT, State.FAULT_REACTION):
            self.enter(State.DISABLED)
