"""Garbage collection, which pauses a process in proportion to its objects: 0.3 s beside a path of 100,000 pieces.

Reference counts free nearly everything; only cycles wait for a collection.
"""

import ctypes
import gc
from typing import ClassVar


class CollectionPause:
    """No collection while any of these contexts lasts. For one thread."""

    pauses: ClassVar[int] = 0

    def __enter__(self) -> None:
        CollectionPause.pauses += 1
        gc.disable()

    def __exit__(self, *_: object) -> None:
        CollectionPause.pauses -= 1
        if not CollectionPause.pauses:
            gc.enable()


def exempt_objects() -> None:
    """Leave all present objects out of later collections; they are still freed with their last reference."""
    gc.freeze()


def return_memory() -> None:
    """Give the pages of freed objects back to the system, as far as the C library can: after a long plan 0.6 GB were
    kept. The loop may wait for some milliseconds meanwhile."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of the GNU C library
    if trim is not None:
        trim(0)
