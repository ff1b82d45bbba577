"""The console of Windows, as `terminal` has terminals. It is asked for keys again and again: a thread that waits for
one would take it from whatever reads next."""

import asyncio
import msvcrt
import os
import sys
from _thread import interrupt_main
from collections.abc import Callable, Generator
from contextlib import contextmanager

from orchestrator.clock.input_thread import read_in_thread
from orchestrator.clock.owner import TaskOwner

POLL_S = 0.02
CTRL_C = "\x03"


def forget_typed_ahead() -> None:
    """Drop what was typed before something was shown; nothing, if the input is no terminal."""
    while sys.stdin.isatty() and msvcrt.kbhit():
        msvcrt.getwch()


@contextmanager
def watch_input(descriptor: int, take: Callable[[bytes], None]) -> Generator[None]:
    """Let the running event loop call `take` with each key of a console, or with the bytes of a pipe; with nothing at
    its end. Raises `OSError` for what cannot be watched."""
    if not os.isatty(descriptor):
        read_in_thread(descriptor, take)
        yield
        return
    tasks = TaskOwner()
    tasks.spawn(_watch_keys(take))
    try:
        yield
    finally:
        tasks.cancel_all()


async def _watch_keys(take: Callable[[bytes], None]) -> None:
    while True:
        while msvcrt.kbhit():
            key = msvcrt.getwch()
            interrupt_main() if key == CTRL_C else take(key.encode("utf-8", "replace"))
        await asyncio.sleep(POLL_S)


async def wait_for_line() -> bool:
    """Wait for Enter at the console. Return whether it was pressed, and its input has not ended."""
    entered_event = asyncio.Event()
    with watch_input(sys.stdin.fileno(), lambda key: entered_event.set() if key in b"\r\n" else None):
        await entered_event.wait()
    return True
