"""Frames of a link in words, for `tutti trace`: what a make's decoder provides, and parts of decoders for text lines.

A decoder gets the recorded bytes of a link in their order and returns the frames that they complete. It reads the
traffic of all controllers of the link, and may begin in the middle of it. It never raises.
"""

from collections import deque
from collections.abc import Mapping
from typing import Literal, NamedTuple, Protocol

FrameDirection = Literal["out", "in"]

MAX_LINE_BYTES = 4000  # without an end: this is not text


class DecodedFrame(NamedTuple):
    """A frame: its bytes as text, its meaning (empty: unknown), and the address of its controller on a shared line."""

    text: str
    meaning: str = ""
    address: str = ""


class FrameDecoder(Protocol):
    """Decodes the bytes of one link."""

    def decode_bytes(self, direction: FrameDirection, data: bytes) -> list[DecodedFrame]:
        """Return the frames that `data` completes. Raises nothing."""
        ...


def printable_text(data: bytes) -> str:
    """Bytes as text; what is not printable as an escape sequence."""
    return data.decode("latin-1").encode("unicode_escape").decode("ascii")


class LineCutter:
    """Cuts bytes into lines without their ends. Empty lines are left out."""

    def __init__(self, ends: bytes = b"\r\n") -> None:
        """ends: each of these bytes ends a line."""
        self._table = bytes.maketrans(ends, b"\n" * len(ends))
        self._rest = b""

    def cut_lines(self, data: bytes) -> list[bytes]:
        """Return the lines that `data` completes; a piece that is too long for a line counts as one."""
        *lines, self._rest = (self._rest + data).translate(self._table).split(b"\n")
        if len(self._rest) > MAX_LINE_BYTES:
            lines.append(self._rest)
            self._rest = b""
        return [line for line in lines if line]


class TextDecoder:
    """Decodes text lines; a make derives from it and gives them a meaning."""

    def __init__(self, ends: bytes = b"\r\n") -> None:
        self._cutters = {"out": LineCutter(ends), "in": LineCutter(ends)}

    def decode_bytes(self, direction: FrameDirection, data: bytes) -> list[DecodedFrame]:
        """Return the lines that `data` completes."""
        describe = self.describe_sent if direction == "out" else self.describe_received
        return [describe(printable_text(line)) for line in self._cutters[direction].cut_lines(data)]

    def describe_sent(self, line: str) -> DecodedFrame:
        """A line to the controller."""
        return DecodedFrame(line)

    def describe_received(self, line: str) -> DecodedFrame:
        """A line of the controller."""
        return DecodedFrame(line)


def find_words(text: str, words: Mapping[str, str], longest: int) -> str:
    """The words for the longest of the beginnings in `words` that `text` has; empty without one."""
    return next((words[text[:size]] for size in range(longest, 0, -1) if text[:size] in words), "")


class PendingCommands:
    """What was sent and is not answered yet, the oldest first. A trace may begin in the middle, so it may be empty."""

    def __init__(self) -> None:
        self._texts: deque[str] = deque(maxlen=200)

    def note_sent(self, text: str) -> None:
        self._texts.append(text)

    def take_answered(self) -> str:
        """Take the oldest one; empty if there is none."""
        return self._texts.popleft() if self._texts else ""

    def clear(self) -> None:
        self._texts.clear()
