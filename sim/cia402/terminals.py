"""Inputs, outputs and switches of a drive: objects 0x60FD and 0x60FE (CiA 402-2)."""

from collections.abc import Callable, Sequence

from sim.cia402.mover import Mark
from sim.cia402.options import Options
from sim.core.controller import LimitSwitch

POINTS = 8
_FIRST_BIT = 16
"""Of the inputs and outputs that are free for the user; below are those with a meaning of the profile."""
_NEGATIVE, _POSITIVE, _HOME, _INTERLOCK = 1, 2, 4, 8


class Terminals:
    """Inputs and outputs 1-8 and the switches on the axis. changed: something that a client can see has changed."""

    def __init__(self, options: Options, changed: Callable[[], None]) -> None:
        self._options = options
        self._changed = changed
        self._inputs = [False] * POINTS
        self._outputs = 0
        self._listeners: list[Callable[[int, bool], None]] = []
        self.forced: LimitSwitch | None = None
        """Switches pressed from outside, in place of those on the way."""

    # Inputs

    def set_input(self, number: int, level: bool) -> None:
        if not 1 <= number <= POINTS:
            raise ValueError(f"no input {number}; there are 1-{POINTS}")
        self._inputs[number - 1] = level
        self._changed()

    def input(self, number: int) -> bool:
        return self._inputs[number - 1]

    def limits(self, position: float) -> tuple[bool, bool]:
        """Whether the negative and the positive limit switch are active, at a mechanical position."""
        if self.forced is not None:
            return self.forced in ("reverse", "both"), self.forced in ("forward", "both")
        if self._options.travel is None:
            return False, False
        low, high = self._options.travel
        return position <= low, position >= high

    def home(self, position: float) -> bool:
        """Whether the home switch is active."""
        if self._options.home_switch is None:
            return False
        low, high = self._options.home_switch
        return (low is None or position >= low) and (high is None or position <= high)

    def edges(self) -> Sequence[float]:
        """Mechanical positions of the home switch's ends."""
        return [each for each in self._options.home_switch or () if each is not None]

    def marks(self, limit: Callable[[int], None]) -> list[Mark]:
        """What a motion runs over: the limit switches, which call `limit` with -1 or 1, and the home switch."""
        found = [Mark(edge, sign, self._changed) for edge in self.edges() for sign in (-1, 1)]
        if self._options.travel is not None and self.forced is None:
            low, high = self._options.travel
            found += [Mark(low, -1, lambda: limit(-1)), Mark(high, 1, lambda: limit(1))]
            found += [Mark(low, 1, self._changed), Mark(high, -1, self._changed)]
        return found

    def word(self, position: float) -> int:
        """Object 0x60FD."""
        negative, positive = self.limits(position)
        word = _NEGATIVE * negative | _POSITIVE * positive | _HOME * self.home(position)
        if self._options.enable_input is not None:
            word |= _INTERLOCK * (not self._inputs[self._options.enable_input - 1])
        return word | sum(level << _FIRST_BIT + place for place, level in enumerate(self._inputs))

    # Outputs

    def drive_outputs(self, wanted: int, mask: int) -> None:
        """Object 0x60FE: the outputs in the mask follow the wanted levels, the others keep theirs."""
        mask = mask >> _FIRST_BIT & (1 << POINTS) - 1
        after = self._outputs & ~mask | wanted >> _FIRST_BIT & mask
        before, self._outputs = self._outputs, after
        for place in range(POINTS):
            if (before ^ after) >> place & 1:
                for listener in self._listeners:
                    listener(place + 1, bool(after >> place & 1))

    def output(self, number: int) -> bool:
        if not 1 <= number <= POINTS:
            raise ValueError(f"no output {number}; there are 1-{POINTS}")
        return bool(self._outputs >> number - 1 & 1)

    def on_output(self, listener: Callable[[int, bool], None]) -> None:
        self._listeners.append(listener)
