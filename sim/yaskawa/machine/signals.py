"""Signals from outside: local inputs, the abort input, and limit switches."""

from typing import Protocol

from sim.yaskawa.language.context import CommandMachine
from sim.yaskawa.machine.events import AutomaticEvents
from sim.yaskawa.motion.codes import ABORT_INPUT_CODE, SELECTIVE_CODE

_LATCHES = {**{number: number - 1 for number in range(1, 5)}, **{number: number - 5 for number in range(9, 13)}}
"""For each input that latches a position: the number of the axis (SMC-2000: L7105)."""


class SignalMachine(CommandMachine, Protocol):
    """The machine as its input signals act on it."""

    @property
    def powered(self) -> bool: ...

    @property
    def events(self) -> AutomaticEvents: ...


class SignalInputs:
    """Reactions of one controller to its input signals."""

    def __init__(self, machine: SignalMachine) -> None:
        self._machine = machine

    def set_abort_input(self, *, active: bool) -> None:
        """Set the abort input: as `AB`, and no motion begins while it is active (D36)."""
        self._machine.advance_to_now()
        self._machine.motion.abort_input = active
        if active:
            self._machine.abort_motion(ABORT_INPUT_CODE, halt=True)
        self._machine.run_ready()

    def set_input(self, number: int, *, level: bool) -> None:
        """Change a local input: latches, interrupts, selective abort."""
        if not 1 <= number <= len(self._machine.environment.inputs):
            raise ValueError(f"input {number}: this controller has inputs 1 to {len(self._machine.environment.inputs)}")
        self._machine.advance_to_now()
        if self._machine.environment.inputs[number - 1] != level:
            self._machine.environment.inputs[number - 1] = level
            if self._machine.powered:
                self._input_changed(number, level=level)
        self._machine.run_ready()

    def _input_changed(self, number: int, *, level: bool) -> None:
        now = self._machine.current_sample()
        latch = _LATCHES.get(number, len(self._machine.letters))
        if latch < len(self._machine.letters) and level == (self._machine.polarity[2] > 0):
            axis = self._machine.motion.real[latch]
            if axis.latch_armed:
                self._machine.motion.independent.capture_latch(axis, now)
        if number > 4 and self._machine.polarity[3] and not level and number - 5 < len(self._machine.letters):
            self._machine.motion.freeze_motion(now, SELECTIVE_CODE, (self._machine.motion.real[number - 5],))
        self._machine.events.inputs_changed(number, level=level)

    def limits_changed(self) -> None:
        """Handle a change of limit switches: an axis that moves into one stops."""
        if self._machine.powered:
            self._machine.motion.check_limits(self._machine.timebase.next_sample())
