"""A step's part while it is loaded or in progress."""

from dataclasses import dataclass

from adapters.contract import HostInterval, TimedWrite
from adapters.ppsmc.batches import PendingBatch
from adapters.ppsmc.lowering import PpSmcLowered
from adapters.ppsmc.output import PpSmcOutput
from adapters.toolkit.driven_output import DrivenOutput


@dataclass(slots=True)
class LoadedMove:
    """A loaded move.

    output: the output that it switches.
    ignore_limits: whether a switch is active that it does not move towards; None: not known yet.
    released: True from `go` on, with a timed write or a waiting program.
    pending: the expected answers after the timed write.
    started: interval of the start, when known."""

    lowered: PpSmcLowered
    t0_ns: int
    output: DrivenOutput[PpSmcOutput] | None = None
    ignore_limits: bool | None = None
    released: bool = False
    order: TimedWrite | None = None
    pending: PendingBatch | None = None
    started: HostInterval | None = None
    stopped_ns: int | None = None
    cancelled: bool = False

    @property
    def start(self) -> HostInterval:
        """The interval of the start, known once `started` is set."""
        if self.started is None:
            raise RuntimeError("the move has not started")
        return self.started

    @property
    def motor_numbers(self) -> set[int]:
        return {move.motor for move in self.lowered.moves}

    @property
    def waits_for_input(self) -> bool:
        """Whether an input starts it."""
        return self.lowered.wait is not None and bool(self.lowered.moves)

    @property
    def start_command(self) -> str:
        if self.lowered.by_program:
            return "start:"
        return "tbg:iel" if self.ignore_limits else "tbg"
