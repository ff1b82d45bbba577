"""A start on a serial line: few exchanges, all verified by reading back, because nothing else detects a garbled
digit."""

from collections.abc import Mapping

from adapters.yaskawa.common.ending import SampleEnd
from adapters.yaskawa.common.gate_start import GateStart
from adapters.yaskawa.common.loads import YaskawaAxisMove, YaskawaLowered
from adapters.yaskawa.common.start import SampleStart
from adapters.yaskawa.wire.record import DataRecord

CONTOUR_END = 51  # of SC (L11427-11493)


class SerialGateStart(GateStart):
    """The present move, verified with its ends."""

    def _verified_registers(self, lowered: YaskawaLowered) -> Mapping[str, Mapping[int, int]]:
        """Return the registers to read back, ends included: PA reads as the present position of the axis, but PR as the
        remaining distance (L10760, L10845)."""
        registers = super()._verified_registers(lowered)
        if lowered.load.contour is not None:
            return registers
        return {**registers, "PR": {move.index: move.end - move.start for move in lowered.moving_axes}}


class SerialEnd(SampleEnd):
    """The ends of moves, by the stop codes of an SMC-2000."""

    # Threads alternate command by command: a poll's command precedes each of the two, and the last records are short.
    LATE_TICKS = 8

    def _end_reason(self, move: YaskawaAxisMove, record: DataRecord) -> tuple[str, str]:
        """Return how the axis ended. A contour that ST has ended early, after the executed record, reads like a
        completed one."""
        axis = record.axes[move.index]
        if move.samples and axis.stop_code == CONTOUR_END and axis.commanded != move.end:
            return "stopped", f"stopped in the middle of its contour, at {axis.commanded} counts"
        return super()._end_reason(move, record)


class SerialStart(SampleStart):
    """The single move that the resident program can execute."""

    GATE_START = SerialGateStart
    SAMPLE_END = SerialEnd
