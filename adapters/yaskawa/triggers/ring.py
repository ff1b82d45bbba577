"""The table of triggers as a ring: the elements of a further chunk of a path are loaded while it is played.

Arrays cannot be transferred while an axis moves (L8545-8577): elements are assigned one by one, and read back like any
operand. An element that was played contains its stamp, which is read before the element is assigned anew.
"""

import asyncio

from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.program import TABLE
from orchestrator.model.errors import Refusal

RING = 2048  # elements, a power of two
SPARE_ELEMENTS = 16  # between what may be played and what is loaded
MOST_OF_CHUNK = RING // 2 - SPARE_ELEMENTS  # one chunk is loaded while another one is played
AT_ONCE = 24  # elements in one turn: in between the watchdog is extended, and the clock read


class TriggerRing:
    """The elements of one path.

    values: by number of the trigger, the samples after XT0 that are loaded and released. stamps: of those that were
    played, as far as they are read.
    """

    def __init__(self, device: SmcDevice, values: list[int]) -> None:
        self._device = device
        self.values = values
        self.stamps: list[int] = []
        self._part: tuple[int, list[int]] | None = None
        self._loads = 0
        self._reading = asyncio.Lock()

    async def read_stamps(self) -> None:
        """Read the stamps of what was played since the last time."""
        async with self._reading:  # by the next chunk, while it moves, and at its end
            session, done_count = self._device.session, len(self.stamps)
            (index,), _ = await session.read_numbers("XRI")
            count = (int(index) - done_count) % RING
            names = [_element_name(number) for number in range(done_count, done_count + count)]
            for at in range(0, count, AT_ONCE):
                self.stamps += [int(value) for value in await session.read_many(names[at : at + AT_ONCE])]

    async def read_next(self) -> int:
        """Return the element behind those whose stamps are read."""
        (value,), _ = await self._device.session.read_numbers(_element_name(len(self.stamps)))
        return int(value)

    async def load_part(self, first: int, values: list[int]) -> None:
        """Load the elements from number `first` on. Raises `Refusal`."""
        self._part = None
        self._loads += 1
        load = self._loads
        await self.read_stamps()
        if first + len(values) - len(self.stamps) > RING - SPARE_ELEMENTS:
            raise Refusal("no-room", "the triggers do not fit beside those that are still to be played", "load later")
        session, end = self._device.session, first + len(values)
        wanted_values = {_element_name(number): value for number, value in zip(range(first, end), values, strict=True)}
        names = list(wanted_values)
        for at in range(0, len(names), AT_ONCE):
            operands = names[at : at + AT_ONCE]
            await session.send_settings([f"{name}={wanted_values[name]}" for name in operands])
            for name, held_value in zip(operands, await session.read_many(operands), strict=True):
                if held_value != wanted_values[name]:
                    text = f"{name} contains {held_value:.0f}, not {wanted_values[name]}"
                    raise Refusal("read-back", text, "try again")
            if load != self._loads:
                raise Refusal("superseded", "another chunk is loaded in its place", "")
        self._part = first, values

    def find_release(self) -> int | None:
        """The value of XRN that releases the part that is loaded; None if that is the present one."""
        if self._part is None:
            return None
        first, values = self._part
        end = first + len(values)
        return end % RING if end != len(self.values) else None

    def take_part(self) -> None:
        """The part that is loaded is released."""
        if self._part is not None:
            first, values = self._part
            self.values[first:] = values
            self._part = None


def _element_name(number: int) -> str:
    return f"{TABLE}[{number % RING}]"
