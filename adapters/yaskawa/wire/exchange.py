"""One packet and its reply on a handle, read until it is complete; and the way back into step after a disturbance."""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from adapters.yaskawa.language.numbers import parse_error_code
from adapters.yaskawa.language.words import REMEDIES
from orchestrator.clock.base import NS_PER_S
from orchestrator.link.base import Link
from orchestrator.model.errors import ControllerFault, Refusal

END_OF_DATA = "\x1a"  # control Z, of programs and arrays (L4134, L8552, L9116)

T = TypeVar("T")


class SmcCommandRefused(Refusal):
    """The controller answered a command with `?`. `number` is its error code (TC)."""

    def __init__(self, command: str, number: int, words: str) -> None:
        super().__init__("refused", f"the controller refuses {command!r}: {words}", REMEDIES.get(number, ""))
        self.number = number


@dataclass(frozen=True, slots=True)
class ParsedReply:
    """A complete reply at the start of a buffer, `used` bytes of it."""

    lines: list[str]
    refused: bool
    used: int


class PacketExchange:
    """The packets of one handle, and what has arrived of their replies. tag: of the markers, see `session_tag`."""

    def __init__(self, link: Link, timeout_s: float, tag: str) -> None:
        self._tag = tag
        self._link = link
        self._timeout_s = timeout_s
        self.buffer = bytearray()
        self.at_ns = 0
        """When the last piece of a reply arrived."""
        self._markers = 0
        # Until a marker has come back, replies to an earlier client's command may be under way.
        self.in_step = False
        self.written_at_once = False
        """A stop was written whose reply is not assigned yet."""
        self.unsolicited: deque[str] = deque(maxlen=20)

    def find_reply(self) -> ParsedReply | None:
        """Return the complete reply that has arrived, or None."""
        return parse_reply(self.buffer)

    async def run(
        self, command: str, whole: Callable[[], T | None], *, terminated: bool = False, by_silence: bool = False
    ) -> tuple[T, int]:
        """Write a command and read until `whole` finds its complete reply; return it with the instant of writing.

        terminated: the command includes its terminator, and needs no carriage return. by_silence: the timeout begins
        again with each piece of the reply.
        """
        self.in_step = False
        if self.buffer:
            self.unsolicited.append(self.buffer.decode("latin-1").strip())
            self.buffer.clear()
        data = command.encode("latin-1")
        if not terminated and command != END_OF_DATA:
            data += b"\r"
        sent_ns = self._link.write(data)
        try:
            async with asyncio.timeout(self._timeout_s + self.wire_s(data)) as limit:
                while True:
                    chunk = await self._link.read()
                    self.buffer += chunk.data
                    self.at_ns = chunk.at_ns
                    if by_silence:
                        limit.reschedule(asyncio.get_running_loop().time() + self._timeout_s)
                    reply = whole()
                    if reply is not None:
                        if isinstance(reply, ParsedReply):
                            del self.buffer[: reply.used]
                            self._check_text(command, reply.lines)
                        return reply, sent_ns
        except TimeoutError:
            received_text = f"only {bytes(self.buffer)!r}" if self.buffer else "nothing"
            raise ControllerFault(
                "no-answer",
                f"{self._link.endpoint}: {received_text} came within {self._timeout_s:g} s after {command!r}",
                "check power and cable; does another program occupy the controller's interpreter?",
            ) from None

    async def read_refusal(self, command: str) -> SmcCommandRefused:
        """Query the reason of a refusal (TC1, L10254): code and text."""
        reply, _ = await self.run("TC1", self.find_reply)
        words = reply.lines[-1] if reply.lines and not reply.refused else ""
        code = parse_error_code(words)
        if code is None:
            raise self.make_garbage_fault("TC1", "an error code with its text", repr(words))
        self.in_step = True
        return SmcCommandRefused(command, code, words if code else "no reason given")

    async def resynchronise(self) -> bool:
        """Flush a half-typed command, and discard everything up to the reply of a marker that is new each time; return
        whether that was necessary."""
        if self.in_step and not self.written_at_once:
            return False
        self.written_at_once = False
        self._markers += 1
        marker = f"<{self._tag}{self._markers}>"
        end = marker.encode() + b"\r\n:"

        def find_marker() -> bool | None:
            at = self.buffer.find(end)
            if at < 0:
                return None
            del self.buffer[: at + len(end)]
            return True

        self._link.write(b"\\\r")
        await self.run(f'MG "{marker}"', find_marker)
        self.buffer.clear()
        self.in_step = True
        return True

    def take_record(self, command: str, header: bytes, length: int) -> bytes | None:
        """Take the record from the buffer and return it; None: it is not complete; b"": the command was refused."""
        at = self.buffer.find(header)
        if at < 0:
            text = bytes(self.buffer).lstrip(b"\r\n")
            if text[:1] == b"?" and not text[1:2].isdigit():
                self.buffer[:] = text[1:]
                return b""
            if len(text) >= length:
                raise self.make_garbage_fault(
                    command, f"a record that begins with {header.hex(' ')}", text[:16].hex(" ")
                )
            return None
        if len(self.buffer) <= at + length:
            return None
        if self.buffer[at + length] != ord(":"):
            end = bytes(self.buffer[at + length :])
            raise self.make_garbage_fault(command, f"`:` after {length} bytes", repr(end[:16]))
        record = bytes(self.buffer[at : at + length])
        if at:
            self.unsolicited.append(self.buffer[:at].decode("latin-1").strip())
        del self.buffer[: at + length + 1]
        return record

    async def anything_within(self, seconds: float) -> bool:
        """Return whether anything arrives within that time."""
        try:
            async with asyncio.timeout(seconds):
                self.buffer += (await self._link.read()).data
        except TimeoutError:
            return False
        return True

    def wire_s(self, data: bytes) -> float:
        """Return how long data is on the wire of a serial port, s."""
        return len(data) * self._link.char_ns / NS_PER_S

    def _check_text(self, command: str, lines: list[str]) -> None:
        for line in lines:
            if not (line.isascii() and line.isprintable()):
                raise self.make_garbage_fault(command, "a line of text", repr(line))

    def make_garbage_fault(self, command: str, expected: str, got: str) -> ControllerFault:
        """Return the fault of a reply that makes no sense; the session is out of step."""
        self.in_step = False
        return garbage_fault(self._link, command, expected, got)


def parse_reply(buffer: bytes | bytearray) -> ParsedReply | None:
    """Return the first complete reply in `buffer`, or None.

    A stray CR LF at the start of a line (some firmware sends one after `?`) and the control Z that ends a listing are
    skipped. `?` and a digit is not a prompt but the report of a program's error.
    """
    lines: list[str] = []
    at, size = 0, len(buffer)
    while at < size:
        first = buffer[at]
        if first in b"\r\n\x1a":
            at += 1
        elif first == 0x3A:
            return ParsedReply(lines, refused=False, used=at + 1)
        elif first == 0x3F and not buffer[at + 1 : at + 2].isdigit():
            return ParsedReply(lines, refused=True, used=at + 1)
        else:
            end = buffer.find(b"\r\n", at)
            if end < 0:
                return None
            lines.append(buffer[at:end].decode("latin-1").strip())
            at = end + 2
    return None


def garbage_fault(link: Link, command: str, expected: str, got: str) -> ControllerFault:
    """Return the fault of a reply that makes no sense."""
    return ControllerFault(
        "garbage",
        f"{link.endpoint}: after {command!r} expected {expected}, got {got}",
        "check cable and address: is this an SMC controller, and is this port free of other clients?",
    )
