"""Exchanges with one controller of a serial line: its turn, its address, its reply, and the resynchronisation after a
disturbance.

A reply has the format of the SMC-4000: data lines ended by CR LF, and a prompt (L1003-1007). Text printed by programs
has the highest bit of every character set (CW 1, L8062-8088), so that it cannot be mistaken for a reply. Replies have
no checksum and no number, so one command is under way at a time; after a disturbance everything up to the text of a new
marker is discarded. The address of a controller of a chain is verified before any command that changes something.
"""

import asyncio
import re
from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from adapters.yaskawa.language.dialect import MAX_LINE
from adapters.yaskawa.language.numbers import parse_error_code, parse_numbers
from adapters.yaskawa.smc2000.line import LineTurn, SharedSerialLine, address_command
from adapters.yaskawa.smc2000.replies import SerialReply, parse_serial_reply
from adapters.yaskawa.wire.session import (
    FRACTIONS,
    CommandReply,
    CommandSession,
    SmcCommandRefused,
    pack_texts,
)
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal

T = TypeVar("T")


ADDRESS = "XUN"
"""The variable in which a controller of a chain keeps its address."""

# Numbers without leading zeros (LZ, L10237), whole (VF, PF; L4877-4957), program output marked (CW), no echo.
_SETTINGS = ("EO 0", "CW 1", "LZ 1", "PF 10.0", "VF 10.0")
_REVISION = "\x12\x16\r"
_TRIES = 2
NOT_REPEATABLE = ("BG", "XQ")  # commands that must not be sent twice
_REFUSED_NS = 30 * NS_PER_MS  # beyond the transmission time: the latest time of a refusal of a download
_MARK = 0x80
_END_OF_DATA = "\x1a"
_PART_CHARACTERS = 240  # of a program per turn: other controllers of a chain wait an eighth of a second for their turn
_FRACTIONS = tuple(operand for operand in FRACTIONS if operand != "_PF")
_OPERANDS_OF_LINE = (MAX_LINE - len("MG ")) // len('_SPX,",",')
_ELEMENTS_OF_LINE = 10  # at most 70 characters


@dataclass(frozen=True, slots=True)
class LineTiming:
    """Times on a serial line.

    silence_s: silence for this long is a timeout.
    hold_ns: longest time for which a serial adapter buffers received bytes.
    tolerance: largest relative deviation of a baud rate."""

    silence_s: float
    hold_ns: int
    tolerance: float


class SerialCommandSession(CommandSession):
    """The exchanges of one controller. unit: its address in a chain, None for a controller alone on its line."""

    def __init__(self, line: SharedSerialLine, link: Link, clock: Clock, unit: int | None, timing: LineTiming) -> None:
        super().__init__(link, timing.silence_s)
        self._line = line
        self._clock = clock
        self._unit = unit
        self._silence_ns = round(timing.silence_s * NS_PER_S) + timing.hold_ns
        self._hold_ns = timing.hold_ns
        self._least_char_ns = link.char_ns * (1 - timing.tolerance)
        self._plain: bytearray = bytearray()
        self._marked: bytearray = bytearray()
        self._settled = False
        self._address_known = False
        self._own_stops = 0

    # The public exchanges

    async def send_command(self, command: str, before_send: Callable[[], None] | None = None) -> None:
        await self.query_lines(command, 0, before_send)

    def exclusive_turn(self) -> LineTurn:
        """Return an `async with` context without exchanges of other controllers in between."""
        return LineTurn(self._line, self._unit)

    async def send_settings(self, commands: Iterable[str], before_send: Callable[[], None] | None = None) -> int:
        """Send settings in one turn: each has its own prompt, and a refused one does not prevent the others."""
        setting_commands = list(commands)
        return (await self._query_once("\r".join(setting_commands), before_send))[1].sent_ns if setting_commands else 0

    async def set_and_read(self, commands: Sequence[str], operands: Sequence[str], then: str) -> list[float]:
        await self.send_settings(commands)
        values: list[float] = []
        for at in range(0, len(operands), _OPERANDS_OF_LINE):
            values += (await self.read_numbers(*operands[at : at + _OPERANDS_OF_LINE]))[0]
        await self.send_command(then)
        return values

    async def query_lines(
        self, command: str, lines: int = 1, before_send: Callable[[], None] | None = None
    ) -> CommandReply:
        reply_lines, answer = await self._query_once(command, before_send)
        if len(reply_lines) < lines:
            self._line.mark_out_of_step()
            raise self._garbage_fault(command, f"{lines} lines", repr(reply_lines))
        return CommandReply(reply_lines[len(reply_lines) - lines :], b"", answer.sent_ns, answer.received_ns)

    async def query_all(self, command: str, characters: int = 0) -> list[str]:
        """Send a command whose reply has any number of data lines. characters: length of text that may precede the
        reply."""
        return (await self._query_once(command, None, characters))[0]

    async def read_revision(self) -> str:
        """Return the firmware's revision (control R control V, L13320). The carriage return after the two bytes is part
        of the command or one of its own, with another prompt (the manual is silent): the selection that follows
        discards it."""
        line = self._line
        async with self.exclusive_turn():
            try:
                await self._select_controller()
                reply, _ = await self._run_exchange(_REVISION, self._parse_buffer)
            except LinkClosed:
                line.drop_link(self._link)
                raise
            finally:
                line.mark_out_of_step()
        return " ".join(reply.lines)

    async def read_numbers(self, *operands: str) -> tuple[list[float], CommandReply]:
        """Return the values of operands, read in one command, in the whole numbers that VF gives (L4936)."""
        command = _print_command(operands)
        answer = await self.query_lines(command)
        return parse_numbers(answer.lines[0], len(operands), command), answer

    async def read_many(self, operands: Sequence[str]) -> list[float]:
        values: list[float] = []
        for part in pack_texts(operands, lambda part: len(_print_command(part))):
            values += (await self.read_numbers(*part))[0]
        return values

    def write_at_once(self, *commands: str) -> None:
        self._own_stops += 1
        self._line.write_at_once(self._link, self._unit, commands)

    async def download_program(self, lines: tuple[str, ...]) -> None:
        """Replace the program (DL, L8203), line by line, so that a stop never waits for more than one line. The
        controllers of a chain get it in parts, each appended to the present text (DL #, L8219)."""
        for number, part in enumerate(self.split_program(lines)):
            await self._download_part("DL #" if number else "DL", part)

    def split_program(self, lines: tuple[str, ...]) -> list[tuple[str, ...]]:
        """Split a program's lines into parts between which other controllers of a chain get their turns."""
        if self._unit is None:
            return [lines]
        parts: list[tuple[str, ...]] = [()]
        for line in lines:
            if sum(map(len, (*parts[-1], line))) > _PART_CHARACTERS:
                parts.append(())
            parts[-1] += (line,)
        return parts

    async def _download_part(self, command: str, lines: tuple[str, ...]) -> None:
        line = self._line
        async with self.exclusive_turn():
            await self._select_controller()
            try:
                line.in_step, self._settled, line.loading = False, False, True
                await self._write_slowly(command)
                await self._quiet_for(_REFUSED_NS + self._hold_ns, command)
                for text in lines:
                    stops = line.stops
                    await self._write_slowly(text)
                    if line.stops != stops:
                        raise Refusal(
                            "stopped", "a stop came while its program was loaded", "the adapter keeps retrying"
                        )
                line.loading = False
                await self._run_exchange(_END_OF_DATA, self._parse_buffer)
            except LinkClosed:
                line.drop_link(self._link)
                raise
            finally:
                # In every case the next exchange ends a download that is still open.
                line.loading, line.half_line = False, True
                line.mark_out_of_step()

    async def load_array(self, name: str, first: int, values: Sequence[int]) -> None:
        """Fill elements of an array from `first` on (QD, L10922), in short lines like a program's.

        There is no pause after QD: if it is refused, the elements are lines of numbers, which are not commands.
        """
        line = self._line
        async with self.exclusive_turn():
            await self._select_controller()
            stops, is_loaded = line.stops, False
            try:
                # Until its end all bytes are taken as elements; a backslash ends this mode, too.
                line.in_step, self._settled, line.loading = False, False, True
                command = f"QD {name}[],{first},{first + len(values) - 1}"
                for text in (command, *_element_lines(values)):
                    await self._write_slowly(text)
                    if line.stops != stops:
                        raise Refusal("stopped", "a stop came while a move was loaded", "try again")
                line.loading = False
                reply, _ = await self._run_exchange(_END_OF_DATA, self._parse_buffer)
                if reply.refused:
                    raise SmcCommandRefused(command, 0, "the elements are not accepted")
                is_loaded = line.stops == stops
            except LinkClosed:
                line.drop_link(self._link)
                raise
            finally:
                line.loading = False
                if is_loaded:
                    line.in_step = self._settled = line.half_line = True
                else:
                    line.mark_out_of_step()

    async def read_array(self, name: str, first: int, last: int) -> list[int]:
        """Return elements of an array, as whole numbers (QU, L10969): separated by commas, followed by a control Z and
        the prompt."""
        command = f"QU {name}[],{first},{last},1"

        def find_whole_reply() -> str | None:
            self._separate_output()
            body, end, remainder = self._plain.decode("latin-1").partition(_END_OF_DATA)
            if not end:
                return "?" if body.strip() == "?" else None
            return body if remainder.endswith(":") else None

        async def request_elements() -> list[int]:
            body, _ = await self._run_exchange(command, find_whole_reply)
            if body == "?":
                raise await self._query_refusal(command)
            return [int(value) for value in parse_numbers(body, last - first + 1, command)]

        return await self._run_in_turn(command, request_elements)

    # Internals

    async def _query_once(
        self, command: str, before_send: Callable[[], None] | None, characters: int = 0
    ) -> tuple[list[str], CommandReply]:
        """Send a command and return its reply."""
        return await self._run_in_turn(command, lambda: self._send_once(command, characters), before_send)

    async def _run_in_turn(
        self, command: str, request: Callable[[], Awaitable[T]], before_send: Callable[[], None] | None = None
    ) -> T:
        """Return the result of `request` for a command, in a turn.

        Prompts of controllers at different positions of a chain may overtake each other, so that after a stop of
        another controller their sender is unknown: then the command is repeated, or it is a fault if it begins
        something.
        """
        line, begins = self._line, command.startswith(NOT_REPEATABLE)
        while True:
            async with self.exclusive_turn():
                stops = line.stops
                try:
                    await self._select_controller()
                    stops, own = line.stops, self._own_stops
                    if before_send is not None:
                        before_send()
                    line.in_step = False
                    answer = await request()
                    if line.stops - stops != self._own_stops - own:
                        raise self._garbage_fault(command, "its own reply", "a stop of another controller")
                except SmcCommandRefused:
                    raise
                except LinkClosed:
                    line.drop_link(self._link)
                    raise
                except ControllerFault as error:
                    line.mark_out_of_step()
                    if line.stops == stops or begins:
                        raise
                    self.log.info(f"{command!r} is repeated after a stop on the line: {error.text}")
                except BaseException:
                    line.mark_out_of_step()
                    raise
                else:
                    line.in_step = True
                    if line.stops != stops:
                        line.mark_out_of_step()
                    return answer

    async def _send_once(self, command: str, characters: int) -> tuple[list[str], CommandReply]:
        """Send one command, or several settings separated by CR; report the first refused one."""
        commands_left, refused_commands = deque(command.split("\r")), list[str]()

        def find_whole_reply() -> list[str] | None:
            while (reply := self._parse_buffer()) is not None:
                next_command = commands_left.popleft()
                if reply.refused:
                    refused_commands.append(next_command)
                if not commands_left:
                    return reply.lines
            return None

        lines, sent_ns = await self._run_exchange(command, find_whole_reply, room=characters)
        answer_size = sum(len(line) + 2 for line in lines) + 1
        answer = CommandReply(lines, b"", self._begun_ns(sent_ns, len(command) + 1), self._emitted_ns(answer_size))
        if refused_commands:
            raise await self._query_refusal(refused_commands[0])
        return lines, answer

    async def _query_refusal(self, command: str) -> SmcCommandRefused:
        if self._line.selected != self._unit:
            # A stop of another controller came meanwhile.
            await self._select_controller()
        reply, _ = await self._run_exchange("TC1", self._parse_buffer)
        words = reply.lines[-1] if reply.lines and not reply.refused else ""
        code = parse_error_code(words)
        if code is None:
            raise self._garbage_fault("TC1", "an error code with its text", repr(words))
        self._line.in_step = True
        return SmcCommandRefused(command, code, words if code else "no reason given")

    async def _select_controller(self) -> None:
        """Ensure that the controller receives the next command, and that nothing else precedes its reply."""
        line = self._line
        if line.ahead is not None:
            line.mark_out_of_step()
        # A controller that is already missing does not take the others' time twice.
        tries_left = 1 if self._unit in line.missing else _TRIES
        while not (line.in_step and line.selected == self._unit and self._settled):
            stops, line.in_step, line.selected = line.stops, False, None
            marker = line.next_marker()
            query = f'MG "{marker}",{ADDRESS}' if self._address_known else f'MG "{marker}"'
            # A half-typed line is spoiled before it is ended; an operator's entry and a download end (L4812, L8205).
            opening = "" if self._settled and not line.half_line else "\\\r"
            settings = () if self._settled else _SETTINGS
            opening += self._address_prefix(tries_left) + "".join(f"{command}\r" for command in settings)
            try:
                reply = await self._marked_reply(opening, query, marker)
                if self._address_known and reply != str(self._unit) and line.stops == stops:
                    raise self._garbage_fault(
                        f"%{self._unit}", f"the controller with address {self._unit}", repr(reply)
                    )
            except ControllerFault as error:
                if line.stops == stops:
                    self._settled = False
                    tries_left -= 1
                    self.log.warning(f"the controller is not selected: {error.text}", tries_left=tries_left)
                    if not tries_left:
                        if self._unit is not None:
                            line.missing.add(self._unit)
                        raise
                continue
            if line.stops == stops:
                if not self._settled:
                    self.log.info("the session is synchronised", address=self._unit)
                line.in_step, line.selected, self._settled, line.half_line = True, self._unit, True, False
                line.missing.discard(self._unit)

    def _address_prefix(self, left: int) -> str:
        """Return the command that selects this address. A controller alone needs none, unless another address was
        selected before."""
        if self._unit is None:
            return "" if left > 1 or self._settled else address_command(0)
        return address_command(self._unit)

    async def _marked_reply(self, opening: str, query: str, marker: str) -> str:
        """Discard everything up to the answer to `query`; return what follows the marker in it."""
        pattern = re.compile(re.escape(marker.encode()) + rb"([ \-0-9.]*)\r\n:")

        def find_whole_reply() -> str | None:
            self._separate_output()
            reply_match = pattern.search(self._plain)
            return None if reply_match is None else reply_match[1].decode().strip()

        reply, _ = await self._run_exchange(query, find_whole_reply, opening)
        return reply

    async def _run_exchange(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, command: str, whole: Callable[[], T | None], opening: str = "", room: int = 0
    ) -> tuple[T, int]:
        """Write a command and read until `whole` finds its complete reply; return it with the instant of writing.

        room: length of text that may precede the reply.
        """
        self._reset_buffer()
        data = (opening + command + ("\r" if command[:1] >= " " else "")).encode("latin-1")
        sent_ns = self._link.write(data)
        quiet_ns = sent_ns + (len(data) + room) * self._link.char_ns
        return await self._read_until(command, whole, quiet_ns), sent_ns

    async def _read_until(self, command: str, whole: Callable[[], T | None], quiet_ns: int) -> T:
        """Read until `whole` returns a result. quiet_ns: silence is allowed until then; after that, and between bytes,
        silence is a timeout."""
        while True:
            answer = whole()
            if answer is not None:
                self._line.answered = True
                return answer
            left_ns = max(quiet_ns, self._at_ns) + self._silence_ns - self._clock.now_ns()
            try:
                async with asyncio.timeout(max(left_ns, 0) / NS_PER_S):
                    chunk = await self._link.read()
            except TimeoutError:
                raise self._silence_fault(command) from None
            self._plain += chunk.data
            self._at_ns = chunk.at_ns

    def _reset_buffer(self, plain: bytes = b"", marked: bytes = b"") -> None:
        """Clear the input buffer; it then contains these bytes."""
        self._plain = bytearray(plain)
        self._marked = bytearray(marked)

    def _parse_buffer(self) -> SerialReply | None:
        """Return the whole reply to a command, if complete."""
        self._separate_output()
        reply = parse_serial_reply(self._plain)
        if reply is None:
            return None
        del self._plain[: reply.used]
        if reply.echoed:
            # Only a controller that was reset echoes; its settings are loaded again.
            self._settled = False
        for line in reply.lines:
            if not (line.isascii() and line.isprintable()):
                raise self._garbage_fault("a command", "text", repr(line[:40]))
        return reply

    def _separate_output(self) -> None:
        """Separate program output from replies."""
        if any(byte & _MARK for byte in self._plain):
            self._marked += bytes(byte & ~_MARK for byte in self._plain if byte & _MARK)
            self._plain[:] = bytes(byte for byte in self._plain if not byte & _MARK)

    # Timing

    def _begun_ns(self, sent_ns: int, characters: int) -> int:
        """Return the earliest instant at which the last of the characters written at `sent_ns` can have arrived."""
        return sent_ns + round(characters * self._least_char_ns)

    def _emitted_ns(self, characters: int) -> int:
        """Return the latest instant at which the first of `characters` characters, of which the last have just arrived,
        was sent."""
        return self._at_ns - round(characters * self._least_char_ns)

    # Downloads

    async def _write_slowly(self, text: str) -> None:
        """Write a line of a program; return when it has been sent as a whole."""
        data = text.encode("ascii") + b"\r"
        self._link.write(data)
        await self._quiet_for(len(data) * self._link.char_ns, text)

    async def _quiet_for(self, duration_ns: int, text: str) -> None:
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

    def verify_address(self) -> None:
        """Verify the address of the controller from now on."""
        self._address_known = self._unit is not None

    def _silence_fault(self, command: str) -> ControllerFault:
        received_text = f"only {bytes(self._plain + self._marked)!r}" if self._plain or self._marked else "nothing"
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


def _print_command(operands: Sequence[str]) -> str:
    operand_texts = (f"{operand}{{F4.4}}" if operand[:3] in _FRACTIONS else operand for operand in operands)
    return "MG " + ',",",'.join(operand_texts)


def _element_lines(values: Sequence[int]) -> Iterable[str]:
    for at in range(0, len(values), _ELEMENTS_OF_LINE):
        yield ",".join(map(str, values[at : at + _ELEMENTS_OF_LINE]))
