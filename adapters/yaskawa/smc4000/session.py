"""One handle of the controller: a line out, its reply in, and how the two find together again after a disturbance.

A reply is any number of data lines, each ended by CR LF, and a prompt: `:` for done, `?` for refused (L1629-1633).
The prompt stands at the start of a line. There is no checksum and no number on a reply, so exactly one packet is under
way at a time (L1738-1739). It holds one command, or settings that belong together, each a line of its own (L1741): this
leaves open whether a line of several commands gets one prompt or several. Text that nobody asked for comes as whole
lines before a reply and is kept apart.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from adapters.contract import CannotDo, DriverFault
from adapters.yaskawa.common.dialect import MAX_LINE
from adapters.yaskawa.common.words import REMEDIES
from orchestrator.link.base import Link

MAX_PACKET = 470  # bytes (L1735)
OPERANDS_OF_LINE = (MAX_LINE - len("MG ")) // len('_SPX{F10.0},",",')
DOWNLOAD_REFUSED_S = 0.25  # a download that is refused is refused by then
PACKET_PAUSE_S = 0.02  # a download is not acknowledged packet by packet
END_OF_DATA = "\x1a"  # control Z, of programs and arrays (L4134, L8552, L9116)
REVISION = "\x12\x15"  # control R control U (L9721); takes effect without a carriage return

T = TypeVar("T")


class Refused(CannotDo):
    """The controller answered a command with `?`. `number` is its error code (TC)."""

    def __init__(self, command: str, number: int, words: str) -> None:
        super().__init__("refused", f"the controller refuses {command!r}: {words}", REMEDIES.get(number, ""))
        self.number = number


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back: the data lines (or one binary record), and the host instants of question and answer."""

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


class Session:
    """Exchanges over one link, one at a time."""

    def __init__(self, link: Link, timeout_s: float) -> None:
        self._link = link
        self._timeout_s = timeout_s
        self._buffer = bytearray()
        self._turn = asyncio.Lock()
        self._at_ns = 0
        self._markers = 0
        # Until a marker has come back, bytes of somebody's earlier command may be under way.
        self._in_step = False
        self._shouted = False
        self.unsolicited: deque[str] = deque(maxlen=20)

    async def tell(self, command: str, still: Callable[[], None] | None = None) -> None:
        """A command without data in its reply. Raises `Refused`."""
        await self.ask(command, 0, still)

    async def tell_all(self, commands: Iterable[str], still: Callable[[], None] | None = None) -> int:
        """Settings, in one go: each has its own prompt, and one that is refused keeps the others from nothing. Gives
        the instant at which the last ones were written.

        Raises `Refused` for the last one that was, of which the controller still knows why.
        """
        answered, sent_ns = await self._ask_each(commands, still)
        for lines in answered:
            self.unsolicited.extend(lines)
        return sent_ns

    async def tell_and_read(self, commands: Sequence[str], operands: Sequence[str], then: str) -> list[float]:
        """Settings, the values of any number of operands behind them, as `numbers` reads them, and `then` told behind
        those, all in one go.

        Raises `Refused` for what is told.
        """
        parts = [operands[at : at + OPERANDS_OF_LINE] for at in range(0, len(operands), OPERANDS_OF_LINE)]
        messages = [message(part) for part in parts]
        found: list[float] = []
        answered, _ = await self._ask_each([*commands, *messages, then])
        for lines in answered[: len(commands)]:
            self.unsolicited.extend(lines)
        for part, command, lines in zip(parts, messages, answered[len(commands) :], strict=False):
            self.unsolicited.extend(lines[:-1])
            found += parse_numbers("".join(lines[-1:]), len(part), command)
        return found

    async def _ask_each(
        self, commands: Iterable[str], still: Callable[[], None] | None = None
    ) -> tuple[list[list[str]], int]:
        """The lines that each of some commands is answered by, as many of them in a packet as it holds; and when the
        last packet was written."""
        found: list[list[str]] = []
        sent_ns = 0
        async with self._turn:
            await self._get_in_step()
            if still is not None:
                still()
            for packet in _packets(commands):
                replies: list[_Parsed] = []

                def all_replies(packet: list[str] = packet, replies: list[_Parsed] = replies) -> _Parsed | None:
                    replies.clear()
                    used = 0
                    for _ in packet:
                        parsed = parse_reply(self._buffer[used:])
                        if parsed is None:
                            return None
                        replies.append(parsed)
                        used += parsed.used
                    lines = [line for each in replies for line in each.lines]
                    return _Parsed(lines, any(each.refused for each in replies), used)

                _, sent_ns = await self._exchange("\r".join(packet), all_replies)
                refused = [command for command, reply in zip(packet, replies, strict=True) if reply.refused]
                if refused:
                    raise await self._refusal(refused[-1])
                self._in_step = True
                found += (reply.lines for reply in replies)
        return found, sent_ns

    async def ask(self, command: str, lines: int = 1, still: Callable[[], None] | None = None) -> Answer:
        """A command whose reply has `lines` data lines at the end. Raises `Refused`, `DriverFault`, `LinkClosed`.

        still: called when it is the command's turn; if it raises, nothing is sent.
        """
        async with self._turn:
            await self._get_in_step()
            if still is not None:
                still()
            parsed, sent_ns = await self._exchange(command, lambda: parse_reply(self._buffer))
            if parsed.refused:
                raise await self._refusal(command)
            self._in_step = True
            if len(parsed.lines) < lines:
                raise self._garbage(command, f"{lines} lines", repr(parsed.lines))
            split = len(parsed.lines) - lines
            self.unsolicited.extend(parsed.lines[:split])
            return Answer(parsed.lines[split:], b"", sent_ns, self._at_ns)

    async def ask_all(self, command: str) -> list[str]:
        """A command whose reply has any number of data lines."""
        async with self._turn:
            await self._get_in_step()
            parsed, _ = await self._exchange(command, lambda: parse_reply(self._buffer))
            if parsed.refused:
                raise await self._refusal(command)
            self._in_step = True
            return parsed.lines

    async def ask_record(self, command: str, header: bytes, length: int, also: str = "") -> Answer:
        """A command that is answered by a binary record of `length` bytes that begins with `header`, and a prompt.

        also: asked in the same packet, with data lines in its reply. The answer's instants are those of the record.
        """
        async with self._turn:
            await self._get_in_step()
            record: bytes | None = None
            received_ns = 0

            def take_record() -> bytes | None:
                """b"": refused."""
                at = self._buffer.find(header)
                if at < 0:
                    text = bytes(self._buffer).lstrip(b"\r\n")
                    if text[:1] == b"?" and not text[1:2].isdigit():
                        self._buffer[:] = text[1:]
                        return b""
                    if len(text) >= length:
                        raise self._garbage(command, f"a record that begins with {header.hex(' ')}", text[:16].hex(" "))
                    return None
                if len(self._buffer) <= at + length:
                    return None
                if self._buffer[at + length] != ord(":"):
                    end = bytes(self._buffer[at + length :])
                    raise self._garbage(command, f"`:` after {length} bytes", repr(end[:16]))
                found = bytes(self._buffer[at : at + length])
                if at:
                    self.unsolicited.append(self._buffer[:at].decode("latin-1").strip())
                del self._buffer[: at + length + 1]
                return found

            def whole() -> _Parsed | None:
                nonlocal record, received_ns
                if record is None:
                    record, received_ns = take_record(), self._at_ns
                    if record is None:
                        return None
                return parse_reply(self._buffer) if also else _Parsed([], False, 0)

            said, sent_ns = await self._exchange(f"{command}\r{also}" if also else command, whole)
            if not record:
                raise await self._refusal(command)
            if said.refused:
                raise await self._refusal(also)
            self._in_step = True
            return Answer(said.lines, record, sent_ns, received_ns)

    def shout(self, *commands: str) -> None:
        """Write at once, whatever is under way, each command in a packet of its own; replies are sorted out later."""
        self._shouted = True
        write_each(self._link, commands)

    async def download(self, lines: tuple[str, ...]) -> None:
        """Replace the program (DL, L4128): no prompt until control Z ends it."""
        async with self._turn:
            await self._get_in_step()
            self._in_step = False
            self._link.write(b"DL\r")
            # A refused download must be seen before its lines are: they would be carried out as commands.
            if await self._anything_within(DOWNLOAD_REFUSED_S):
                raise await self._refusal("DL")
            packet = b""
            for line in lines:
                data = line.encode("ascii") + b"\r"
                if len(packet) + len(data) > MAX_PACKET:
                    self._link.write(packet)
                    if await self._anything_within(PACKET_PAUSE_S):
                        self._link.write(b"\x1a")
                        raise await self._refusal("DL")
                    packet = b""
                packet += data
            self._link.write(packet)
            parsed, _ = await self._exchange("\x1a", lambda: parse_reply(self._buffer))
            if parsed.refused:
                raise await self._refusal("DL")
            self._in_step = True

    async def load_array(self, name: str, first: int, values: Sequence[int]) -> None:
        """Fill elements of an array from `first` on (QD, L8545); command and elements must fit into one packet, which
        they are sent in: two that follow each other at once may be joined on their way (L1735).

        Without a pause before the data: should QD be refused, they are lines of numbers, which are no commands.
        """
        async with self._turn:
            await self._get_in_step()
            command = f"QD {name}[],{first},{first + len(values) - 1}"
            data = f"{command}\r" + "\r\n".join(map(str, values)) + END_OF_DATA
            parsed, _ = await self._exchange(data, lambda: parse_reply(self._buffer), terminated=True)
            if parsed.refused:
                raise await self._refusal(command)
            self._in_step = True

    async def read_array(self, name: str, first: int, last: int) -> list[int]:
        """Elements of an array, as whole numbers (QU, L9105): commas between, a control Z and the prompt behind."""

        def whole() -> str | None:
            text = bytes(self._buffer).decode("latin-1")
            body, end, rest = text.partition(END_OF_DATA)
            if not end:
                return "?" if text.strip() == "?" else None
            if not rest.endswith(":"):
                return None
            self._buffer.clear()
            return body

        async with self._turn:
            await self._get_in_step()
            command = f"QU {name}[],{first},{last},1"
            body, _ = await self._exchange(command, whole)
            if body == "?":
                raise await self._refusal(command)
            self._in_step = True
            return [int(value) for value in parse_numbers(body, last - first + 1, command)]

    async def _anything_within(self, seconds: float) -> bool:
        try:
            async with asyncio.timeout(seconds):
                self._buffer += (await self._link.read()).data
        except TimeoutError:
            return False
        return True

    async def _exchange(self, command: str, whole: Callable[[], T | None], terminated: bool = False) -> tuple[T, int]:
        """Write a command and read until `whole` finds its complete reply; with the instant of writing.

        terminated: the command ends with what ends it, and needs no carriage return.
        """
        self._in_step = False
        if self._buffer:
            self.unsolicited.append(self._buffer.decode("latin-1").strip())
            self._buffer.clear()
        data = command.encode("latin-1")
        if not terminated and command[:1] >= " ":
            data += b"\r"
        sent_ns = self._link.write(data)
        try:
            async with asyncio.timeout(self._timeout_s):
                while True:
                    received = await self._link.read()
                    self._buffer += received.data
                    self._at_ns = received.at_ns
                    reply = whole()
                    if reply is not None:
                        if isinstance(reply, _Parsed):
                            del self._buffer[: reply.used]
                            self._check_text(command, reply.lines)
                        return reply, sent_ns
        except TimeoutError:
            got = f"only {bytes(self._buffer)!r}" if self._buffer else "nothing"
            raise DriverFault(
                "no-answer",
                f"{self._link.place}: {got} came within {self._timeout_s:g} s after {command!r}",
                "check power and cable; is another program holding the controller's interpreter?",
            ) from None

    async def _refusal(self, command: str) -> Refused:
        """Ask why (TC1, L10254): code and words."""
        parsed, _ = await self._exchange("TC1", lambda: parse_reply(self._buffer))
        words = parsed.lines[-1] if parsed.lines and not parsed.refused else ""
        number, _, _ = words.partition(" ")
        if not number.isdigit():
            raise self._garbage("TC1", "an error code with its text", repr(words))
        self._in_step = True
        return Refused(command, int(number), words if int(number) else "no reason given")

    async def _get_in_step(self) -> None:
        """Flush what was half typed, and read away everything up to the reply of a marker that is new each time."""
        if self._in_step and not self._shouted:
            return
        self._shouted = False
        self._markers += 1
        marker = f"<{self._markers}>"
        end = marker.encode() + b"\r\n:"

        def whole() -> bool | None:
            at = self._buffer.find(end)
            if at < 0:
                return None
            del self._buffer[: at + len(end)]
            return True

        self._link.write(b"\\\r")
        await self._exchange(f'MG "{marker}"', whole)
        self._buffer.clear()
        self._in_step = True

    def _check_text(self, command: str, lines: list[str]) -> None:
        for line in lines:
            if not (line.isascii() and line.isprintable()):
                raise self._garbage(command, "a line of text", repr(line))

    def _garbage(self, command: str, expected: str, got: str) -> DriverFault:
        self._in_step = False
        return DriverFault(
            "garbage",
            f"{self._link.place}: after {command!r} expected {expected}, got {got}",
            "check cable and address: is this an SMC controller, and does nobody else use this port?",
        )

    async def numbers(self, *operands: str) -> tuple[list[float], Answer]:
        """The values of operands, variables or expressions, read in one command, with up to four decimals."""
        command = message(operands)
        answer = await self.ask(command)
        return parse_numbers(answer.lines[0], len(operands), command), answer


def message(operands: Sequence[str]) -> str:
    """What prints them: with a format of its own (L7558), because a person may have set any; commas between the values,
    because the sign column alone may not part them."""
    return "MG " + ',",",'.join(f"{operand}{{F10.{_decimals(operand)}}}" for operand in operands)


def _decimals(operand: str) -> int:
    """Only a few settings have a fractional part."""
    return 4 if operand[:3] in ("_IT", "_MT", "_PF") else 0


def parse_numbers(line: str, count: int, command: str) -> list[float]:
    """`count` numbers between commas, blanks for positive signs allowed."""
    try:
        values = [float(field.replace(" ", "")) for field in line.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise DriverFault(
            "garbage",
            f"after {command!r} expected {count} numbers with commas between them, got {line!r}",
            "check the cable; does another program print on this handle?",
        )
    return values


def parse_reply(buffer: bytes | bytearray) -> _Parsed | None:
    """The first complete reply in `buffer`, or None.

    A stray CR LF at the start of a line (some firmware sends one after `?`) and the control Z that ends a listing are
    skipped. `?` and a digit is no prompt but the report of a program's error.
    """
    lines: list[str] = []
    at, size = 0, len(buffer)
    while at < size:
        first = buffer[at]
        if first in b"\r\n\x1a":
            at += 1
        elif first == 0x3A:
            return _Parsed(lines, False, at + 1)
        elif first == 0x3F and not buffer[at + 1 : at + 2].isdigit():
            return _Parsed(lines, True, at + 1)
        else:
            end = buffer.find(b"\r\n", at)
            if end < 0:
                return None
            lines.append(buffer[at:end].decode("latin-1").strip())
            at = end + 2
    return None


def _packets(commands: Iterable[str]) -> Iterator[list[str]]:
    """Commands, as many together as a packet holds."""
    packet: list[str] = []
    for command in commands:
        if packet and sum(len(each) + 1 for each in packet) + len(command) + 1 > MAX_PACKET:
            yield packet
            packet = []
        packet.append(command)
    if packet:
        yield packet


def write_each(link: Link, commands: Iterable[str]) -> None:
    """Each command in a packet of its own, so that a refused one takes no other with it."""
    for command in commands:
        link.write(command.encode("ascii") + b"\r")
