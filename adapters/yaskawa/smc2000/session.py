"""Exchanges with one controller of a serial line: its turn, its address, its reply, and the resynchronisation after a
disturbance.

A reply has the format of the SMC-4000: data lines ended by CR LF, and a prompt (L1003-1007). Text printed by programs
has the highest bit of every character set (CW 1, L8062-8088), so that it cannot be mistaken for a reply. Replies have
no checksum and no number, so one command is under way at a time; after a disturbance everything up to the text of a new
marker is discarded. The address of a controller of a chain is verified before any command that changes something.
"""

from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import TypeVar

from adapters.yaskawa.language.dialect import MAX_LINE
from adapters.yaskawa.language.numbers import parse_numbers
from adapters.yaskawa.smc2000.exchange import LineTiming, SerialExchange
from adapters.yaskawa.smc2000.line import LineTurn, SharedSerialLine
from adapters.yaskawa.smc2000.program import split_program
from adapters.yaskawa.smc2000.selection import ControllerSelection
from adapters.yaskawa.wire.exchange import SmcCommandRefused, garbage_fault
from adapters.yaskawa.wire.session import FRACTIONS, CommandReply, CommandSession, pack_texts
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal

T = TypeVar("T")


_REVISION = "\x12\x16\r"
NOT_REPEATABLE = ("BG", "XQ")  # commands that must not be sent twice
_REFUSED_NS = 30 * NS_PER_MS  # beyond the transmission time: the latest time of a refusal of a download
_END_OF_DATA = "\x1a"
_FRACTIONS = tuple(operand for operand in FRACTIONS if operand != "_PF")
_OPERANDS_OF_LINE = (MAX_LINE - len("MG ")) // len('_SPX,",",')
_ELEMENTS_OF_LINE = 10  # at most 70 characters


class SerialCommandSession(CommandSession):
    """The exchanges of one controller. unit: its address in a chain, None for a controller alone on its line."""

    def __init__(self, line: SharedSerialLine, link: Link, clock: Clock, unit: int | None, timing: LineTiming) -> None:
        super().__init__(link, timing.silence_s)
        self._line = line
        self._clock = clock
        self._unit = unit
        self._serial = SerialExchange(line, link, clock, unit, timing)
        self._selection = ControllerSelection(line, link, unit, self._serial)
        self._own_stops = 0

    # The public exchanges

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
            raise garbage_fault(self._link, command, f"{lines} lines", repr(reply_lines))
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
                reply, _ = await self._serial.run(_REVISION, self._serial.parse_buffer)
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
        parts = [lines] if self._unit is None else split_program(lines)
        for number, part in enumerate(parts):
            await self._download_part("DL #" if number else "DL", part)

    async def _download_part(self, command: str, lines: tuple[str, ...]) -> None:
        line = self._line
        async with self.exclusive_turn():
            await self._select_controller()
            try:
                line.in_step, self._serial.settled, line.loading = False, False, True
                await self._serial.write_slowly(command)
                await self._serial.wait_for_quiet(_REFUSED_NS + self._serial.hold_ns, command)
                for text in lines:
                    stops = line.stops
                    await self._serial.write_slowly(text)
                    if line.stops != stops:
                        raise Refusal(
                            "stopped", "a stop came while its program was loaded", "the adapter keeps retrying"
                        )
                line.loading = False
                await self._serial.run(_END_OF_DATA, self._serial.parse_buffer)
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
                line.in_step, self._serial.settled, line.loading = False, False, True
                command = f"QD {name}[],{first},{first + len(values) - 1}"
                for text in (command, *_element_lines(values)):
                    await self._serial.write_slowly(text)
                    if line.stops != stops:
                        raise Refusal("stopped", "a stop came while a move was loaded", "try again")
                line.loading = False
                reply, _ = await self._serial.run(_END_OF_DATA, self._serial.parse_buffer)
                if reply.refused:
                    raise SmcCommandRefused(command, 0, "the elements are not accepted")
                is_loaded = line.stops == stops
            except LinkClosed:
                line.drop_link(self._link)
                raise
            finally:
                line.loading = False
                if is_loaded:
                    line.in_step = self._serial.settled = line.half_line = True
                else:
                    line.mark_out_of_step()

    async def read_array(self, name: str, first: int, last: int) -> list[int]:
        """Return elements of an array, as whole numbers (QU, L10969): separated by commas, followed by a control Z and
        the prompt."""
        command = f"QU {name}[],{first},{last},1"

        def find_whole_reply() -> str | None:
            self._serial.separate_output()
            body, end, remainder = self._serial.plain.decode("latin-1").partition(_END_OF_DATA)
            if not end:
                return "?" if body.strip() == "?" else None
            return body if remainder.endswith(":") else None

        async def request_elements() -> list[int]:
            body, _ = await self._serial.run(command, find_whole_reply)
            if body == "?":
                raise await self._query_refusal(command)
            return [int(value) for value in parse_numbers(body, last - first + 1, command)]

        return await self._run_in_turn(command, request_elements)

    # Internals

    async def _select_controller(self) -> None:
        """Ensure that the controller receives the next command, and that nothing else precedes its reply."""
        await self._selection.select_controller(self.log)

    def verify_address(self) -> None:
        """Verify the address of the controller from now on."""
        self._selection.address_known = self._unit is not None

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
                        raise garbage_fault(self._link, command, "its own reply", "a stop of another controller")
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
            while (reply := self._serial.parse_buffer()) is not None:
                next_command = commands_left.popleft()
                if reply.refused:
                    refused_commands.append(next_command)
                if not commands_left:
                    return reply.lines
            return None

        lines, sent_ns = await self._serial.run(command, find_whole_reply, room=characters)
        answer_size = sum(len(line) + 2 for line in lines) + 1
        answer = CommandReply(
            lines, b"", self._serial.begun_ns(sent_ns, len(command) + 1), self._serial.emitted_ns(answer_size)
        )
        if refused_commands:
            raise await self._query_refusal(refused_commands[0])
        return lines, answer

    async def _query_refusal(self, command: str) -> SmcCommandRefused:
        if self._line.selected != self._unit:
            # A stop of another controller came meanwhile.
            await self._select_controller()
        return await self._serial.query_refusal(command)


def _print_command(operands: Sequence[str]) -> str:
    operand_texts = (f"{operand}{{F4.4}}" if operand[:3] in _FRACTIONS else operand for operand in operands)
    return "MG " + ',",",'.join(operand_texts)


def _element_lines(values: Sequence[int]) -> Iterable[str]:
    for at in range(0, len(values), _ELEMENTS_OF_LINE):
        yield ",".join(map(str, values[at : at + _ELEMENTS_OF_LINE]))
