"""Inputs and outputs (SMC-4000: L390-L490, L561-L568)."""

from collections.abc import Callable

from sim.core.points import DelayedLevels, PointIsolation
from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.world import PhysicalEnvironment
from sim.yaskawa.io.modbus import POINTS, READ_COILS, READ_INPUTS, RemotePoints

BYTE = 8
_VOLTS_RANGE = 10.0
_VOLTS_STEP = 20.0 / (1 << 14)


class IoPoints:
    """Digital inputs and outputs by number, analog inputs.

    isolation: of the outputs.
    missing: outputs that have a number but no terminal."""

    def __init__(
        self,
        environment: PhysicalEnvironment,
        outputs: int,
        isolation: PointIsolation,
        *,
        remote: RemotePoints | None,
        missing: frozenset[int] = frozenset(),
    ) -> None:
        self.environment = environment
        self.outputs = 0
        self.listeners: list[Callable[[int, bool], None]] = []
        """Called at every change at a terminal."""
        self.terminals = DelayedLevels(isolation, initial=False, changed=self._notify_listeners)
        self.count = outputs
        self._remote = remote
        self._real = sum(1 << number for number in range(outputs) if number + 1 not in missing)

    def input_byte(self, bank: int = 0) -> int:
        """`TI`: bit 0 is the bank's first input; 1 is high."""
        levels = self.environment.inputs[bank * BYTE : (bank + 1) * BYTE]
        return sum(1 << number for number, level in enumerate(levels) if level)

    def read_input(self, number: int) -> int:
        """`@IN[n]`."""
        if self._remote is not None and number >= POINTS:
            return self._remote.read_point(number, READ_INPUTS)
        if not 1 <= number <= len(self.environment.inputs):
            raise CommandError(56)
        return int(self.environment.inputs[number - 1])

    def read_output(self, number: int) -> int:
        """`@OUT[n]`."""
        if self._remote is not None and number >= POINTS:
            return self._remote.read_point(number, READ_COILS)
        if not 1 <= number <= self.count:
            raise CommandError(56)
        return self.outputs >> (number - 1) & 1

    def read_analog(self, number: int) -> int:
        """`@AN[n]`: volts, in steps of 14 bits over +/-10 V; without analog inputs on board always 0 (D72)."""
        if self._remote is not None and number >= POINTS:
            return self._remote.read_volts(number)
        analog = self.environment.analog
        if not analog:
            return 0
        if not 1 <= number <= len(analog):
            raise CommandError(56)
        volts = max(min(analog[number - 1], _VOLTS_RANGE - _VOLTS_STEP), -_VOLTS_RANGE)
        return fixed.from_real(round(volts / _VOLTS_STEP) * _VOLTS_STEP)

    def set_output(self, number: int, *, level: bool) -> None:
        """`SB`, `CB`, `OB`."""
        if self._remote is not None and number >= POINTS:
            self._remote.write_point(number, level=level)
            return
        if not 1 <= number <= self.count:
            raise CommandError(6)
        bit = 1 << (number - 1)
        self.set_all(self.outputs | bit if level else self.outputs & ~bit)

    def set_all(self, outputs: int) -> None:
        """`OP`: set all outputs."""
        outputs &= self._real
        changes, self.outputs = self.outputs ^ outputs, outputs
        for number in range(self.count):
            if changes >> number & 1:
                self.terminals.change_level(number + 1, level=bool(outputs >> number & 1))

    def _notify_listeners(self, number: int, *, level: bool) -> None:
        for listener in self.listeners:
            listener(number, level)

    def set_analog(self, number: int, volts: float) -> None:
        """`AO`: only remote devices have analog outputs (L2669)."""
        if self._remote is None or number < POINTS:
            raise CommandError(126)
        self._remote.write_volts(number, volts)
