"""The ring of triggers of an SMC-4000: loaded beside what is played, released and cut by one variable."""

import asyncio
import re
from typing import Any, cast

import pytest

from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.triggers.ring import MOST_OF_CHUNK, RING, SPARE_ELEMENTS, TriggerRing
from orchestrator.model.errors import Refusal


class Elements:
    """The elements of XRT, as commands assign them and queries read them. wrong: one that keeps another value."""

    def __init__(self, values: list[int]) -> None:
        self.elements = dict(enumerate(values))
        self.next_element = 0
        self.wrong: int | None = None

    async def send_settings(self, commands: list[str]) -> int:
        for command in commands:
            match = re.fullmatch(r"XRT\[(\d+)\]=(-?\d+)", command)
            assert match is not None, command
            self.elements[int(match[1])] = int(match[2]) + (int(match[1]) == self.wrong)
        return 0

    async def read_many(self, operands: list[str]) -> list[float]:
        await asyncio.sleep(0)
        return [float(self._read(operand)) for operand in operands]

    async def read_numbers(self, *operands: str) -> tuple[list[float], None]:
        return [float(self._read(operand)) for operand in operands], None

    def _read(self, operand: str) -> int:
        return self.next_element if operand == "XRI" else self.elements[int(operand[4:-1])]

    def play(self, count: int, stamp: int) -> None:
        """Play elements, with a stamp in each."""
        for _ in range(count):
            self.elements[self.next_element] = stamp
            self.next_element = (self.next_element + 1) % RING


def make_ring(values: list[int]) -> tuple[TriggerRing, Elements]:
    session = Elements(values)
    device: Any = type("Device", (), {"session": session})()
    return TriggerRing(cast(SmcDevice, device), values), session


def test_chunk_after_chunk_goes_round_and_no_stamp_is_lost() -> None:
    async def main() -> None:
        ring, session = make_ring(list(range(MOST_OF_CHUNK)))
        for chunk in range(1, 6):
            # The end of a chunk is still to be played when the next one is loaded.
            session.play(MOST_OF_CHUNK - SPARE_ELEMENTS if chunk == 1 else MOST_OF_CHUNK, chunk)
            first = chunk * MOST_OF_CHUNK
            await ring.load_part(first, list(range(first, first + MOST_OF_CHUNK)))
            assert ring.find_release() == (first + MOST_OF_CHUNK) % RING
            ring.take_part()
            assert ring.find_release() is None and len(ring.values) == first + MOST_OF_CHUNK
        await ring.read_stamps()
        assert len(ring.stamps) == 5 * MOST_OF_CHUNK - SPARE_ELEMENTS
        assert ring.stamps[0] == 1 and ring.stamps[-1] == 5
        assert await ring.read_next() == len(ring.stamps)

    asyncio.run(main())


def test_a_cut_goes_back_and_the_chunk_behind_it_takes_its_elements() -> None:
    async def main() -> None:
        ring, session = make_ring(list(range(100)))
        session.play(10, 7)
        await ring.load_part(40, [])
        assert ring.find_release() == 40
        ring.take_part()
        assert ring.values == list(range(40))
        await ring.load_part(40, [400, 401])
        ring.take_part()
        assert ring.values[39:] == [39, 400, 401]
        assert [session.elements[number] for number in (9, 10, 40, 41, 42)] == [7, 10, 400, 401, 42]

    asyncio.run(main())


def test_what_does_not_fit_or_reads_back_otherwise_is_refused() -> None:
    async def main() -> None:
        ring, session = make_ring(list(range(MOST_OF_CHUNK)))
        with pytest.raises(Refusal, match="do not fit beside") as refused:
            await ring.load_part(MOST_OF_CHUNK, list(range(MOST_OF_CHUNK + SPARE_ELEMENTS + 1)))
        assert refused.value.code == "no-room"
        session.wrong = MOST_OF_CHUNK + 30
        with pytest.raises(Refusal, match=rf"XRT\[{session.wrong}\] contains 31, not 30") as refused:
            await ring.load_part(MOST_OF_CHUNK, list(range(100)))
        assert refused.value.code == "read-back" and ring.find_release() is None

    asyncio.run(main())


def test_a_load_that_another_one_has_replaced_ends() -> None:
    async def main() -> None:
        ring, _ = make_ring(list(range(10)))
        slow = asyncio.ensure_future(ring.load_part(10, list(range(200))))
        await asyncio.sleep(0)
        await ring.load_part(5, [50])
        with pytest.raises(Refusal, match="in its place"):
            await slow
        assert ring.find_release() == 6

    asyncio.run(main())
