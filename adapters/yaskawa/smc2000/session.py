"""Exchanges with one unit of a serial line: its turn, its address, its reply, and how they find together again.

A reply is what it is on the SMC-4000: data lines ended by CR LF, and a prompt (L1003-1007). What programs print has the
highest bit of every character set (CW 1, L8062-8088), so that it can not be taken for a reply. There is no checksum and
no number on a reply, so one command is under way at a time; after a disturbance everything up to the text of a new
marker is thrown away. A unit of a chain is asked for its own address before it is told anything that changes something.
"""

import asyncio
import re
from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import TypeVar

from adapters.contract import CannotDo, DriverFault
from adapters.yaskawa.common.dialect import MAX_LINE
from adapters.yaskawa.smc2000.line import Line, Turn, address
from adapters.yaskawa.smc2000.replies import Heard, parse
from adapters.yaskawa.smc4000.session import Answer, Refused, Session, parse_numbers
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.link.base import Link, LinkClosed

T = TypeVar("T")


ADDRESS = "XUN"
"""The variable in which a unit of a chain keeps its address."""

# Numbers without leading zeros (LZ, L10237), whole (VF, PF; L4877-4957), what programs print marked (CW), no echo.
_SETTINGS = ("EO 0", "CW 1", "LZ 1", "PF 10.0", "VF 10.0")
_REVISION = "\x12\x16"
_TRIES = 2
BEGINNINGS = ("BG", "XQ")  # what must not be said twice
_REFUSED_NS = 30 * NS_PER_MS  # beyond the wire: a download that is refused is refused by then
_MARK = 0x80
_END_OF_DATA = "\x1a"
_PART_CHARACTERS = 240  # of a program at once: other units of a chain wait an eighth of a second for their turn
_OPERANDS_OF_LINE = (MAX_LINE - len("MG ")) // len('_SPX,",",')
_ELEMENTS_OF_LINE = 10  # at most 70 characters


class SerialSession(Session):
    """The exchanges of one unit. unit: its address in a chain, None for a controller alone on its line.

    hold_ns: how long a serial adapter may keep received bytes. tolerance: how far a baud rate may be off, relative.
    """

    def __init__(
        self, line: Line, link: Link, clock: Clock, unit: int | None, silence_s: float, hold_ns: int, tolerance: float
    ) -> None:
        super().__init__(link, silence_s)
        self._line = line
        self._clock = clock
        self._unit = unit
        self._silence_ns = round(silence_s * NS_PER_S) + hold_ns
        self._hold_ns = hold_ns
        self._least_char_ns = link.char_ns * (1 - tolerance)
        self._plain: bytearray = bytearray()
        self._marked: bytearray = bytearray()
        self._settled = False
        self._known = False
        self._own_stops = 0

    # What others ask for

    async def tell(self, command: str, still: Callable[[], None] | None = None) -> None:
        await self.ask(command, 0, still)

    def together(self) -> Turn:
        """`async with`: exchanges with nobody else's between them."""
        return Turn(self._line, self._unit)

    async def tell_all(self, commands: Iterable[str], still: Callable[[], None] | None = None) -> int:
        """Settings, in one go: each has its own prompt, and one that is refused keeps the others from nothing."""
        given = list(commands)
        return (await self._told("\r".join(given), still))[1].sent_ns if given else 0

    async def tell_and_read(self, commands: Sequence[str], operands: Sequence[str], then: str) -> list[float]:
        await self.tell_all(commands)
        found: list[float] = []
        for at in range(0, len(operands), _OPERANDS_OF_LINE):
            found += (await self.numbers(*operands[at : at + _OPERANDS_OF_LINE]))[0]
        await self.tell(then)
        return found

    async def ask(self, command: str, lines: int = 1, still: Callable[[], None] | None = None) -> Answer:
        found, answer = await self._told(command, still)
        if len(found) < lines:
            self._line.out_of_step()
            raise self._garbage(command, f"{lines} lines", repr(found))
        return Answer(found[len(found) - lines :], b"", answer.sent_ns, answer.received_ns)

    async def ask_all(self, command: str, characters: int = 0) -> list[str]:
        """A command whose reply has any number of data lines. characters: what it may take before anything comes."""
        return (await self._told(command, None, characters))[0]

    async def revision(self) -> str:
        """Control R control V (L13320). It ends without CR: what other units of a chain have made of it is cleared
        before anybody else's turn."""
        line = self._line
        async with self.together():
            try:
                await self._turn_to_unit()
                reply, _ = await self._exchange(_REVISION, self._reply)
                self._settled = False
                await self._turn_to_unit()
            except LinkClosed:
                line.lost(self._link)
                raise
            except BaseException:
                line.out_of_step()
                raise
        return " ".join(reply.lines)

    async def numbers(self, *operands: str) -> tuple[list[float], Answer]:
        """The values of operands, read in one command, in the whole numbers that VF gives (L4936)."""
        shown = (f"{operand}{{F2.4}}" if operand[:3] in ("_IT", "_MT") else operand for operand in operands)
        command = "MG " + ',",",'.join(shown)
        answer = await self.ask(command)
        return parse_numbers(answer.lines[0], len(operands), command), answer

    def shout(self, *commands: str) -> None:
        self._own_stops += 1
        self._line.shout(self._link, self._unit, commands)

    async def download(self, lines: tuple[str, ...]) -> None:
        """Replace the program (DL, L8203), line by line, so that a stop never waits behind more than one. The units of
        a chain get it in parts, each behind what is there already (DL #, L8219)."""
        for number, part in enumerate(self.parts(lines)):
            await self._download("DL #" if number else "DL", part)

    def parts(self, lines: tuple[str, ...]) -> list[tuple[str, ...]]:
        """Lines of a program, in as many parts as other units of a chain are to have their turns between."""
        if self._unit is None:
            return [lines]
        parts: list[tuple[str, ...]] = [()]
        for line in lines:
            if sum(map(len, (*parts[-1], line))) > _PART_CHARACTERS:
                parts.append(())
            parts[-1] += (line,)
        return parts

    async def _download(self, command: str, lines: tuple[str, ...]) -> None:
        line = self._line
        async with self.together():
            await self._turn_to_unit()
            try:
                line.in_step, self._settled, line.loading = False, False, True
                await self._write_slowly(command)
                await self._quiet_for(_REFUSED_NS + self._hold_ns, command)
                for text in lines:
                    stops = line.stops
                    await self._write_slowly(text)
                    if line.stops != stops:
                        raise CannotDo("stopped", "a stop came while its program was loaded", "it is tried again")
                line.loading = False
                await self._exchange(_END_OF_DATA, self._reply)
            except LinkClosed:
                line.lost(self._link)
                raise
            finally:
                # Whatever happened, the next exchange ends a download that is still open.
                line.loading, line.half_line = False, True
                line.out_of_step()

    async def load_array(self, name: str, first: int, values: Sequence[int]) -> None:
        """Fill elements of an array from `first` on (QD, L10922), in short lines like a program's.

        Without a pause after QD: should it be refused, they are lines of numbers, which are no commands.
        """
        line = self._line
        async with self.together():
            await self._turn_to_unit()
            stops, loaded = line.stops, False
            try:
                # Until its end all that is written is taken for elements; a backslash ends them, too.
                line.in_step, self._settled, line.loading = False, False, True
                command = f"QD {name}[],{first},{first + len(values) - 1}"
                for text in (command, *_element_lines(values)):
                    await self._write_slowly(text)
                    if line.stops != stops:
                        raise CannotDo("stopped", "a stop came while a move was loaded", "try again")
                line.loading = False
                reply, _ = await self._exchange(_END_OF_DATA, self._reply)
                if reply.refused:
                    raise Refused(command, 0, "the elements are not taken")
                loaded = line.stops == stops
            except LinkClosed:
                line.lost(self._link)
                raise
            finally:
                line.loading = False
                if loaded:
                    line.in_step = self._settled = line.half_line = True
                else:
                    line.out_of_step()

    async def read_array(self, name: str, first: int, last: int) -> list[int]:
        """Elements of an array, as whole numbers (QU, L10969): commas between, a control Z and the prompt behind."""
        command = f"QU {name}[],{first},{last},1"

        def whole() -> str | None:
            self._sift()
            body, end, rest = self._plain.decode("latin-1").partition(_END_OF_DATA)
            if not end:
                return "?" if body.strip() == "?" else None
            return body if rest.endswith(":") else None

        async def ask() -> list[int]:
            body, _ = await self._exchange(command, whole)
            if body == "?":
                raise await self._why(command)
            return [int(value) for value in parse_numbers(body, last - first + 1, command)]

        return await self._exchanged(command, ask)

    # Inside

    async def _told(
        self, command: str, still: Callable[[], None] | None, characters: int = 0
    ) -> tuple[list[str], Answer]:
        """A command and its reply."""
        return await self._exchanged(command, lambda: self._asked(command, characters), still)

    async def _exchanged(
        self, command: str, ask: Callable[[], Awaitable[T]], still: Callable[[], None] | None = None
    ) -> T:
        """What `ask` finds out with a command, in a turn.

        Prompts of units at different places of a chain may overtake each other, so that after a stop of another one
        nobody knows whose they are: then it is said again, or is a fault if it begins something.
        """
        line, begins = self._line, command.startswith(BEGINNINGS)
        while True:
            async with self.together():
                stops = line.stops
                try:
                    await self._turn_to_unit()
                    stops, own = line.stops, self._own_stops
                    if still is not None:
                        still()
                    line.in_step = False
                    found = await ask()
                    if line.stops - stops != self._own_stops - own:
                        raise self._garbage(command, "its own reply", "a stop of another unit")
                except Refused:
                    raise
                except LinkClosed:
                    line.lost(self._link)
                    raise
                except DriverFault:
                    line.out_of_step()
                    if line.stops == stops or begins:
                        raise
                except BaseException:
                    line.out_of_step()
                    raise
                else:
                    line.in_step = True
                    if line.stops != stops:
                        line.out_of_step()
                    return found

    async def _asked(self, command: str, characters: int) -> tuple[list[str], Answer]:
        """One command, or several settings parted by CR; of which the first refused one is told."""
        left, refused = deque(command.split("\r")), list[str]()

        def whole() -> list[str] | None:
            while (reply := self._reply()) is not None:
                asked = left.popleft()
                if reply.refused:
                    refused.append(asked)
                if not left:
                    return reply.lines
            return None

        lines, sent_ns = await self._exchange(command, whole, room=characters)
        answered = sum(len(each) + 2 for each in lines) + 1
        answer = Answer(lines, b"", self._begun_ns(sent_ns, len(command) + 1), self._emitted_ns(answered))
        if refused:
            raise await self._why(refused[0])
        return lines, answer

    async def _why(self, command: str) -> Refused:
        if self._line.selected != self._unit:
            # A stop of another unit came meanwhile.
            await self._turn_to_unit()
        reply, _ = await self._exchange("TC1", self._reply)
        words = reply.lines[-1] if reply.lines and not reply.refused else ""
        number, _, _ = words.partition(" ")
        if not number.isdigit():
            raise self._garbage("TC1", "an error code with its text", repr(words))
        self._line.in_step = True
        return Refused(command, int(number), words if int(number) else "no reason given")

    async def _turn_to_unit(self) -> None:
        """See to it that the unit hears the next command, and that nothing else comes before its reply."""
        line = self._line
        if line.ahead is not None:
            line.out_of_step()
        # Who is missing already does not take the others' time twice.
        left = 1 if self._unit in line.missing else _TRIES
        while not (line.in_step and line.selected == self._unit and self._settled):
            stops, line.in_step, line.selected = line.stops, False, None
            marker = line.marker()
            asked = f'MG "{marker}",{ADDRESS}' if self._known else f'MG "{marker}"'
            # A half-typed line is spoiled before it is ended; an operator's entry and a download end (L4812, L8205).
            opening = "" if self._settled and not line.half_line else "\\\r"
            settings = () if self._settled else _SETTINGS
            opening += self._addressed(left) + "".join(f"{command}\r" for command in settings)
            try:
                said = await self._marked_reply(opening, asked, marker)
                if self._known and said != str(self._unit) and line.stops == stops:
                    raise self._garbage(f"%{self._unit}", f"the unit with address {self._unit}", repr(said))
            except DriverFault:
                if line.stops == stops:
                    self._settled = False
                    left -= 1
                    if not left:
                        if self._unit is not None:
                            line.missing.add(self._unit)
                        raise
                continue
            if line.stops == stops:
                line.in_step, line.selected, self._settled, line.half_line = True, self._unit, True, False
                line.missing.discard(self._unit)

    def _addressed(self, left: int) -> str:
        """A controller alone does not need an address, unless somebody has addressed another one before."""
        if self._unit is None:
            return "" if left > 1 or self._settled else address(0)
        return address(self._unit)

    async def _marked_reply(self, opening: str, asked: str, marker: str) -> str:
        """Throw away everything up to the answer to `asked`; what follows the marker in it."""
        pattern = re.compile(re.escape(marker.encode()) + rb"([ \-0-9.]*)\r\n:")

        def whole() -> str | None:
            self._sift()
            found = pattern.search(self._plain)
            return None if found is None else found[1].decode().strip()

        said, _ = await self._exchange(asked, whole, opening)
        return said

    async def _exchange(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, command: str, whole: Callable[[], T | None], opening: str = "", room: int = 0
    ) -> tuple[T, int]:
        """Write a command and read until `whole` finds its complete reply; with the instant of writing.

        room: characters that the reply may take before anything comes.
        """
        self._begin_with()
        data = (opening + command + ("\r" if command[:1] >= " " else "")).encode("latin-1")
        sent_ns = self._link.write(data)
        quiet_ns = sent_ns + (len(data) + room) * self._link.char_ns
        return await self._read(command, whole, quiet_ns), sent_ns

    async def _read(self, command: str, whole: Callable[[], T | None], quiet_ns: int) -> T:
        """Read until `whole` is content. quiet_ns: until then nothing needs to come; then, and between bytes, silence
        may not last."""
        while True:
            found = whole()
            if found is not None:
                self._line.answered = True
                return found
            left_ns = max(quiet_ns, self._at_ns) + self._silence_ns - self._clock.now_ns()
            try:
                async with asyncio.timeout(max(left_ns, 0) / NS_PER_S):
                    received = await self._link.read()
            except TimeoutError:
                raise self._silent(command) from None
            self._plain += received.data
            self._at_ns = received.at_ns

    def _begin_with(self, plain: bytes = b"", marked: bytes = b"") -> None:
        """Forget what has come before; these bytes are already there."""
        self._plain = bytearray(plain)
        self._marked = bytearray(marked)

    def _reply(self) -> Heard | None:
        """The whole reply to a command."""
        self._sift()
        parsed = parse(self._plain)
        if parsed is None:
            return None
        del self._plain[: parsed.used]
        if parsed.echoed:
            # Only a unit that was reset echoes; it is given its settings again.
            self._settled = False
        for line in parsed.lines:
            if not (line.isascii() and line.isprintable()):
                raise self._garbage("a command", "text", repr(line[:40]))
        return parsed

    def _sift(self) -> None:
        """Part what programs have printed from replies."""
        if any(byte & _MARK for byte in self._plain):
            self._marked += bytes(byte & ~_MARK for byte in self._plain if byte & _MARK)
            self._plain[:] = bytes(byte for byte in self._plain if not byte & _MARK)

    # Times

    def _begun_ns(self, sent_ns: int, characters: int) -> int:
        """The earliest instant at which the last of the characters written at `sent_ns` can have arrived."""
        return sent_ns + round(characters * self._least_char_ns)

    def _emitted_ns(self, characters: int) -> int:
        """The latest instant at which the first of so many characters, of which the last have just come, was sent."""
        return self._at_ns - round(characters * self._least_char_ns)

    # Downloads

    async def _write_slowly(self, text: str) -> None:
        """A line of a program; returns when it is on its way as a whole."""
        data = text.encode("ascii") + b"\r"
        self._link.write(data)
        await self._quiet_for(len(data) * self._link.char_ns, text)

    async def _quiet_for(self, duration_ns: int, text: str) -> None:
        """A download is silent until its end (L8205): what comes meanwhile is a refusal."""
        until_ns = self._clock.now_ns() + duration_ns
        try:
            while True:
                async with asyncio.timeout(max(until_ns - self._clock.now_ns(), 0) / NS_PER_S):
                    received = await self._link.read()
                if b"?" in received.data:
                    raise Refused(text, 0, "the program is not taken")
        except TimeoutError:
            return

    def know_address(self) -> None:
        """From now on the unit can be asked for its address."""
        self._known = self._unit is not None

    def _silent(self, command: str) -> DriverFault:
        got = f"only {bytes(self._plain + self._marked)!r}" if self._plain or self._marked else "nothing"
        who = "" if self._unit is None else f" from unit {self._unit}"
        remedy = "check power and cable; is another program holding the controller's interpreter?"
        if self._unit is None:
            remedy += " If it is part of a daisy chain, say `unit` in its link."
        elif not self._line.answered:
            remedy = "no unit of the chain answers: is the first one, next to this computer, switched on?"
        else:
            remedy += " A unit that is off takes all units behind it off the chain."
        return DriverFault("no-answer", f"{self._link.place}: {got} came{who} after {command!r}", remedy)


def _element_lines(values: Sequence[int]) -> Iterable[str]:
    for at in range(0, len(values), _ELEMENTS_OF_LINE):
        yield ",".join(map(str, values[at : at + _ELEMENTS_OF_LINE]))
