"""Signals from outside: local inputs, the abort input, and limit switches."""

from typing import Protocol

from orchestrator.clock.base import NS_PER_US
from sim.core.points import DelayedLevels, PointIsolation
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
        clock, options = machine.timebase.clock, machine.options
        self._inputs = DelayedLevels(
            PointIsolation(clock, options.input_rise_us * NS_PER_US, options.input_fall_us * NS_PER_US),
            initial=True,
            changed=self._change_input,
        )
        self._latches = DelayedLevels(
            PointIsolation(clock, fall_ns=options.latch_us * NS_PER_US), initial=True, changed=self._change_latch
        )

    def set_abort_input(self, *, active: bool) -> None:
        """Set the abort input: as `AB`, and no motion begins while it is active (D36)."""
        self._machine.advance_to_now()
        self._machine.motion.abort_input = active
        if active:
            self._machine.abort_motion(ABORT_INPUT_CODE, halt=True)
        self._machine.run_ready()

    def set_input(self, number: int, *, level: bool) -> None:
        """Change the terminal of a local input: latches, interrupts, selective abort."""
        if not 1 <= number <= len(self._machine.environment.inputs):
            raise ValueError(f"input {number}: this controller has inputs 1 to {len(self._machine.environment.inputs)}")
        self._latches.change_level(number, level=level)
        self._inputs.change_level(number, level=level)

    def _change_latch(self, number: int, *, level: bool) -> None:
        """Capture by a falling input, which passes by the optocoupler's delay (L413, L3645)."""
        if level or not self._machine.powered or self._machine.polarity[2] > 0:
            return
        self._machine.advance_to_now()
        self._capture_position(number)
        self._machine.run_ready()

    def _change_input(self, number: int, *, level: bool) -> None:
        self._machine.advance_to_now()
        self._machine.environment.inputs[number - 1] = level
        if self._machine.powered:
            if level and self._machine.polarity[2] > 0:
                self._capture_position(number)
            self._react_to_input(number, level=level)
        self._machine.run_ready()

    def _capture_position(self, number: int) -> None:
        """Capture the position of the axis of a latch input, between samples."""
        latch = _LATCHES.get(number, len(self._machine.letters))
        if latch < len(self._machine.letters):
            axis = self._machine.motion.real[latch]
            if axis.latch_armed:
                self._machine.motion.independent.capture_latch(axis, self._machine.timebase.current_instant())

    def _react_to_input(self, number: int, *, level: bool) -> None:
        sample_now = self._machine.current_sample()
        if number > 4 and self._machine.polarity[3] and not level and number - 5 < len(self._machine.letters):
            self._machine.motion.freeze_motion(sample_now, SELECTIVE_CODE, (self._machine.motion.real[number - 5],))
        self._machine.events.inputs_changed(number, level=level)

    def limits_changed(self) -> None:
        """Handle a change of limit switches: an axis that moves into one stops."""
        if self._machine.powered:
            self._machine.motion.check_limits(self._machine.timebase.next_sample())
