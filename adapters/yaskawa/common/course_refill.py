"""Loading and releasing of chunks in the controller.

The first chunk is downloaded. QD and QU are refused while an axis moves (L8545-8577): further chunks are assigned
element by element, and read back like any operand, which takes the interpreter about half a millisecond each.

The program reads record after record up to XN, and then the tail at XTB. A chunk is released by one assignment of XN,
whose value the controller itself computes from what it plays at that moment: too late, and XN stays as it is.
"""

from collections.abc import Mapping, Sequence

from adapters.yaskawa.common import arrays
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.lines import PartRelease
from adapters.yaskawa.common.loads import CourseLoad
from adapters.yaskawa.common.program import TAIL, TAIL_LENGTH, array_name
from adapters.yaskawa.shapes.course_records import SPARE_RECORDS, ChunkRecords, RingRoom
from orchestrator.model.errors import Refusal

AT_ONCE = 24  # elements in one turn
LEAST_AHEAD = 2  # records between what is played and a change


class ContourRefill:
    """The arrays of one controller while it executes a path."""

    def __init__(self, device: SmcDevice) -> None:
        self._device = device
        self._loads = 0

    async def load_arrays(self, contents: Mapping[str, Sequence[int]], packets: arrays.ArrayTransfer) -> None:
        """Allocate arrays, fill them, and verify their contents. Raises `Refusal`."""
        await arrays.load_arrays(self._device.session, contents, packets)

    async def load_first(self, records: ChunkRecords, room: RingRoom) -> None:
        """Allocate the arrays, and load the first chunk. Raises `Refusal`."""
        sizes = {array_name(index): room.elements for index in records.counts}
        await arrays.allocate_arrays(self._device.session, {**sizes, TAIL: TAIL_LENGTH})
        await arrays.fill_arrays(self._device.session, _list_parts(records))

    async def load(self, records: ChunkRecords, room: RingRoom, played: int) -> None:
        """Load a further chunk. played: the record that is executed now. Raises `Refusal`."""
        if records.end - played > room.ring - SPARE_RECORDS:
            raise Refusal("no-room", "the chunk does not fit beside what is still to be executed", "load it later")
        self._loads += 1
        session, load = self._device.session, self._loads
        wanted_values = {
            f"{name}[{first + offset}]": value
            for name, first, values in _list_parts(records)
            for offset, value in enumerate(values)
        }
        names = list(wanted_values)
        # In small turns: the watchdog is extended, and the clock read, in between.
        for at in range(0, len(names), AT_ONCE):
            self._require_last(load)
            await session.send_settings([f"{name}={wanted_values[name]}" for name in names[at : at + AT_ONCE]])
        for at in range(0, len(names), AT_ONCE):
            self._require_last(load)
            operands = names[at : at + AT_ONCE]
            for name, held_value in zip(operands, await session.read_many(operands), strict=True):
                if held_value != wanted_values[name]:
                    text = f"{name} contains {held_value:.0f}, not {wanted_values[name]}"
                    raise Refusal("read-back", text, "try again")

    def _require_last(self, load: int) -> None:
        if load != self._loads:
            raise Refusal("superseded", "another chunk is loaded in its place", "")

    async def release(self, records: ChunkRecords, load: CourseLoad, triggers: PartRelease | None) -> None:
        """Change over to a loaded chunk, behind or inside that of `load`, and to its triggers. Raises `Refusal`."""
        old_records, room = load.records, load.maker.room
        tail, old_tail = records.tail_variables(room), old_records.tail_variables(room)
        margin = 0 if triggers is None else -(-triggers.ahead_ticks >> load.maker.interval) + 1
        margin = max(LEAST_AHEAD, margin)
        if records.end > old_records.end:
            await self._set_end(f"XN-{margin}", records.end, triggers)
            # Its own end is a chunk away.
            await self._set_tail(tail)
            return
        await self._set_tail(tail)
        try:
            await self._set_end(str(records.end - margin), records.end, triggers)
        except Refusal:
            await self._set_tail(old_tail)
            raise

    async def _set_end(self, latest: str, end: int, triggers: PartRelease | None) -> None:
        """Set XN, if the controller finds that the next record is before `latest`, and with it XRN. Operations are done
        from left to right."""
        session, places = self._device.session, [] if triggers is None else [triggers.place]
        commands = [f"XN=(({end}-XN)*(XI<({latest})))+XN"]
        await session.send_settings([*commands, *(f"XRN=(({index}-XRN)*(XN={end}))+XRN" for index in places)])
        (held_end, played_count, held_place), _ = await session.read_numbers("XN", "XI", "XRN")
        if int(held_end) != end or played_count > end:
            raise Refusal("late", "the controller has passed the place where the path was to be continued", "")
        if places and int(held_place) != places[0]:
            raise Refusal("read-back", f"XRN reads back as {held_place:.0f}, not {places[0]}", "try again")

    async def release_triggers(self, place: int, by_ticks: int) -> None:
        """Set XRN, if the controller finds that it is before sample `by_ticks`. Raises `Refusal`."""
        session = self._device.session
        await session.send_settings([f"XRN=(({place}-XRN)*(TIME<{by_ticks}))+XRN"])
        (held_place,), _ = await session.read_numbers("XRN")
        if int(held_place) != place:
            raise Refusal("late", "the triggers before the place where the path was to be continued are near", "")

    async def _set_tail(self, tail: dict[str, int]) -> None:
        session = self._device.session
        await session.send_settings([f"{name}={value}" for name, value in tail.items()])
        held_values, _ = await session.read_numbers(*tail)
        if [int(value) for value in held_values] != list(tail.values()):
            raise Refusal("read-back", f"{', '.join(tail)} do not contain the values that were loaded", "try again")


def _list_parts(records: ChunkRecords) -> list[tuple[str, int, list[int]]]:
    """(array, first element, elements) of a chunk."""
    parts = [
        (array_name(index), part.first, values)
        for part in records.parts
        for index, values in part.values.items()
        if values
    ]
    return [*parts, (TAIL, 0, list(records.short))] if records.short else parts
