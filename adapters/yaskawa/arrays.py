"""A contour's records in the controller's arrays: space, QD down, QU back up (L8545, L9105, L15870)."""

from collections.abc import Mapping, Sequence
from contextlib import suppress

from adapters.contract import CannotDo
from adapters.yaskawa.program import TAIL, array
from adapters.yaskawa.record import RECORD_LETTERS
from adapters.yaskawa.session import MAX_PACKET, Refused, Session

NAMES = (*(array(index) for index in range(len(RECORD_LETTERS))), TAIL)
ALLOCATING = len(NAMES) + 1  # exchanges
SEPARATOR = 2  # bytes between two elements on their way down
ELEMENTS = MAX_PACKET - len("QD XC1[],99999,99999\r\x1a")  # bytes of a packet that are left for them
UP = 250  # elements asked back at once
FORMAT = 5  # digits of an element that is read back (PF)
FORMATTING = 3  # exchanges: the format that was set, ours, and that again
ARRAY_SPACE_FULL = 66  # error codes (L10268)
TOO_MANY_ARRAYS = 67


async def free(session: Session) -> None:
    """Give back the space of all our arrays (DA, L3971); a controller may refuse to free what is not there."""
    for name in NAMES:
        with suppress(Refused):
            await session.tell(f"DA {name}[0]")


async def load(session: Session, arrays: Mapping[str, Sequence[int]]) -> None:
    """Make these arrays, fill them, and see that they hold it. Raises `CannotDo`."""
    await free(session)
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
        for first, part in _parts(values):
            await session.load_array(name, first, part)
    await _compare(session, arrays)


async def _compare(session: Session, arrays: Mapping[str, Sequence[int]]) -> None:
    """Elements come back in the position format (L9105), which a person may have set to anything."""
    (before,), _ = await session.numbers("_PF")
    await session.tell(f"PF {FORMAT}.0")
    for name, values in arrays.items():
        for first in range(0, len(values), UP):
            wanted = list(values[first : first + UP])
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


def _parts(values: Sequence[int]) -> list[tuple[int, list[int]]]:
    """(first element, elements): what fits into a packet each, with its separators and its end."""
    parts: list[tuple[int, list[int]]] = []
    used = ELEMENTS
    for index, value in enumerate(values):
        size = len(str(value)) + SEPARATOR
        if used + size > ELEMENTS:
            parts.append((index, []))
            used = 0
        parts[-1][1].append(value)
        used += size
    return parts
