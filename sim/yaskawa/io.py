"""Inputs and outputs (L390-L490, L561-L568)."""

from collections.abc import Callable

from sim.yaskawa.errors import CommandError
from sim.yaskawa.world import World

POINTS = 8
MODBUS = 1000
"""Numbers from here on are points of Modbus devices (L1863)."""


class Points:
    """Eight inputs and eight outputs; Modbus points have no device behind them here."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.outputs = 0
        self.listeners: list[Callable[[int, bool], None]] = []

    def input_byte(self) -> int:
        """`TI`: bit 0 is input 1; 1 is high."""
        return sum(1 << number for number, level in enumerate(self.world.inputs) if level)

    def read_input(self, number: int) -> int:
        """`@IN[n]`."""
        if number >= MODBUS:
            raise CommandError(126)
        if not 1 <= number <= POINTS:
            raise CommandError(56)
        return int(self.world.inputs[number - 1])

    def read_output(self, number: int) -> int:
        """`@OUT[n]`."""
        if number >= MODBUS:
            raise CommandError(126)
        if not 1 <= number <= POINTS:
            raise CommandError(56)
        return self.outputs >> (number - 1) & 1

    def read_analog(self, number: int) -> int:
        """`@AN[n]`: there is no analog input on board (D72)."""
        return 0

    def set_output(self, number: int, level: bool) -> None:
        """`SB`, `CB`, `OB`."""
        if number >= MODBUS:
            raise CommandError(126)
        if not 1 <= number <= POINTS:
            raise CommandError(6)
        bit = 1 << (number - 1)
        self.set_all(self.outputs | bit if level else self.outputs & ~bit)

    def set_all(self, outputs: int) -> None:
        """`OP`: tells the listeners about every output that changes."""
        changed, self.outputs = self.outputs ^ outputs, outputs
        for number in range(POINTS):
            if changed >> number & 1:
                for listener in self.listeners:
                    listener(number + 1, bool(outputs >> number & 1))
