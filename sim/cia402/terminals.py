"""Inputs, outputs and switches of a drive: objects 0x60FD and 0x60FE (CiA 402-2)."""

from collections.abc import Callable, Sequence

from sim.cia402.mover import PositionMark
from sim.cia402.options import DriveOptions
from sim.core.controller import LimitSwitch

POINTS = 8
_FIRST_BIT = 16
"""First bit of the inputs and outputs that are free for the user; the lower ones have a meaning in the profile."""
_NEGATIVE, _POSITIVE, _HOME, _INTERLOCK = 1, 2, 4, 8


class DriveTerminals:
    """Inputs and outputs 1-8 and the switches on the axis.

    changed: called when a value visible to clients has changed."""

    def __init__(self, options: DriveOptions, changed: Callable[[], None]) -> None:
        self._options = options
        self._changed = changed
        self._inputs = [False] * POINTS
        self._outputs = 0
        self._listeners: list[Callable[[int, bool], None]] = []
        self.forced: LimitSwitch | None = None
        """Switches pressed from outside, which replace those on the travel."""

    # Inputs

    def set_input(self, number: int, *, level: bool) -> None:
        if not 1 <= number <= POINTS:
            raise ValueError(f"no input {number}; there are 1-{POINTS}")
        self._inputs[number - 1] = level
        self._changed()

    def input_level(self, number: int) -> bool:
        return self._inputs[number - 1]

    def limit_states(self, position: float) -> tuple[bool, bool]:
        """Return whether the negative and the positive limit switch are active, at a mechanical position."""
        if self.forced is not None:
            return self.forced in ("reverse", "both"), self.forced in ("forward", "both")
        if self._options.travel is None:
            return False, False
        low, high = self._options.travel
        return position <= low, position >= high

    def home_state(self, position: float) -> bool:
        """Return whether the home switch is active."""
        if self._options.home_switch is None:
            return False
        low, high = self._options.home_switch
        return (low is None or position >= low) and (high is None or position <= high)

    def home_edges(self) -> Sequence[float]:
        """Return the mechanical positions of the home switch's ends."""
        return [position for position in self._options.home_switch or () if position is not None]

    def position_marks(self, limit: Callable[[int], None]) -> list[PositionMark]:
        """Return the positions that a motion may pass: the limit switches, which call `limit` with -1 or 1, and the
        home switch."""
        marks = [PositionMark(edge, sign, self._changed) for edge in self.home_edges() for sign in (-1, 1)]
        if self._options.travel is not None and self.forced is None:
            low, high = self._options.travel
            marks += [PositionMark(low, -1, lambda: limit(-1)), PositionMark(high, 1, lambda: limit(1))]
            marks += [PositionMark(low, 1, self._changed), PositionMark(high, -1, self._changed)]
        return marks

    def input_word(self, position: float) -> int:
        """Object 0x60FD."""
        negative, positive = self.limit_states(position)
        word = _NEGATIVE * negative | _POSITIVE * positive | _HOME * self.home_state(position)
        if self._options.enable_input is not None:
            word |= _INTERLOCK * (not self._inputs[self._options.enable_input - 1])
        return word | sum(level << _FIRST_BIT + number for number, level in enumerate(self._inputs))

    # Outputs

    def drive_outputs(self, wanted: int, mask: int) -> None:
        """Object 0x60FE: set the outputs in the mask to the wanted levels; the others keep theirs."""
        mask = mask >> _FIRST_BIT & (1 << POINTS) - 1
        outputs_after = self._outputs & ~mask | wanted >> _FIRST_BIT & mask
        old_outputs, self._outputs = self._outputs, outputs_after
        for number in range(POINTS):
            if (old_outputs ^ outputs_after) >> number & 1:
                for listener in self._listeners:
                    listener(number + 1, bool(outputs_after >> number & 1))

    def output_level(self, number: int) -> bool:
        if not 1 <= number <= POINTS:
            raise ValueError(f"no output {number}; there are 1-{POINTS}")
        return bool(self._outputs >> number - 1 & 1)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self._listeners.append(listener)
