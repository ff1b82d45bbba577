"""The bytes of one controller on a serial line: a command written, its reply read until it is complete, separated from
what programs print."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from adapters.yaskawa.language.numbers import parse_error_code
from adapters.yaskawa.smc2000.line import SharedSerialLine
from adapters.yaskawa.smc2000.replies import SerialReply, parse_serial_reply
from adapters.yaskawa.wire.exchange import SmcCommandRefused, garbage_fault
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.link.base import Link
from orchestrator.model.errors import ControllerFault

T = TypeVar("T")

_MARK = 0x80
LONGEST_REPLY = 10_000
"""Characters: more than a listing of the longest program, the longest reply there is. Without a bound, bytes that
never end would keep a reading waiting, and the state would stay as it was before them."""


@dataclass(frozen=True, slots=True)
class LineTiming:
    """Times on a serial line.

    silence_s: silence for this long is a timeout.
    hold_ns: longest time for which a serial adapter buffers received bytes.
    tolerance: largest relative deviation of a baud rate."""

    silence_s: float
    hold_ns: int
    tolerance: float


class SerialExchange:
    """The exchanges with one controller, in its turns. unit: its address in a chain, None for a controller alone."""

    def __init__(self, line: SharedSerialLine, link: Link, clock: Clock, unit: int | None, timing: LineTiming) -> None:
        self._line = line
        self._link = link
        self._clock = clock
        self._unit = unit
        self.silence_ns = round(timing.silence_s * NS_PER_S) + timing.hold_ns
        self.hold_ns = timing.hold_ns
        self._least_char_ns = link.char_ns * (1 - timing.tolerance)
        self.plain: bytearray = bytearray()
        self.marked: bytearray = bytearray()
        self.at_ns = 0
        """When the last bytes arrived."""
        self.settled = False
        """Whether the controller has the settings of this session."""

    async def run(
        self, command: str, whole: Callable[[], T | None], opening: str = "", room: int = 0, most: int = LONGEST_REPLY
    ) -> tuple[T, int]:
        """Write a command and read until `whole` finds its complete reply; return it with the instant of writing.

        room: length of text that may precede the reply. most: characters of the reply; more of them are none.
        """
        self.reset_buffer()
        data = (opening + command + ("\r" if command[:1] >= " " else "")).encode("latin-1")
        sent_ns = self._link.write(data)
        quiet_ns = sent_ns + (len(data) + room) * self._link.char_ns
        return await self._read_until(command, whole, quiet_ns, room + most), sent_ns

    async def _read_until(self, command: str, whole: Callable[[], T | None], quiet_ns: int, most: int) -> T:
        """Read until `whole` returns a result. quiet_ns: silence is allowed until then; after that, and between bytes,
        silence is a timeout. most: characters of a reply; raises `ControllerFault` for more of them."""
        byte_count = 0
        while True:
            answer = whole()
            if answer is not None:
                self._line.answered = True
                return answer
            if byte_count > most:
                raise garbage_fault(
                    self._link, command, f"a reply of at most {most} characters", f"{byte_count} of them"
                )
            left_ns = max(quiet_ns, self.at_ns) + self.silence_ns - self._clock.now_ns()
            try:
                async with asyncio.timeout(max(left_ns, 0) / NS_PER_S):
                    chunk = await self._link.read()
            except TimeoutError:
                raise self.silence_fault(command) from None
            byte_count += len(chunk.data)
            self.plain += chunk.data
            self.at_ns = chunk.at_ns

    def reset_buffer(self, plain: bytes = b"", marked: bytes = b"") -> None:
        """Clear the input buffer; it then contains these bytes."""
        self.plain = bytearray(plain)
        self.marked = bytearray(marked)

    def parse_buffer(self) -> SerialReply | None:
        """Return the whole reply to a command, if complete."""
        self.separate_output()
        reply = parse_serial_reply(self.plain)
        if reply is None:
            return None
        del self.plain[: reply.used]
        if reply.echoed:
            # Only a controller that was reset echoes; its settings are loaded again.
            self.settled = False
        for line in reply.lines:
            if not (line.isascii() and line.isprintable()):
                raise garbage_fault(self._link, "a command", "text", repr(line[:40]))
        return reply

    def separate_output(self) -> None:
        """Separate program output from replies."""
        if any(byte & _MARK for byte in self.plain):
            self.marked += bytes(byte & ~_MARK for byte in self.plain if byte & _MARK)
            self.plain[:] = bytes(byte for byte in self.plain if not byte & _MARK)

    def begun_ns(self, sent_ns: int, characters: int) -> int:
        """Return the earliest instant at which the last of the characters written at `sent_ns` can have arrived."""
        return sent_ns + round(characters * self._least_char_ns)

    def emitted_ns(self, characters: int) -> int:
        """Return the latest instant at which the first of `characters` characters, of which the last have just arrived,
        was sent."""
        return self.at_ns - round(characters * self._least_char_ns)

    async def write_slowly(self, text: str) -> None:
        """Write a line of a program; return when it has been sent as a whole."""
        data = text.encode("ascii") + b"\r"
        self._link.write(data)
        await self.wait_for_quiet(len(data) * self._link.char_ns, text)

    async def wait_for_quiet(self, duration_ns: int, text: str) -> None:
        """Wait for silence: a download is silent until its end (L8205); anything received meanwhile is a refusal."""
        until_ns = self._clock.now_ns() + duration_ns
        try:
            while True:
                async with asyncio.timeout(max(until_ns - self._clock.now_ns(), 0) / NS_PER_S):
                    chunk = await self._link.read()
                if b"?" in chunk.data:
                    raise SmcCommandRefused(text, 0, "the program is not accepted")
        except TimeoutError:
            return

    async def query_refusal(self, command: str) -> SmcCommandRefused:
        """Return why the selected controller has refused a command, by its error code (TC)."""
        reply, _ = await self.run("TC1", self.parse_buffer)
        words = reply.lines[-1] if reply.lines and not reply.refused else ""
        code = parse_error_code(words)
        if code is None:
            raise garbage_fault(self._link, "TC1", "an error code with its text", repr(words))
        self._line.in_step = True
        return SmcCommandRefused(command, code, words if code else "no reason given")

    def silence_fault(self, command: str) -> ControllerFault:
        received_text = f"only {bytes(self.plain + self.marked)!r}" if self.plain or self.marked else "nothing"
        origin = "" if self._unit is None else f" from the controller with address {self._unit}"
        remedy = "check power and cable; does another program occupy the controller's interpreter?"
        if self._unit is None:
            remedy += " If it is part of a daisy chain, set `address` in its link."
        elif not self._line.answered:
            remedy = "no controller of the chain answers: is the first one, next to this computer, switched on?"
        else:
            remedy += " A controller that is off disconnects all controllers that follow it in the chain."
        return ControllerFault(
            "no-answer", f"{self._link.endpoint}: {received_text} came{origin} after {command!r}", remedy
        )
