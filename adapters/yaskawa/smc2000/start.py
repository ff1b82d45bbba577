"""A start on a serial line: in few exchanges, and all of it read back, for nothing else finds a garbled digit."""

from collections.abc import Mapping

from adapters.yaskawa.common.lowering import AxisMove, LoweredMoves, Records
from adapters.yaskawa.common.record import Record
from adapters.yaskawa.common.start import Start

CONTOUR_END = 51  # of SC (L11427-11493)


class SerialStart(Start):
    """The one move that the resident program can hold."""

    # Threads take turns command by command: a poll's comes before each of the two, and the last records are short.
    LATE_TICKS = 8

    def _registers(self, lowered: LoweredMoves) -> Mapping[str, Mapping[int, int]]:
        """The ends, too: PA reads as the place where the axis stands, but PR as the way to go (L10760, L10845)."""
        registers = super()._registers(lowered)
        if isinstance(lowered.load, Records):
            return registers
        return {**registers, "PR": {move.index: move.end - move.start for move in lowered.way}}

    def _reason(self, move: AxisMove, record: Record) -> tuple[str, str]:
        """A contour that ST has ended early, after the record that was executed, reads like one that was played."""
        axis = record.axes[move.index]
        if move.samples and axis.stop_code == CONTOUR_END and axis.commanded != move.end:
            return "stopped", f"stopped in the middle of its contour, at {axis.commanded} counts"
        return super()._reason(move, record)
