"""A terminal in raw mode for a panel: single key events, an alternate screen, and a complete restoration afterwards."""

import contextlib
import io
import os
import select
import signal
import sys
import time
from contextlib import ExitStack
from typing import Self

from rich.console import Console, RenderableType

from orchestrator.cli.base.terminal import raw_mode
from orchestrator.cli.manual.jog.keys import DeviceAttributes, KeyboardFlags, KeyParser, TerminalEvent

# Time limit for a terminal's reply; over a slow connection a reply takes a while, and only such a terminal waits.
REPLY_TIMEOUT_S = 1.0
ESCAPE_TIMEOUT_S = 0.05  # the bytes of one key arrive together: after this time an ESC was the Escape key

_ALTERNATE, _MAIN = "\x1b[?1049h", "\x1b[?1049l"
_HIDE, _SHOW = "\x1b[?25l", "\x1b[?25h"
_TELL_FOCUS, _NO_FOCUS = "\x1b[?1004h", "\x1b[?1004l"
_HOME, _REST_OF_LINE, _REST_OF_SCREEN = "\x1b[H", "\x1b[K", "\x1b[J"
# The kitty keyboard protocol: 1 distinguishes keys that look alike, 2 reports repeats and releases.
_ASK_KEYBOARD, _ASK_DEVICE = "\x1b[?u", "\x1b[c"
_RELEASES = 2
_PUSH_KEYBOARD, _POP_KEYBOARD = f"\x1b[>{1 | _RELEASES}u", "\x1b[<u"


class RawTerminal:
    """The terminal on two descriptors, in raw mode while the context is open. Restored in every case but `kill -9`.

    releases: it reports key releases. Once it is hung up, `read_events` returns None and writing does nothing.
    """

    def __init__(self, fd_in: int, fd_out: int) -> None:
        self.fd_in = fd_in
        self.releases = False
        self._fd_out = fd_out
        self._parser = KeyParser()
        self._restore = ExitStack()
        self._image = io.StringIO()
        self._console = Console(file=self._image, force_terminal=True, highlight=False)

    def __enter__(self) -> Self:
        with ExitStack() as restore:
            restore.enter_context(raw_mode(self.fd_in))
            # Key events are not received in the background.
            restore.callback(signal.signal, signal.SIGTSTP, signal.signal(signal.SIGTSTP, signal.SIG_IGN))
            restore.callback(self.write_text, _SHOW + _MAIN)
            self.write_text(_ALTERNATE + _HIDE + _TELL_FOCUS)
            # Before leaving the alternate screen: main and alternate screen have separate keyboard modes.
            restore.callback(self.write_text, _NO_FOCUS)
            if self._query_flags("") is not None:
                restore.callback(self.write_text, _POP_KEYBOARD)
                flags = self._query_flags(_PUSH_KEYBOARD)
                self.releases = flags is not None and bool(flags & _RELEASES)
            self._restore = restore.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._restore.close()

    # Input

    def read_events(self) -> list[TerminalEvent] | None:
        """Return the received events; None when the terminal is hung up."""
        try:
            data = os.read(self.fd_in, 4096)
        except OSError:
            return None
        return self._parser.parse_bytes(data) if data else None

    @property
    def is_incomplete(self) -> bool:
        """Whether a sequence is incomplete: call `expire_sequence` after `ESCAPE_TIMEOUT_S` without more bytes."""
        return self._parser.is_incomplete

    def expire_sequence(self) -> list[TerminalEvent]:
        """Treat the incomplete sequence as finished."""
        return self._parser.expire_sequence()

    # Output

    def get_size(self) -> tuple[int, int]:
        """Current number of columns and rows."""
        try:
            columns, rows = os.get_terminal_size(self._fd_out)
        except OSError:
            return 80, 24
        return columns or 80, rows or 24

    def show_image(self, image: RenderableType) -> None:
        """Fill the screen; content that is too long or too wide is cut off."""
        columns, rows = self.get_size()
        self._image.seek(0)
        self._image.truncate()
        self._console.print(image, width=columns, overflow="ellipsis")
        lines = self._image.getvalue().splitlines()[:rows]
        self.write_text(_HOME + f"{_REST_OF_LINE}\r\n".join(lines) + _REST_OF_LINE + _REST_OF_SCREEN)

    def write_text(self, text: str) -> None:
        """Write all of it, or nothing when the terminal is hung up."""
        data = text.encode(sys.stdout.encoding or "utf-8", sys.stdout.errors or "strict")
        with contextlib.suppress(OSError):
            while data:
                data = data[os.write(self._fd_out, data) :]

    # Inside

    def _query_flags(self, first: str) -> int | None:
        """Query the flags of the keyboard protocol after writing `first`; None where the terminal does not support
        it, or never replies."""
        self.write_text(first + _ASK_KEYBOARD + _ASK_DEVICE)
        flags: int | None = None
        give_up_s = time.monotonic() + REPLY_TIMEOUT_S
        while (left_s := give_up_s - time.monotonic()) > 0:
            if not select.select([self.fd_in], [], [], left_s)[0]:
                break
            events = self.read_events()
            if events is None:
                break
            for event in events:
                if isinstance(event, KeyboardFlags):
                    flags = event.flags
                elif isinstance(event, DeviceAttributes):
                    return flags
        return flags
