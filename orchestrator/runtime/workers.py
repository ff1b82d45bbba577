"""Work spread over processes, for seeds and worlds that know nothing of each other."""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

from orchestrator.clock.parent import die_with_parent

Item = TypeVar("Item")
Result = TypeVar("Result")


def spread(work: Callable[[Item], Result], items: Iterable[Item], processes: int = 1) -> Iterator[Result]:
    """What `work` makes of each item, in the order of the items, whatever the number of processes.

    With more than one process, `work` is a function of a module, and items and results can be pickled.
    """
    if processes == 1:
        yield from map(work, items)
        return
    # A new interpreter each: what the parent has open or started is not theirs.
    pool = ProcessPoolExecutor(processes, get_context("spawn"), initializer=_begin, initargs=(os.getpid(),))
    try:
        yield from pool.map(work, items)
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(parent_pid: int) -> None:
    """A worker ends with its parent, and by Ctrl-C without a word."""
    die_with_parent(parent_pid)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
