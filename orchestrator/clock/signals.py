"""Signals that end a process, or what it does, as calls by its event loop."""

import asyncio
import signal
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from types import FrameType

END_SIGNALS = ("SIGINT", "SIGTERM", "SIGBREAK")
"""Ctrl-C, what a service manager sends, and on Windows Ctrl-Break and a closed console."""
TERMINAL_SIGNALS = (*END_SIGNALS, "SIGHUP")
"""Also a closed terminal."""


def call_at_signals(callback: Callable[[], object], names: tuple[str, ...] = END_SIGNALS) -> None:
    """Let the running event loop call `callback` at each of these signals, as far as this system has them."""
    for number in _find_numbers(names):
        _take_signal(number, callback)


@contextmanager
def calls_at_signals(callback: Callable[[], object], names: tuple[str, ...] = END_SIGNALS) -> Generator[None]:
    """The same while the context is open; afterwards a signal does what it did before there were handlers."""
    call_at_signals(callback, names)
    try:
        yield
    finally:
        for number in _find_numbers(names):
            _leave_signal(number)


def _find_numbers(names: tuple[str, ...]) -> list[signal.Signals]:
    return [signal.Signals[name] for name in names if name in signal.Signals.__members__]


def _take_signal(number: signal.Signals, callback: Callable[[], object]) -> None:
    loop = asyncio.get_running_loop()
    try:
        loop.add_signal_handler(number, callback)
    except NotImplementedError:  # Windows

        def pass_on(_: int, __: FrameType | None) -> None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(callback)

        signal.signal(number, pass_on)


def _leave_signal(number: signal.Signals) -> None:
    try:
        asyncio.get_running_loop().remove_signal_handler(number)
    except NotImplementedError:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
