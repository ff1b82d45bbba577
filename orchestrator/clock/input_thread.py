"""Bytes of a descriptor, read by a thread: for event loops that cannot watch it, those of Windows."""

import asyncio
import os
from collections.abc import Callable
from contextlib import suppress
from threading import Thread

READ_BYTES = 4096


def read_in_thread(descriptor: int, take: Callable[[bytes], None]) -> None:
    """Let the running event loop call `take` with what arrives, at last with nothing. Raises `OSError` for a descriptor
    that is closed. The thread does not keep the process; it takes what arrives until the end of either."""
    loop = asyncio.get_running_loop()
    os.fstat(descriptor)

    def read() -> None:
        data = b" "
        while data:
            try:
                data = os.read(descriptor, READ_BYTES)
            except OSError:
                data = b""
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(take, data)

    Thread(target=read, name="input", daemon=True).start()
