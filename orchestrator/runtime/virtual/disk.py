"""The disks of a virtual fleet: they can be full, and slow, and what is on them can be damaged."""

import asyncio
import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from orchestrator.clock.base import Clock, sleep_ns
from orchestrator.clock.executor import Executor, run_inline
from orchestrator.model.files.private_files import FileAccess

T = TypeVar("T")


class VirtualDisk:
    """The disk of one computer; it outlives all processes.

    full: nothing can be written. draw_delay_ns: draws the duration of each call that waits for the disk. files: their
    contents by name.
    """

    def __init__(self, clock: Clock) -> None:
        self.full = False
        self.draw_delay_ns: Callable[[], int] | None = None
        self.files: dict[str, bytes] = {}
        self._clock = clock

    def access_files(self) -> FileAccess:
        """Return what a process reads and replaces its files by."""
        return FileAccess(self._read_file, self._replace_file)

    async def find_free(self) -> int | None:
        """The free bytes; None: not known."""
        return 0 if self.full else None

    def make_executor(self) -> Executor:
        """Return an executor of one process for calls that wait for the disk."""
        lock = asyncio.Lock()

        async def run_call(function: Callable[..., T], *values: Any) -> T:
            async with lock:  # in the order in which they are submitted
                if self.draw_delay_ns is not None:
                    await sleep_ns(self._clock, self.draw_delay_ns())
                return await run_inline(function, *values)

        return run_call

    def _read_file(self, path: Path) -> bytes:
        try:
            return self.files[str(path)]
        except KeyError:
            raise FileNotFoundError(errno.ENOENT, "no such file", str(path)) from None

    def _replace_file(self, path: Path, contents: bytes) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "no space left on device", str(path))
        self.files[str(path)] = contents
