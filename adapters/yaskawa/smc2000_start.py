"""A start on a serial line: in few exchanges, and all of it read back, for nothing else finds a garbled digit."""

from adapters.contract import CannotDo
from adapters.yaskawa.dialect import MAX_LINE
from adapters.yaskawa.lowering import AxisMove, LoweredMoves, Records
from adapters.yaskawa.record import AXIS_LETTERS, Record
from adapters.yaskawa.start import Start

OPERANDS_OF_LINE = (MAX_LINE - 3) // len('_SPX,",",')
CONTOUR_END = 51  # of SC (L11427-11493)


class SerialStart(Start):
    """The one move that the resident program can hold."""

    # Threads take turns command by command: a poll's comes before each of the two, and the last records are short.
    LATE_TICKS = 8

    async def _read_back(self, lowered: LoweredMoves) -> None:
        """The ends, too: PA reads as the place where the axis stands, but PR as the way to go (L10760, L10845)."""
        load, registers = lowered.load, dict(lowered.load.held)
        if not isinstance(load, Records):
            registers["PR"] = {move.index: move.end - move.start for move in lowered.way}
        wanted = {
            f"_{command}{AXIS_LETTERS[index]}": value
            for command, values in registers.items()
            for index, value in values.items()
        }
        if isinstance(load, Records):
            wanted |= load.variables
        operands = list(wanted)
        for at in range(0, len(operands), OPERANDS_OF_LINE):
            part = operands[at : at + OPERANDS_OF_LINE]
            held, _ = await self._device.session.numbers(*part)
            for operand, value in zip(part, held, strict=True):
                if value != wanted[operand]:
                    raise CannotDo(
                        "read-back", f"{operand} reads back as {value:g}, not {wanted[operand]}", "try again"
                    )

    def _reason(self, move: AxisMove, record: Record) -> tuple[str, str]:
        """A contour that ST has ended early, after the record that was executed, reads like one that was played."""
        axis = record.axes[move.index]
        if move.samples and axis.stop_code == CONTOUR_END and axis.commanded != move.end:
            return "stopped", f"stopped in the middle of its contour, at {axis.commanded} counts"
        return super()._reason(move, record)
