"""Virtual time: exact, deterministic, with processes that hang and die."""

import asyncio
import gc
import warnings

import pytest

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.queue import EventQueue
from orchestrator.clock.virtual import VirtualClock, VirtualDeadlock, VirtualProcess, run_virtual


def test_time_jumps_and_ties_run_in_order() -> None:
    async def main(clock: VirtualClock) -> list[object]:
        log: list[object] = []
        for name in "abc":
            clock.call_at_ns(3 * NS_PER_S, lambda name=name: log.append(name))
        clock.call_at_ns(1, lambda: log.append(clock.now_ns()))
        await asyncio.sleep(3600)
        log.append(clock.now_ns())
        return log

    assert run_virtual(main) == [1, "a", "b", "c", 3600 * NS_PER_S]


def test_a_frozen_process_catches_up_and_a_killed_one_never_runs_again() -> None:
    async def main(clock: VirtualClock) -> list[object]:
        log: list[object] = []
        process = VirtualProcess(clock.loop, "p")

        async def beat() -> None:
            try:
                while True:
                    await sleep_ns(clock, NS_PER_S)
                    log.append(clock.now_ns() / NS_PER_S)
            finally:
                log.append("finally")

        process.start_task(beat())
        await asyncio.sleep(1.5)
        process.freeze()
        await asyncio.sleep(5)
        process.resume()
        await asyncio.sleep(1.2)
        process.add_death_callback(lambda: log.append("reaped"))
        process.kill()
        await asyncio.sleep(10)
        return list(log)

    assert run_virtual(main) == [1.0, 6.5, 7.5, "reaped"]


def test_the_cleanup_of_a_killed_process_disturbs_nothing_after_the_run() -> None:
    async def main(clock: VirtualClock) -> None:
        process = VirtualProcess(clock.loop, "p")

        async def brake_when_cancelled() -> None:
            try:
                await asyncio.Event().wait()
            except BaseException:
                asyncio.get_running_loop().create_future()
                raise

        process.start_task(brake_when_cancelled())
        await asyncio.sleep(1)
        process.kill()
        await asyncio.sleep(1)

    # Python runs the cleanup when it drops the coroutine; an error of it would be a warning, and so a failed test.
    run_virtual(main)
    gc.collect()


def test_what_a_dropped_task_begins_at_the_end_is_dropped_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a loop, `gather` would make one that nothing closes, and coroutines that nothing awaits."""
    begun: list[str] = []

    async def stop() -> None:
        begun.append("stop")

    async def work(clock: VirtualClock) -> None:
        try:
            await sleep_ns(clock, 10**9)
        finally:
            await asyncio.gather(stop(), stop())

    async def main(clock: VirtualClock) -> None:
        asyncio.get_running_loop().create_task(work(clock))
        await sleep_ns(clock, 1)

    monkeypatch.setattr(asyncio.get_event_loop_policy(), "get_event_loop", lambda: begun.append("another loop"))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run_virtual(main)
        gc.collect()
    assert [str(each.message) for each in caught] == [] and begun == []


def test_deadlock_and_errors_end_the_run() -> None:
    async def wait_for_ever(_: VirtualClock) -> None:
        await asyncio.Event().wait()

    with pytest.raises(VirtualDeadlock):
        run_virtual(wait_for_ever)

    async def lose_an_error(clock: VirtualClock) -> None:
        clock.call_at_ns(5, lambda: 1 / 0)  # type: ignore[arg-type]
        await asyncio.sleep(1)

    with pytest.raises(ZeroDivisionError):
        run_virtual(lose_an_error)


def test_event_queue() -> None:
    queue, log = EventQueue(), list[int]()
    first = queue.call_at_ns(10, lambda: log.append(queue.now_ns()))
    queue.call_at_ns(20, lambda: log.append(queue.now_ns()))
    first.cancel()
    queue.run_until_ns(100)
    assert log == [20]
    assert queue.now_ns() == 100
    assert not queue.make_next_call()
