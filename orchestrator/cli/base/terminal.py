"""The terminal of a command, beyond lines of text: keys one by one, and input that is dropped."""

import asyncio
import os
import sys
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, suppress

import click

from orchestrator.clock.input_thread import READ_BYTES

HAS_PANELS = sys.platform != "win32"
"""Whether a panel can have the whole terminal: each key as it is, and a screen of its own."""

if sys.platform == "win32":
    from orchestrator.cli.base.windows_console import forget_typed_ahead as forget_typed_ahead
    from orchestrator.cli.base.windows_console import wait_for_line as wait_for_line
    from orchestrator.cli.base.windows_console import watch_input as watch_input
else:
    import termios
    import tty

    def forget_typed_ahead() -> None:
        """Drop what was typed before something was shown; nothing, if the input is no terminal."""
        if sys.stdin.isatty():
            termios.tcflush(sys.stdin, termios.TCIFLUSH)

    @contextmanager
    def watch_input(descriptor: int, take: Callable[[bytes], None]) -> Generator[None]:
        """Let the running event loop call `take` with each key of a terminal, or with the bytes of a pipe; with nothing
        at its end. Raises `OSError` for what cannot be watched."""
        loop = asyncio.get_running_loop()

        def read_input() -> None:
            data = os.read(descriptor, READ_BYTES)
            if not data:
                loop.remove_reader(descriptor)
            take(data)

        with ExitStack() as restore:
            if os.isatty(descriptor):
                restore.callback(termios.tcsetattr, descriptor, termios.TCSADRAIN, termios.tcgetattr(descriptor))
                tty.setcbreak(descriptor)
            loop.add_reader(descriptor, read_input)
            restore.callback(loop.remove_reader, descriptor)
            yield

    async def wait_for_line() -> bool:
        """Wait for Enter at the terminal. Return whether it was pressed, and its input has not ended."""
        loop, line_event = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(sys.stdin, line_event.set)
        try:
            await line_event.wait()
        finally:
            loop.remove_reader(sys.stdin)
        return bool(sys.stdin.readline())

    @contextmanager
    def raw_mode(descriptor: int) -> Generator[None]:
        """Let the terminal give each key as it is; afterwards it is as before, unless it is hung up."""
        old_mode = termios.tcgetattr(descriptor)
        try:
            tty.setraw(descriptor)
            yield
        finally:
            with suppress(termios.error):
                termios.tcsetattr(descriptor, termios.TCSAFLUSH, old_mode)


def confirm_shown(question: str) -> bool:
    """Ask about what has just been shown for something that moves: a word counts only after it was shown."""
    forget_typed_ahead()
    return click.confirm(question)
