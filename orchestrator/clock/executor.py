"""Where calls run that wait for a disk: at once in virtual time; live in a thread, because one may take a tenth of a
second, and nothing else of a process may stand still for that."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, TypeVar

T = TypeVar("T")


class Runs(Protocol):
    """Runs calls, in the order in which they are given."""

    async def __call__(self, function: Callable[..., T], *values: Any) -> T: ...


async def beside(telling: Coroutine[Any, Any, None], doing: Coroutine[Any, Any, T]) -> T:
    """Do something while a disk is told of it, and give its result. What must not be done before it is on disk can not
    be done so; but what is told in turn is there in that order."""
    told = asyncio.ensure_future(telling)
    try:
        return await doing
    finally:
        await told


async def inline(function: Callable[..., T], *values: Any) -> T:
    """At once, in virtual time."""
    return function(*values)


class Threaded:
    """In a thread of its own."""

    def __init__(self, name: str) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)

    async def __call__(self, function: Callable[..., T], *values: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._pool, lambda: function(*values))
