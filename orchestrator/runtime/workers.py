"""Work spread over processes, for seeds and environments that are independent of each other."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

from orchestrator.clock.parent import prepare_worker

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_in_processes(work: Callable[[Item], Result], items: Iterable[Item], processes: int = 1) -> Iterator[Result]:
    """Apply `work` to each item and yield the results in the order of the items, whatever the number of processes.

    With more than one process, `work` is a function of a module, and items and results can be pickled.
    """
    if processes == 1:
        yield from map(work, items)
        return
    # Start a new interpreter for each worker: it must not inherit open files or threads of the parent.
    pool = ProcessPoolExecutor(processes, get_context("spawn"), initializer=prepare_worker, initargs=(os.getpid(),))
    try:
        yield from pool.map(work, items)
    finally:
        pool.shutdown(cancel_futures=True)
