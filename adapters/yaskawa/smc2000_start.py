"""A start on a serial line, where nothing but reading back finds a garbled digit."""

from adapters.contract import CannotDo
from adapters.yaskawa.lowering import LoweredMoves
from adapters.yaskawa.start import Start


class SerialStart(Start):
    """The one move that the resident program can hold."""

    async def _read_back(self, lowered: LoweredMoves) -> None:
        """The ends, too: PA reads as the place where the axis stands, but PR as the way to go (L10760, L10845)."""
        await super()._read_back(lowered)
        ways = {move.index: move.end - move.start for move in lowered.way}
        if ways:
            held = await self._device.read_back("PR", ways)
            if held != ways:
                raise CannotDo("read-back", f"PR reads back as {held}, not {ways}", "try again")
