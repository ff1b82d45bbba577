"""The records of a contour in the controller's arrays: allocation, download by QD, upload by QU (L8545, L9105,
L15870)."""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.yaskawa.common.program import TAIL, array_name
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.record import RECORD_LETTERS
from adapters.yaskawa.wire.session import MAX_PACKET, CommandSession
from orchestrator.model.errors import Refusal

ARRAY_NAMES = (*(array_name(index) for index in range(len(RECORD_LETTERS))), TAIL)
ALLOCATION_EXCHANGES = len(ARRAY_NAMES) + 1  # exchanges
SEPARATOR = 2  # bytes between two elements of a download
PACKET_ELEMENT_CHARACTERS = MAX_PACKET - len(
    "QD XC1[],99999,99999\r\x1a"
)  # bytes of a packet that are left for elements
UPLOAD_ELEMENTS = 250  # elements requested per upload
UPLOAD_DIGITS = 5  # digits of an element in an upload (PF)
FORMAT_EXCHANGES = 3  # exchanges: read the present format, set the adapter's, restore the former
ARRAY_SPACE_FULL = 66  # error codes (L10268)
TOO_MANY_ARRAYS = 67
SPREAD_CHARACTERS = 1.02  # of characters: the increments depend on the phase of the start, by a digit in some places


@dataclass(frozen=True, slots=True)
class ArrayTransfer:
    """How arrays are transferred over a link.

    names: names of the arrays that the adapter may own.
    elements: characters of elements, with separators, per download.
    upload_elements: number of elements per upload.
    digits: of an element in an upload."""

    names: tuple[str, ...] = ARRAY_NAMES
    elements: int = PACKET_ELEMENT_CHARACTERS
    upload_elements: int = UPLOAD_ELEMENTS
    digits: int = UPLOAD_DIGITS


@dataclass(frozen=True, slots=True)
class SlowArrayTransfer(ArrayTransfer):
    """Transfer over a link whose time is dominated by its characters.

    exchange_ns: duration of one exchange without its elements.
    char_ns: duration of one character.
    most_s: longest transfer that a contour may take, s."""

    exchange_ns: int = 0
    char_ns: int = 0
    most_s: float = math.inf

    def load_duration_ns(self, arrays: Mapping[str, Sequence[int]]) -> int:
        """Return an upper bound for the duration of `load_arrays`: every element is downloaded and uploaded, with a
        separator."""
        texts = {name: sum(len(str(value)) + 1 for value in values) for name, values in arrays.items()}
        # In an upload a positive number has a column for its sign, too.
        positive = sum(value >= 0 for values in arrays.values() for value in values)
        characters = 2 * sum(texts.values()) + positive
        # After a refused deallocation the reason is queried.
        exchanges = 2 * len(self.names) + 1 + FORMAT_EXCHANGES
        for values in arrays.values():
            exchanges += len(_split_into_packets(values, self.elements)) + -(-len(values) // self.upload_elements)
        return exchanges * self.exchange_ns + round(SPREAD_CHARACTERS * characters * self.char_ns)


DEFAULT_TRANSFER = ArrayTransfer()


async def free_arrays(session: CommandSession, names: Iterable[str] = ARRAY_NAMES) -> None:
    """Deallocate all arrays of the adapter (DA, L3971); a controller may refuse to free an array that does not
    exist."""
    for name in names:
        with suppress(SmcCommandRefused):
            await session.send_command(f"DA {name}[0]")


async def load_arrays(
    session: CommandSession, arrays: Mapping[str, Sequence[int]], packets: ArrayTransfer = DEFAULT_TRANSFER
) -> None:
    """Allocate these arrays, fill them, and verify their contents. Raises `Refusal`."""
    await allocate_arrays(session, {name: len(values) for name, values in arrays.items()}, packets)
    await fill_arrays(session, [(name, 0, values) for name, values in arrays.items()], packets)


async def allocate_arrays(
    session: CommandSession, sizes: Mapping[str, int], packets: ArrayTransfer = DEFAULT_TRANSFER
) -> None:
    """Allocate these arrays in the place of all that the adapter has. Raises `Refusal`."""
    await free_arrays(session, packets.names)
    try:
        await session.send_command("DM " + ",".join(f"{name}[{size}]" for name, size in sizes.items()))
    except SmcCommandRefused as refusal:
        if refusal.number not in (ARRAY_SPACE_FULL, TOO_MANY_ARRAYS):
            raise
        raise Refusal(
            "array-space",
            f"the controller has no room for {sum(sizes.values())} array elements in addition to existing arrays",
            "free arrays with DA, or lower the controller's option array_elements",
        ) from None


async def fill_arrays(
    session: CommandSession,
    parts: Sequence[tuple[str, int, Sequence[int]]],
    packets: ArrayTransfer = DEFAULT_TRANSFER,
) -> None:
    """Fill elements of arrays, each from a first one on, and verify them. Raises `Refusal`."""
    for name, begin, values in parts:
        for first, part in _split_into_packets(values, packets.elements):
            await session.load_array(name, begin + first, part)
    array_contents = await read_elements(
        session, [(name, begin, len(values)) for name, begin, values in parts], packets
    )
    for (name, begin, values), content in zip(parts, array_contents, strict=True):
        if content != list(values):
            at = next((k for k, (a, b) in enumerate(zip(content, values, strict=False)) if a != b), 0)
            raise Refusal("read-back", f"{name}[{begin + at}] does not contain the value that was loaded", "try again")


async def read_elements(
    session: CommandSession, parts: Sequence[tuple[str, int, int]], packets: ArrayTransfer = DEFAULT_TRANSFER
) -> list[list[int]]:
    """Return elements of arrays. parts: array, first element, number of them. They arrive in the position format
    (L9105), which a user may have set to anything."""
    (old_format,), _ = await session.read_numbers("_PF")
    await session.send_command(f"PF {packets.digits}.0")
    arrays: list[list[int]] = [[] for _ in parts]
    try:
        for (name, begin, count), values in zip(parts, arrays, strict=True):
            for first in range(begin, begin + count, packets.upload_elements):
                last = min(first + packets.upload_elements, begin + count) - 1
                values += await session.read_array(name, first, last)
    finally:
        await session.send_command(f"PF {old_format:.1f}")
    return arrays


def count_exchanges(count: int, lengths: Sequence[int]) -> int:
    """Return an upper bound for the number of exchanges of `load_arrays`.

    count: elements per array. lengths: one entry per array, the digits of its largest element."""
    down = sum(-(-count // (PACKET_ELEMENT_CHARACTERS // (digits + 1 + SEPARATOR))) for digits in lengths)
    return ALLOCATION_EXCHANGES + FORMAT_EXCHANGES + down + len(lengths) * -(-count // UPLOAD_ELEMENTS)


def _split_into_packets(values: Sequence[int], room: int) -> list[tuple[int, list[int]]]:
    """Return (first element, elements) for each packet. room: characters, with separators."""
    parts: list[tuple[int, list[int]]] = []
    used = room
    for index, value in enumerate(values):
        size = len(str(value)) + SEPARATOR
        if used + size > room:
            parts.append((index, []))
            used = 0
        parts[-1][1].append(value)
        used += size
    return parts
