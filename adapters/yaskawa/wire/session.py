"""One handle of the controller: request and reply lines, and the resynchronisation after a disturbance.

A reply is any number of data lines, each ended by CR LF, and a prompt: `:` for accepted, `?` for refused (L1629-1633).
The prompt is at the start of a line. Replies have no checksum and no number, so exactly one packet is under way at a
time (L1738-1739). It contains one command, or settings that belong together, each on a line of its own (L1741): this
avoids the question whether a line of several commands gets one prompt or several. Unsolicited text comes as whole lines
before a reply and is kept apart.
"""

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from adapters.contract import NULL_LOG
from adapters.yaskawa.language.dialect import MAX_LINE
from adapters.yaskawa.language.numbers import parse_numbers
from adapters.yaskawa.wire.exchange import END_OF_DATA, PacketExchange, ParsedReply, parse_reply
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import Link

MAX_PACKET = 470  # bytes (L1735)
OPERANDS_OF_LINE = (MAX_LINE - len("MG ")) // len('_SPX{F10.0},",",')
TAG_CHARACTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
# Settings with a fractional part
FRACTIONS = ("_IT", "_MT", "_PF", "_GR", "_KP", "_KI", "_KD", "_KS", "_FA", "_OF", "_TL", "_TK", "_IL", "_PL", "_NF")
DOWNLOAD_REFUSED_S = 0.25  # the latest time of a refusal of a download
PACKET_PAUSE_S = 0.02  # a download is not acknowledged packet by packet
_REVISION = "\x12\x15\r"  # control R control U (L9721)

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class CommandReply:
    """The result of an exchange: the data lines (or one binary record), and the host instants of request and reply."""

    lines: list[str]
    record: bytes
    sent_ns: int
    received_ns: int


class CommandSession:
    """Exchanges over one link, one at a time."""

    def __init__(self, link: Link, timeout_s: float, tag: str = "") -> None:
        """tag: of the markers, see `session_tag`."""
        self.log = NULL_LOG
        self._link = link
        self._exchange = PacketExchange(link, timeout_s, tag)
        self._turn = asyncio.Lock()
        self.unsolicited = self._exchange.unsolicited

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
                replies: list[ParsedReply] = []

                def all_replies(packet: list[str] = packet, replies: list[ParsedReply] = replies) -> ParsedReply | None:
                    replies.clear()
                    used = 0
                    for _ in packet:
                        reply = parse_reply(self._exchange.buffer[used:])
                        if reply is None:
                            return None
                        replies.append(reply)
                        used += reply.used
                    lines = [line for reply in replies for line in reply.lines]
                    return ParsedReply(lines, any(reply.refused for reply in replies), used)

                _, sent_ns = await self._exchange.run("\r".join(packet), all_replies)
                refused_commands = [command for command, reply in zip(packet, replies, strict=True) if reply.refused]
                if refused_commands:
                    raise await self._exchange.read_refusal(refused_commands[-1])
                self._exchange.in_step = True
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
            reply, sent_ns = await self._exchange.run(command, self._exchange.find_reply)
            if reply.refused:
                raise await self._exchange.read_refusal(command)
            self._exchange.in_step = True
            if len(reply.lines) < lines:
                raise self._exchange.make_garbage_fault(command, f"{lines} lines", repr(reply.lines))
            split = len(reply.lines) - lines
            self.unsolicited.extend(reply.lines[:split])
            return CommandReply(reply.lines[split:], b"", sent_ns, self._exchange.at_ns)

    async def query_all(self, command: str) -> list[str]:
        """Send a command whose reply has any number of data lines. On a serial port, where a listing takes seconds,
        only silence is a timeout."""
        async with self._turn:
            await self._resynchronise()
            by_silence = bool(self._link.char_ns)
            reply, _ = await self._exchange.run(command, self._exchange.find_reply, by_silence=by_silence)
            if reply.refused:
                raise await self._exchange.read_refusal(command)
            self._exchange.in_step = True
            return reply.lines

    async def read_revision(self) -> str:
        """Return the firmware's revision. The carriage return after the two bytes is part of the command or one of its
        own, with another prompt (the manual is silent): the next exchange discards it."""
        async with self._turn:
            await self._resynchronise()
            reply, _ = await self._exchange.run(_REVISION, self._exchange.find_reply, terminated=True)
            if reply.refused:
                raise await self._exchange.read_refusal("control R control U")
            self._exchange.buffer.clear()
            return " ".join(reply.lines)

    async def query_record(self, command: str, header: bytes, length: int, also: str = "") -> CommandReply:
        """Send a command that is answered by a binary record of `length` bytes that begins with `header`, and a prompt.

        also: a command in the same packet, with data lines in its reply. The answer's instants are those of the record.
        """
        async with self._turn:
            await self._resynchronise()
            record: bytes | None = None
            received_ns = 0

            def find_whole_reply() -> ParsedReply | None:
                nonlocal record, received_ns
                if record is None:
                    record, received_ns = self._exchange.take_record(command, header, length), self._exchange.at_ns
                    if record is None:
                        return None
                return parse_reply(self._exchange.buffer) if also else ParsedReply([], refused=False, used=0)

            reply, sent_ns = await self._exchange.run(f"{command}\r{also}" if also else command, find_whole_reply)
            if not record:
                raise await self._exchange.read_refusal(command)
            if reply.refused:
                raise await self._exchange.read_refusal(also)
            self._exchange.in_step = True
            return CommandReply(reply.lines, record, sent_ns, received_ns)

    def write_at_once(self, *commands: str) -> None:
        """Write at once, whatever is under way, each command in a packet of its own; the replies are assigned later."""
        self._exchange.written_at_once = True
        write_each(self._link, commands)

    async def download_program(self, lines: tuple[str, ...]) -> None:
        """Replace the program (DL, L4128): no prompt until control Z ends it."""
        async with self._turn:
            await self._resynchronise()
            self._exchange.in_step = False
            self._link.write(b"DL\r")
            # A refused download must be detected before its lines are sent: they would be executed as commands.
            if await self._exchange.anything_within(DOWNLOAD_REFUSED_S):
                raise await self._exchange.read_refusal("DL")
            packet = b""
            for line in lines:
                data = line.encode("ascii") + b"\r"
                if len(packet) + len(data) > MAX_PACKET:
                    self._link.write(packet)
                    # On a serial port the packets must not pile up: they would delay everything else by seconds.
                    if await self._exchange.anything_within(PACKET_PAUSE_S + self._exchange.wire_s(packet)):
                        self._link.write(b"\x1a")
                        raise await self._exchange.read_refusal("DL")
                    packet = b""
                packet += data
            self._link.write(packet)
            await self._exchange.anything_within(self._exchange.wire_s(packet))
            reply, _ = await self._exchange.run(END_OF_DATA, self._exchange.find_reply)
            if reply.refused:
                raise await self._exchange.read_refusal("DL")
            self._exchange.in_step = True

    async def load_array(self, name: str, first: int, values: Sequence[int]) -> None:
        """Fill elements of an array from `first` on (QD, L8545). Command and elements must fit into one packet, in
        which they are sent: two consecutive packets may be joined in transit (L1735).

        There is no pause before the data: if QD is refused, they are lines of numbers, which are not commands.
        """
        async with self._turn:
            await self._resynchronise()
            command = f"QD {name}[],{first},{first + len(values) - 1}"
            data = f"{command}\r" + "\r\n".join(map(str, values)) + END_OF_DATA
            reply, _ = await self._exchange.run(data, self._exchange.find_reply, terminated=True)
            if reply.refused:
                raise await self._exchange.read_refusal(command)
            self._exchange.in_step = True

    async def read_array(self, name: str, first: int, last: int) -> list[int]:
        """Return elements of an array, as whole numbers (QU, L9105): separated by commas, followed by a control Z and
        the prompt."""

        def find_whole_reply() -> str | None:
            text = bytes(self._exchange.buffer).decode("latin-1")
            body, end, remainder = text.partition(END_OF_DATA)
            if not end:
                return "?" if text.strip() == "?" else None
            if not remainder.endswith(":"):
                return None
            self._exchange.buffer.clear()
            return body

        async with self._turn:
            await self._resynchronise()
            command = f"QU {name}[],{first},{last},1"
            body, _ = await self._exchange.run(command, find_whole_reply)
            if body == "?":
                raise await self._exchange.read_refusal(command)
            self._exchange.in_step = True
            return [int(value) for value in parse_numbers(body, last - first + 1, command)]

    async def read_numbers(self, *operands: str) -> tuple[list[float], CommandReply]:
        """Return the values of operands, variables or expressions, read in one command, with up to four decimals."""
        command = print_command(operands)
        answer = await self.query_lines(command)
        return parse_numbers(answer.lines[0], len(operands), command), answer

    async def _resynchronise(self) -> None:
        if await self._exchange.resynchronise():
            self.log.info("the session is synchronised", place=self._link.endpoint)


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
