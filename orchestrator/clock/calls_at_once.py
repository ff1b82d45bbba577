"""Many calls at once, with a task only for those that wait, and a bound on those under way."""

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine, Iterable
from math import inf
from typing import Any, TypeVar

S = TypeVar("S")
T = TypeVar("T")


async def call_for_each(
    function: Callable[[S], Coroutine[Any, Any, T]], subjects: Iterable[S], limit: float = inf
) -> list[T]:
    """Call `function` for each of `subjects` at once; return the results in their order.

    One task makes call after call, as long as none waits; where one does, another task goes on with the next. limit:
    how many calls are under way at most. The first error is raised, and ends the others.
    """
    left = deque(enumerate(subjects))
    results: dict[int, T] = {}

    async def work() -> None:
        while left:
            number, subject = left.popleft()
            results[number] = await function(subject)

    workers: list[asyncio.Task[None]] = []
    try:
        while left and len(workers) < limit:
            workers.append(asyncio.get_running_loop().create_task(work()))
            await asyncio.sleep(0)
        await asyncio.gather(*workers)
    finally:
        for worker in workers:
            worker.cancel()
    return [results[number] for number in sorted(results)]
