"""Recording of data into arrays at a fixed rate (`RA`, `RD`, `RC`; L9211-L9394)."""

from math import inf

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.context import CommandContext, CommandMachine, Evaluator


class DataRecorder:
    """Writes one element of each array every 2^n samples."""

    def __init__(self, machine: CommandMachine) -> None:
        self.machine = machine
        self.arrays: list[str] = []
        self.sources: list[Evaluator] = []
        self.index = 0
        self.running = False
        self.due: float = inf
        self._period = 0
        self._length = 0
        self._circular = False

    def start_recording(self, exponent: int, records: int | None, now: int) -> None:
        """`RC n,m`; n 0 stops."""
        if exponent == 0:
            self.stop_recording()
            return
        if self.running:
            raise CommandError(80)
        if not self.arrays or not self.sources:
            raise CommandError(81)
        sizes = [len(self.machine.data.get_array(name)) for name in self.arrays]
        length = min(sizes) if not records else abs(records)
        if length > min(sizes):
            raise CommandError(84)
        self._length, self._circular = length, records is not None and records < 0
        if records == -1:
            self._length = min(sizes)
        self._period, self.index, self.running = 1 << exponent, 0, True
        self.due = now

    def stop_recording(self) -> None:
        self.running = False
        self.due = inf

    def record_due(self, now: int) -> None:
        """Record the values that are due."""
        context = CommandContext(self.machine)
        while self.due <= now:
            for name, source in zip(self.arrays, self.sources, strict=False):
                array = self.machine.data.arrays.get(name)
                if array is not None and self.index < len(array):
                    array[self.index] = source(context)
            self.index += 1
            self.due += self._period
            if self.index >= self._length:
                self.index = 0
                if not self._circular:
                    self.stop_recording()
