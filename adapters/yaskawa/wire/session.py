"""One handle of the controller: request and reply lines, and the resynchronisation after a disturbance.

A reply is any number of data lines, each ended by CR LF, and a prompt: `:` for accepted, `?` for refused (L1629-1633).
The prompt is at the start of a line. Replies have no checksum and no number, so exactly one packet is under way at a
time (L1738-1739). It contains one command, or settings that belong together, each on a line of its own (L1741): this
avoids the question whether a line of several commands gets one prompt or several. Unsolicited text comes as whole lines
before a reply and is kept apart.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from adapters.contract import NULL_LOG
from adapters.yaskawa.language.dialect import MAX_LINE
from adapters.yaskawa.language.numbers import parse_error_code, parse_numbers
from adapters.yaskawa.language.words import REMEDIES
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.base import Link
from orchestrator.model.errors import ControllerFault, Refusal

MAX_PACKET = 470  # bytes (L1735)
OPERANDS_OF_LINE = (MAX_LINE - len("MG ")) // len('_SPX{F10.0},",",')
TAG_CHARACTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
# Settings with a fractional part
FRACTIONS = ("_IT", "_MT", "_PF", "_GR", "_KP", "_KI", "_KD", "_KS", "_FA", "_OF", "_TL", "_TK", "_IL", "_PL", "_NF")
DOWNLOAD_REFUSED_S = 0.25  # the latest time of a refusal of a download
PACKET_PAUSE_S = 0.02  # a download is not acknowledged packet by packet
END_OF_DATA = "\x1a"  # control Z, of programs and arrays (L4134, L8552, L9116)
_REVISION = "\x12\x15\r"  # control R control U (L9721)

T = TypeVar("T")


class SmcCommandRefused(Refusal):
    """The controller answered a command with `?`. `number` is its error code (TC)."""

    def __init__(self, command: str, number: int, words: str) -> None:
        super().__init__("refused", f"the controller refuses {command!r}: {words}", REMEDIES.get(number, ""))
        self.number = number


@dataclass(frozen=True, slots=True)
class CommandReply:
    """The result of an exchange: the data lines (or one binary record), and the host instants of request and reply."""

    lines: list[str]
    record: bytes
    sent_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class _Parsed:
    """A complete reply at the start of a buffer, `used` bytes of it."""

    lines: list[str]
    refused: bool
    used: int


class CommandSession:
    """Exchanges over one link, one at a time."""

    def __init__(self, link: Link, timeout_s: float, tag: str = "") -> None:
        """tag: of the markers, see `session_tag`."""
        self.log = NULL_LOG
        self._tag = tag
        self._link = link
        self._timeout_s = timeout_s
        self._buffer = bytearray()
        self._turn = asyncio.Lock()
        self._at_ns = 0
        self._markers = 0
        # Until a marker has come back, replies to an earlier client's command may be under way.
        self._in_step = False
        self._written_at_once = False
        self.unsolicited: deque[str] = deque(maxlen=20)

    async def send_command(self, command: str, before_send: Callable[[], None] | None = None) -> None:
        """Send a command without data in its reply. Raises `SmcCommandRefused`."""
        await self.query_lines(command, 0, before_send)

    async def send_settings(self, commands: Iterable[str], before_send: Callable[[], None] | None = None) -> int:
        """Send settings in one turn: each has its own prompt, and a refused one does not prevent the others. Return the
        instant at which the last ones were written.

        Raises `SmcCommandRefused` for the last refused one, whose reason the controller still has.
        """
        answers, sent_ns = await self._send_packets(commands, before_send)
        for lines in answers:
            self.unsolicited.extend(lines)
        return sent_ns

    async def set_and_read(self, commands: Sequence[str], operands: Sequence[str], then: str) -> list[float]:
        """Send settings, read any number of operands after them, as `read_numbers` does, and send `then` after those,
        all in one turn.

        Raises `SmcCommandRefused` for a refused setting or `then`.
        """
        parts = [operands[at : at + OPERANDS_OF_LINE] for at in range(0, len(operands), OPERANDS_OF_LINE)]
        messages = [print_command(part) for part in parts]
        values: list[float] = []
        answers, _ = await self._send_packets([*commands, *messages, then])
        for lines in answers[: len(commands)]:
            self.unsolicited.extend(lines)
        for part, command, lines in zip(parts, messages, answers[len(commands) :], strict=False):
            self.unsolicited.extend(lines[:-1])
            values += parse_numbers("".join(lines[-1:]), len(part), command)
        return values

    async def read_many(self, operands: Sequence[str]) -> list[float]:
        """Return the values of any number of operands, as `read_numbers` does, with as few packets as possible. Raises
        `SmcCommandRefused`."""
        parts = pack_operands(operands)
        messages = [print_command(part) for part in parts]
        answers, _ = await self._send_packets(messages)
        values: list[float] = []
        for part, command, lines in zip(parts, messages, answers, strict=True):
            self.unsolicited.extend(lines[:-1])
            values += parse_numbers("".join(lines[-1:]), len(part), command)
        return values

    async def sums_to_zero(self, terms: Sequence[str]) -> bool:
        """Return whether all of these terms, none of which is negative, are 0: by their sum, a single number on the
        wire."""
        for part in pack_texts(terms, lambda part: len(print_command([_sum_expression(part)]))):
            (total,), _ = await self.read_numbers(_sum_expression(part))
            if total:
                return False
        return True

    async def _send_packets(
        self, commands: Iterable[str], before_send: Callable[[], None] | None = None
    ) -> tuple[list[list[str]], int]:
        """Send some commands, as many per packet as fit; return the lines that answer each, and when the last packet
        was written."""
        answers: list[list[str]] = []
        sent_ns = 0
        async with self._turn:
            await self._resynchronise()
            if before_send is not None:
                before_send()
            for packet in _group_packets(commands):
                replies: list[_Parsed] = []

                def all_replies(packet: list[str] = packet, replies: list[_Parsed] = replies) -> _Parsed | None:
                    replies.clear()
                    used = 0
                    for _ in packet:
                        reply = parse_reply(self._buffer[used:])
                        if reply is None:
                            return None
                        replies.append(reply)
                        used += reply.used
                    lines = [line for reply in replies for line in reply.lines]
                    return _Parsed(lines, any(reply.refused for reply in replies), used)

                _, sent_ns = await self._run_exchange("\r".join(packet), all_replies)
                refused_commands = [command for command, reply in zip(packet, replies, strict=True) if reply.refused]
                if refused_commands:
                    raise await self._read_refusal(refused_commands[-1])
                self._in_step = True
                answers += (reply.lines for reply in replies)
        return answers, sent_ns

    async def query_lines(
        self, command: str, lines: int = 1, before_send: Callable[[], None] | None = None
    ) -> CommandReply:
        """Send a command whose reply ends with `lines` data lines. Raises `SmcCommandRefused`, `ControllerFault`,
        `LinkClosed`.

        before_send: called when it is the command's turn; if it raises, nothing is sent.
        """
        async with self._turn:
            await self._resynchronise()
            if before_send is not None:
                before_send()
            reply, sent_ns = await self._run_exchange(command, lambda: parse_reply(self._buffer))
            if reply.refused:
                raise await self._read_refusal(command)
            self._in_step = True
            if len(reply.lines) < lines:
                raise self._garbage_fault(command, f"{lines} lines", repr(reply.lines))
            split = len(reply.lines) - lines
            self.unsolicited.extend(reply.lines[:split])
            return CommandReply(reply.lines[split:], b"", sent_ns, self._at_ns)

    async def query_all(self, command: str) -> list[str]:
        """Send a command whose reply has any number of data lines. On a serial port, where a listing takes seconds,
        only silence is a timeout."""
        async with self._turn:
            await self._resynchronise()
            by_silence = bool(self._link.char_ns)
            reply, _ = await self._run_exchange(command, lambda: parse_reply(self._buffer), by_silence=by_silence)
            if reply.refused:
                raise await self._read_refusal(command)
            self._in_step = True
            return reply.lines

    async def read_revision(self) -> str:
        """Return the firmware's revision. The carriage return after the two bytes is part of the command or one of its
        own, with another prompt (the manual is silent): the next exchange discards it."""
        async with self._turn:
            await self._resynchronise()
            reply, _ = await self._run_exchange(_REVISION, lambda: parse_reply(self._buffer), terminated=True)
            if reply.refused:
                raise await self._read_refusal("control R control U")
            self._buffer.clear()
            return " ".join(reply.lines)

    async def query_record(self, command: str, header: bytes, length: int, also: str = "") -> CommandReply:
        """Send a command that is answered by a binary record of `length` bytes that begins with `header`, and a prompt.

        also: a command in the same packet, with data lines in its reply. The answer's instants are those of the record.
        """
        async with self._turn:
            await self._resynchronise()
            record: bytes | None = None
            received_ns = 0

            def find_whole_reply() -> _Parsed | None:
                nonlocal record, received_ns
                if record is None:
                    record, received_ns = self._take_record(command, header, length), self._at_ns
                    if record is None:
                        return None
                return parse_reply(self._buffer) if also else _Parsed([], refused=False, used=0)

            reply, sent_ns = await self._run_exchange(f"{command}\r{also}" if also else command, find_whole_reply)
            if not record:
                raise await self._read_refusal(command)
            if reply.refused:
                raise await self._read_refusal(also)
            self._in_step = True
            return CommandReply(reply.lines, record, sent_ns, received_ns)

    def _take_record(self, command: str, header: bytes, length: int) -> bytes | None:
        """Take the record from the buffer and return it; None: it is not complete; b"": the command was refused."""
        at = self._buffer.find(header)
        if at < 0:
            text = bytes(self._buffer).lstrip(b"\r\n")
            if text[:1] == b"?" and not text[1:2].isdigit():
                self._buffer[:] = text[1:]
                return b""
            if len(text) >= length:
                raise self._garbage_fault(command, f"a record that begins with {header.hex(' ')}", text[:16].hex(" "))
            return None
        if len(self._buffer) <= at + length:
            return None
        if self._buffer[at + length] != ord(":"):
            end = bytes(self._buffer[at + length :])
            raise self._garbage_fault(command, f"`:` after {length} bytes", repr(end[:16]))
        record = bytes(self._buffer[at : at + length])
        if at:
            self.unsolicited.append(self._buffer[:at].decode("latin-1").strip())
        del self._buffer[: at + length + 1]
        return record

    def write_at_once(self, *commands: str) -> None:
        """Write at once, whatever is under way, each command in a packet of its own; the replies are assigned later."""
        self._written_at_once = True
        write_each(self._link, commands)

    async def download_program(self, lines: tuple[str, ...]) -> None:
        """Replace the program (DL, L4128): no prompt until control Z ends it."""
        async with self._turn:
            await self._resynchronise()
            self._in_step = False
            self._link.write(b"DL\r")
            # A refused download must be detected before its lines are sent: they would be executed as commands.
            if await self._anything_within(DOWNLOAD_REFUSED_S):
                raise await self._read_refusal("DL")
            packet = b""
            for line in lines:
                data = line.encode("ascii") + b"\r"
                if len(packet) + len(data) > MAX_PACKET:
                    self._link.write(packet)
                    # On a serial port the packets must not pile up: they would delay everything else by seconds.
                    if await self._anything_within(PACKET_PAUSE_S + self._wire_s(packet)):
                        self._link.write(b"\x1a")
                        raise await self._read_refusal("DL")
                    packet = b""
                packet += data
            self._link.write(packet)
            await self._anything_within(self._wire_s(packet))
            reply, _ = await self._run_exchange(END_OF_DATA, lambda: parse_reply(self._buffer))
            if reply.refused:
                raise await self._read_refusal("DL")
            self._in_step = True

    async def load_array(self, name: str, first: int, values: Sequence[int]) -> None:
        """Fill elements of an array from `first` on (QD, L8545). Command and elements must fit into one packet, in
        which they are sent: two consecutive packets may be joined in transit (L1735).

        There is no pause before the data: if QD is refused, they are lines of numbers, which are not commands.
        """
        async with self._turn:
            await self._resynchronise()
            command = f"QD {name}[],{first},{first + len(values) - 1}"
            data = f"{command}\r" + "\r\n".join(map(str, values)) + END_OF_DATA
            reply, _ = await self._run_exchange(data, lambda: parse_reply(self._buffer), terminated=True)
            if reply.refused:
                raise await self._read_refusal(command)
            self._in_step = True

    async def read_array(self, name: str, first: int, last: int) -> list[int]:
        """Return elements of an array, as whole numbers (QU, L9105): separated by commas, followed by a control Z and
        the prompt."""

        def find_whole_reply() -> str | None:
            text = bytes(self._buffer).decode("latin-1")
            body, end, remainder = text.partition(END_OF_DATA)
            if not end:
                return "?" if text.strip() == "?" else None
            if not remainder.endswith(":"):
                return None
            self._buffer.clear()
            return body

        async with self._turn:
            await self._resynchronise()
            command = f"QU {name}[],{first},{last},1"
            body, _ = await self._run_exchange(command, find_whole_reply)
            if body == "?":
                raise await self._read_refusal(command)
            self._in_step = True
            return [int(value) for value in parse_numbers(body, last - first + 1, command)]

    def _wire_s(self, data: bytes) -> float:
        """Return how long data is on the wire of a serial port, s."""
        return len(data) * self._link.char_ns / NS_PER_S

    async def _anything_within(self, seconds: float) -> bool:
        try:
            async with asyncio.timeout(seconds):
                self._buffer += (await self._link.read()).data
        except TimeoutError:
            return False
        return True

    async def _run_exchange(
        self, command: str, whole: Callable[[], T | None], *, terminated: bool = False, by_silence: bool = False
    ) -> tuple[T, int]:
        """Write a command and read until `whole` finds its complete reply; return it with the instant of writing.

        terminated: the command includes its terminator, and needs no carriage return. by_silence: the timeout begins
        again with each piece of the reply.
        """
        self._in_step = False
        if self._buffer:
            self.unsolicited.append(self._buffer.decode("latin-1").strip())
            self._buffer.clear()
        data = command.encode("latin-1")
        if not terminated and command != END_OF_DATA:
            data += b"\r"
        sent_ns = self._link.write(data)
        try:
            async with asyncio.timeout(self._timeout_s + self._wire_s(data)) as limit:
                while True:
                    chunk = await self._link.read()
                    self._buffer += chunk.data
                    self._at_ns = chunk.at_ns
                    if by_silence:
                        limit.reschedule(asyncio.get_running_loop().time() + self._timeout_s)
                    reply = whole()
                    if reply is not None:
                        if isinstance(reply, _Parsed):
                            del self._buffer[: reply.used]
                            self._check_text(command, reply.lines)
                        return reply, sent_ns
        except TimeoutError:
            received_text = f"only {bytes(self._buffer)!r}" if self._buffer else "nothing"
            raise ControllerFault(
                "no-answer",
                f"{self._link.endpoint}: {received_text} came within {self._timeout_s:g} s after {command!r}",
                "check power and cable; does another program occupy the controller's interpreter?",
            ) from None

    async def _read_refusal(self, command: str) -> SmcCommandRefused:
        """Query the reason of a refusal (TC1, L10254): code and text."""
        reply, _ = await self._run_exchange("TC1", lambda: parse_reply(self._buffer))
        words = reply.lines[-1] if reply.lines and not reply.refused else ""
        code = parse_error_code(words)
        if code is None:
            raise self._garbage_fault("TC1", "an error code with its text", repr(words))
        self._in_step = True
        return SmcCommandRefused(command, code, words if code else "no reason given")

    async def _resynchronise(self) -> None:
        """Flush a half-typed command, and discard everything up to the reply of a marker that is new each time."""
        if self._in_step and not self._written_at_once:
            return
        self._written_at_once = False
        self._markers += 1
        marker = f"<{self._tag}{self._markers}>"
        end = marker.encode() + b"\r\n:"

        def find_marker() -> bool | None:
            at = self._buffer.find(end)
            if at < 0:
                return None
            del self._buffer[: at + len(end)]
            return True

        self._link.write(b"\\\r")
        await self._run_exchange(f'MG "{marker}"', find_marker)
        self._buffer.clear()
        self._in_step = True
        self.log.info("the session is synchronised", place=self._link.endpoint)

    def _check_text(self, command: str, lines: list[str]) -> None:
        for line in lines:
            if not (line.isascii() and line.isprintable()):
                raise self._garbage_fault(command, "a line of text", repr(line))

    def _garbage_fault(self, command: str, expected: str, got: str) -> ControllerFault:
        self._in_step = False
        return ControllerFault(
            "garbage",
            f"{self._link.endpoint}: after {command!r} expected {expected}, got {got}",
            "check cable and address: is this an SMC controller, and is this port free of other clients?",
        )

    async def read_numbers(self, *operands: str) -> tuple[list[float], CommandReply]:
        """Return the values of operands, variables or expressions, read in one command, with up to four decimals."""
        command = print_command(operands)
        answer = await self.query_lines(command)
        return parse_numbers(answer.lines[0], len(operands), command), answer


def session_tag(now_ns: int) -> str:
    """Return two characters that distinguish the markers of a session from those of the last one on the same port: a
    trippoint of a former client may delay its answers until this session reads (L1696)."""
    number = now_ns // NS_PER_MS % len(TAG_CHARACTERS) ** 2
    return TAG_CHARACTERS[number // len(TAG_CHARACTERS)] + TAG_CHARACTERS[number % len(TAG_CHARACTERS)]


def print_command(operands: Sequence[str]) -> str:
    """Return the command that prints the operands: with an explicit format (L7558), because a user may have set any;
    with commas between the values, because the sign column alone may not separate them."""
    return "MG " + ',",",'.join(f"{operand}{{F10.{_operand_decimals(operand)}}}" for operand in operands)


def _operand_decimals(operand: str) -> int:
    """Return the decimals of an operand: only a few settings have a fractional part."""
    return 4 if operand[:3] in FRACTIONS else 0


def _sum_expression(terms: Sequence[str]) -> str:
    """Return the sum of `terms` in units of 1/65536, the smallest difference that two numbers can have (L15710)."""
    return f"({'+'.join(terms)})*65536"


def pack_operands(operands: Sequence[str]) -> list[list[str]]:
    """Split operands into lines of `print_command`."""
    return pack_texts(operands, lambda part: len(print_command(part)))


def pack_texts(texts: Sequence[str], length: Callable[[Sequence[str]], int]) -> list[list[str]]:
    """Split texts into as few lines as possible. length: of the command that contains them, characters."""
    lines: list[list[str]] = []
    for text in texts:
        if not lines or length([*lines[-1], text]) > MAX_LINE:
            lines.append([])
        lines[-1].append(text)
    return lines


def parse_reply(buffer: bytes | bytearray) -> _Parsed | None:
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
            return _Parsed(lines, refused=False, used=at + 1)
        elif first == 0x3F and not buffer[at + 1 : at + 2].isdigit():
            return _Parsed(lines, refused=True, used=at + 1)
        else:
            end = buffer.find(b"\r\n", at)
            if end < 0:
                return None
            lines.append(buffer[at:end].decode("latin-1").strip())
            at = end + 2
    return None


def _group_packets(commands: Iterable[str]) -> Iterator[list[str]]:
    """Group commands into packets, as many as fit in each."""
    packet: list[str] = []
    for command in commands:
        if packet and sum(len(packet_command) + 1 for packet_command in packet) + len(command) + 1 > MAX_PACKET:
            yield packet
            packet = []
        packet.append(command)
    if packet:
        yield packet


def write_each(link: Link, commands: Iterable[str]) -> None:
    """Write each command in a packet of its own, so that a refused one does not affect the others."""
    for command in commands:
        link.write(command.encode("ascii") + b"\r")
