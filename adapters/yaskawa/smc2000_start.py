"""A start on a serial line: in few exchanges, and all of it read back, for nothing else finds a garbled digit."""

from adapters.contract import CannotDo
from adapters.yaskawa.dialect import MAX_LINE
from adapters.yaskawa.lowering import LoweredMoves
from adapters.yaskawa.record import AXIS_LETTERS
from adapters.yaskawa.start import Start

OPERANDS_OF_LINE = (MAX_LINE - 3) // len('_SPX,",",')


class SerialStart(Start):
    """The one move that the resident program can hold."""

    async def _read_back(self, lowered: LoweredMoves) -> None:
        """The ends, too: PA reads as the place where the axis stands, but PR as the way to go (L10760, L10845)."""
        registers = {"PR": {move.index: move.end - move.start for move in lowered.way}, **lowered.load.held}
        wanted = {
            f"_{command}{AXIS_LETTERS[index]}": value
            for command, values in registers.items()
            for index, value in values.items()
        }
        operands = list(wanted)
        for at in range(0, len(operands), OPERANDS_OF_LINE):
            part = operands[at : at + OPERANDS_OF_LINE]
            held, _ = await self._device.session.numbers(*part)
            for operand, value in zip(part, held, strict=True):
                if value != wanted[operand]:
                    raise CannotDo(
                        "read-back", f"{operand} reads back as {value:g}, not {wanted[operand]}", "try again"
                    )
