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


@pytest.mark.parametrize(("limit", "took_s"), [(100, 1.0), (7, 3.0), (1, 20.0)])
def test_calls_that_wait_are_under_way_at_once_up_to_a_limit(limit: int, took_s: float) -> None:
    under_way, most = 0, 0

    async def wait(number: int) -> int:
        nonlocal under_way, most
        under_way += 1
        most = max(most, under_way)
        await asyncio.sleep(1.0)
        under_way -= 1
        return number

    async def main(clock: VirtualClock) -> None:
        assert await call_for_each(wait, range(20), limit) == list(range(20))
        assert clock.loop.time() == pytest.approx(took_s)
        assert most == min(limit, 20)

    run_virtual(main)


def test_a_slow_call_delays_no_other_and_an_error_ends_them() -> None:
    ended: list[int] = []

    async def work(number: int) -> None:
        await asyncio.sleep(10.0 if number == 0 else 0.01)
        if number == 50:
            raise KeyError(number)
        ended.append(number)

    async def main(clock: VirtualClock) -> None:
        with pytest.raises(KeyError):
            await call_for_each(work, range(100), 2)
        assert ended == list(range(1, 50)) and clock.loop.time() == pytest.approx(0.5)
        await asyncio.sleep(20.0)
        assert ended == list(range(1, 50))

    run_virtual(main)
