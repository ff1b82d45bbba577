"""A contour's records in the controller's arrays: space, QD down, QU back up (L8545, L9105, L15870)."""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.contract import CannotDo
from adapters.yaskawa.common.program import TAIL, array
from adapters.yaskawa.common.record import RECORD_LETTERS
from adapters.yaskawa.smc4000.session import MAX_PACKET, Refused, Session

NAMES = (*(array(index) for index in range(len(RECORD_LETTERS))), TAIL)
ALLOCATING = len(NAMES) + 1  # exchanges
SEPARATOR = 2  # bytes between two elements on their way down
ELEMENTS = MAX_PACKET - len("QD XC1[],99999,99999\r\x1a")  # bytes of a packet that are left for them
UP = 250  # elements asked back at once
FORMAT = 5  # digits of an element that is read back (PF)
FORMATTING = 3  # exchanges: the format that was set, ours, and that again
ARRAY_SPACE_FULL = 66  # error codes (L10268)
TOO_MANY_ARRAYS = 67
SPREAD = 1.02  # of characters: the increments depend on the phase of the start, by a digit here and there


@dataclass(frozen=True, slots=True)
class Packets:
    """How arrays go through a link. names: of those that may be ours. elements: characters of them, with separators,
    that are sent at once. back: how many elements are asked back at once."""

    names: tuple[str, ...] = NAMES
    elements: int = ELEMENTS
    back: int = UP


@dataclass(frozen=True, slots=True)
class SlowUpload(Packets):
    """Through a link whose characters are what takes the time. exchange_ns: of one exchange but for the elements in it.
    char_ns: of a character. most_s: what a contour may take, s."""

    exchange_ns: int = 0
    char_ns: int = 0
    most_s: float = math.inf

    def takes_ns(self, arrays: Mapping[str, Sequence[int]]) -> int:
        """How long `load` takes for these, at the most: every element goes down and comes back, with a separator."""
        texts = {name: sum(len(str(value)) + 1 for value in values) for name, values in arrays.items()}
        # Coming back, a positive number has a column for its sign, too.
        positive = sum(value >= 0 for values in arrays.values() for value in values)
        characters = 2 * sum(texts.values()) + positive
        # Refused frees are asked why.
        exchanges = 2 * len(self.names) + 1 + FORMATTING
        for values in arrays.values():
            exchanges += len(_parts(values, self.elements)) + -(-len(values) // self.back)
        return exchanges * self.exchange_ns + round(SPREAD * characters * self.char_ns)


PACKETS = Packets()


async def free(session: Session, names: Iterable[str] = NAMES) -> None:
    """Give back the space of all our arrays (DA, L3971); a controller may refuse to free what is not there."""
    for name in names:
        with suppress(Refused):
            await session.tell(f"DA {name}[0]")


async def load(session: Session, arrays: Mapping[str, Sequence[int]], packets: Packets = PACKETS) -> None:
    """Make these arrays, fill them, and see that they hold it. Raises `CannotDo`."""
    await free(session, packets.names)
    try:
        await session.tell("DM " + ",".join(f"{name}[{len(values)}]" for name, values in arrays.items()))
    except Refused as refusal:
        if refusal.number not in (ARRAY_SPACE_FULL, TOO_MANY_ARRAYS):
            raise
        raise CannotDo(
            "array-space",
            f"the controller has no room for {sum(map(len, arrays.values()))} array elements beside those of others",
            "free arrays with DA, or lower the controller's option array_elements",
        ) from None
    for name, values in arrays.items():
        for first, part in _parts(values, packets.elements):
            await session.load_array(name, first, part)
    await _compare(session, arrays, packets.back)


async def _compare(session: Session, arrays: Mapping[str, Sequence[int]], back: int) -> None:
    """Elements come back in the position format (L9105), which a person may have set to anything."""
    (before,), _ = await session.numbers("_PF")
    await session.tell(f"PF {FORMAT}.0")
    for name, values in arrays.items():
        for first in range(0, len(values), back):
            wanted = list(values[first : first + back])
            held = await session.read_array(name, first, first + len(wanted) - 1)
            if held != wanted:
                at = next((k for k, (a, b) in enumerate(zip(held, wanted, strict=False)) if a != b), 0)
                raise CannotDo("read-back", f"{name}[{first + at}] does not hold what was loaded", "try again")
    await session.tell(f"PF {before:.1f}")


def exchanges(count: int, lengths: Sequence[int]) -> int:
    """How many exchanges `load` takes at the most. count: elements of an array; lengths: of one array each, the digits
    of its largest."""
    down = sum(-(-count // (ELEMENTS // (digits + 1 + SEPARATOR))) for digits in lengths)
    return ALLOCATING + FORMATTING + down + len(lengths) * -(-count // UP)


def _parts(values: Sequence[int], room: int) -> list[tuple[int, list[int]]]:
    """(first element, elements): what fits into a packet each. room: characters, with separators."""
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
