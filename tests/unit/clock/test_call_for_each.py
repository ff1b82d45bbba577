"""Many calls at once: tasks only for those that wait."""

import asyncio

import pytest

from orchestrator.clock.owner import call_for_each
from orchestrator.clock.virtual import VirtualClock, run_virtual


def test_calls_that_do_not_wait_need_one_task() -> None:
    async def square(number: int) -> int:
        return number * number

    async def main(clock: VirtualClock) -> None:
        tasks = clock.loop.created_tasks
        assert await call_for_each(square, range(1000)) == [number * number for number in range(1000)]
        assert clock.loop.created_tasks - tasks == 1
        assert await call_for_each(square, []) == []

    run_virtual(main)


def test_calls_that_wait_are_under_way_at_once() -> None:
    async def wait(number: int) -> int:
        await asyncio.sleep(1.0 if number % 2 else 0.0)
        return number

    async def main(clock: VirtualClock) -> None:
        assert await call_for_each(wait, range(20)) == list(range(20))
        assert clock.loop.time() == 1.0

    run_virtual(main)


def test_an_error_is_raised_and_ends_the_others() -> None:
    ended: list[int] = []

    async def work(number: int) -> None:
        await asyncio.sleep(0.01 * number)
        if number == 50:
            raise KeyError(number)
        ended.append(number)

    async def main(clock: VirtualClock) -> None:
        with pytest.raises(KeyError):
            await call_for_each(work, range(100))
        assert clock.loop.time() == pytest.approx(0.5)
        await asyncio.sleep(20.0)
        assert ended == list(range(50))

    run_virtual(main)
