"""A process on a terminal of its own, for tests and measurements: it accepts key presses, and its screen can be
read.

The terminal answers like a real one: with `releases` it supports the kitty keyboard protocol, which reports the
release of a held key; without, it is a plain one, where a held key only repeats.
"""

import fcntl
import os
import re
import select
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Mapping, Sequence

from orchestrator.clock.live import raw_ns

END_TIMEOUT_S = 10.0
# The child makes the terminal its controlling terminal, so that it gets SIGHUP when the terminal closes.
_TAKE_TERMINAL = "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
_ESCAPE = re.compile(r"\x1b\[[0-9;:<=>?]*[ -/]*[@-~]")
_FRAME = "\x1b[H"
_QUERY = re.compile(r"\x1b\[(?P<ask>\?u)|\x1b\[(?P<device>c)|\x1b\[>(?P<push>\d+)u|\x1b\[(?P<pop><u)")
_MAX_QUERY_LENGTH = 8
MAX_OUTPUT = 65536  # characters of its output that are kept; one screen has two thousand
POLL_S = 0.02  # a blocking read would prevent closing the terminal
ARROWS = {"up": "A", "down": "B", "right": "C", "left": "D"}


class TerminalProcess:
    """`python -c code` with `arguments` on a new terminal of `size` (columns, rows)."""

    def __init__(
        self,
        code: str,
        arguments: Sequence[str],
        environment: Mapping[str, str] | None = None,
        size: tuple[int, int] = (80, 24),
        *,
        releases: bool,
    ) -> None:
        columns, rows = size
        self.releases = releases
        self._keyboards: list[int] = [0]
        self._said = ""
        self._heard = 0
        self._seen = threading.Lock()
        self._master, slave = os.openpty()
        try:
            fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
            self.before = termios.tcgetattr(slave)
            self.process = subprocess.Popen(
                [sys.executable, "-c", _TAKE_TERMINAL + code, *arguments],
                stdin=slave,
                stdout=slave,
                stderr=slave,
                start_new_session=True,
                env={**os.environ, "TERM": "xterm-256color", **(environment or {})},
            )
        finally:
            os.close(slave)
        self._unplugged = threading.Event()
        self._reader = threading.Thread(target=self._read_output, daemon=True)
        self._reader.start()

    # Keys

    def type_text(self, text: str) -> int:
        """Type bytes; return the host time (ns) just before."""
        at_ns = raw_ns()
        os.write(self._master, text.encode())
        return at_ns

    def press_arrow(self, arrow: str) -> int:
        """Press an arrow key; a plain terminal sends the same for each repeat. Return the host time (ns) just
        before."""
        return self.type_text(f"\x1b[{ARROWS[arrow]}")

    def repeat_arrow(self, arrow: str) -> int:
        """Repeat a held arrow key."""
        return self.type_text(f"\x1b[1;1:2{ARROWS[arrow]}" if self.releases else f"\x1b[{ARROWS[arrow]}")

    def release_arrow(self, arrow: str) -> int:
        """Release an arrow key; only with `releases`."""
        return self.type_text(f"\x1b[1;1:3{ARROWS[arrow]}")

    # Output

    @property
    def recent_output(self) -> str:
        """The last output, with all control sequences."""
        with self._seen:
            return self._said

    @property
    def screen_text(self) -> str:
        """The last complete screen as text."""
        frames = self.recent_output.split(_FRAME)
        return _ESCAPE.sub("", frames[-2] if len(frames) > 2 else "")

    @property
    def keyboard_flags(self) -> int:
        """Flags of the keyboard protocol that are switched on now."""
        return self._keyboards[-1]

    def terminal_mode(self) -> "list[int | list[bytes | int]]":
        """Current mode of the terminal; `before`: its mode when the process was started."""
        return termios.tcgetattr(self._master)

    # End

    def hang_up(self) -> None:
        """Disconnect the terminal."""
        if not self._unplugged.is_set():
            self._unplugged.set()
            self._reader.join()
            os.close(self._master)

    def wait(self, timeout_s: float = END_TIMEOUT_S) -> int:
        """Wait for the process to end by itself, and return its exit code. Raises `subprocess.TimeoutExpired`."""
        return self.process.wait(timeout_s)

    def kill(self) -> int:
        """Send `kill -9`; return the host time (ns) just before."""
        at_ns = raw_ns()
        self.process.kill()
        self.process.wait()
        return at_ns

    def close(self) -> None:
        """End the process, and close the terminal."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self.kill()
        self.hang_up()

    def _read_output(self) -> None:
        """Read its output, and answer its terminal queries."""
        while not self._unplugged.is_set():
            if not select.select([self._master], [], [], POLL_S)[0]:
                continue
            try:
                data = os.read(self._master, MAX_OUTPUT)
            except OSError:
                # The other side of the terminal is closed.
                return
            with self._seen:
                self._said += data.decode("utf-8", "replace")
                self._answer_queries()
                cut = max(0, len(self._said) - MAX_OUTPUT)
                self._said, self._heard = self._said[cut:], max(0, self._heard - cut)

    def _answer_queries(self) -> None:
        """Answer the terminal queries that are still open, as a terminal does."""
        while question := _QUERY.search(self._said, self._heard):
            self._heard = question.end()
            if question["device"]:
                self.type_text("\x1b[?62;22c")
            elif not self.releases:
                continue
            elif question["ask"]:
                self.type_text(f"\x1b[?{self.keyboard_flags}u")
            elif question["push"]:
                self._keyboards.append(int(question["push"]))
            elif len(self._keyboards) > 1:
                self._keyboards.pop()
        self._heard = max(self._heard, len(self._said) - _MAX_QUERY_LENGTH)
