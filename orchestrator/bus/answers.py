"""Requests that come twice, e.g. because their sender has given up waiting, are done once and answered alike."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from typing import Any, Generic, TypeVar

T = TypeVar("T")

KEPT = 256


class Answers(Generic[T]):
    """The newest `KEPT` answers, by verb and request id."""

    def __init__(self) -> None:
        self._given: OrderedDict[tuple[str, str], asyncio.Task[T]] = OrderedDict()

    async def once(self, verb: str, request_id: str, work: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """What `work` gives, or has given or will give to the same request. It goes on when nobody waits for it."""
        key = (verb, request_id)
        task = self._given.get(key)
        if task is None:
            task = self._given[key] = asyncio.get_running_loop().create_task(work())
            while len(self._given) > KEPT:
                self._given.popitem(last=False)
        return await asyncio.shield(task)
