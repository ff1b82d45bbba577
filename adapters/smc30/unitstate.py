"""What the driver knows of the unit between two commands, and the questions that several parts of it ask."""

import asyncio
import re
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager, suppress
from dataclasses import dataclass, field
from typing import Literal

from adapters.contract import CannotDo, DriverFault
from adapters.smc30.session import Answer, Busy, Session
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed

EITHER = re.compile(r"Y|E4")  # to PX, which Standby may refuse
STATUS = re.compile(r"[RB]|E[45]")
POSITION = re.compile(r"V([+-]?\d+)|B")
POINTS = re.compile(r"V([0-7])([0-7])|B")
REGISTER = re.compile(r"V?(?:R?510=|R)?(\d{1,5})|B")
SENTINEL = 7  # what the register holds while the unit has not lost its volatile memory
SENTINEL_REGISTER = 510
_LOOK_NS = 20 * NS_PER_MS

Doing = Literal["nothing", "step", "jog", "home"]


@dataclass(frozen=True, slots=True)
class Status:
    """The answer to F, which was written at sent_ns. It was so between the two other instants."""

    busy: bool
    sent_ns: int
    arrived_ns: int
    at_ns: int


@dataclass(frozen=True, slots=True)
class Place:
    """The answer to V1: it was there between the two instants."""

    counts: int
    arrived_ns: int
    at_ns: int


@dataclass(slots=True)
class UnitState:
    """One connection to one unit.

    rest_counts: where it stood when it last was at rest. enabled: as the adapter has told it; the unit can not be
    asked. lost: K has stopped it in motion, so that its motor may be anywhere (L1848-L1859). limit: the end at which
    a motion has ended too early. program_error, overflow: what F has said, once. program: what is in working memory,
    as far as is known. live: whether V1 is answered in motion; None: not known yet. doing: what has set it going.
    """

    session: Session
    clock: Clock
    rest_counts: int = 0
    enabled: bool = True
    lost: bool = False
    limit: Literal["none", "forward", "reverse"] = "none"
    program_error: bool = False
    overflow: bool = False
    program: tuple[str, ...] | None = None
    programming: bool = False
    """It may have been left in Programming Mode: what was to take it out of it has not been answered."""
    live: bool | None = None
    doing: Doing = "nothing"
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)
    """Held by whoever changes the program, and by all whose commands would become a part of it."""
    _stopping: "set[asyncio.Task[None]]" = field(default_factory=lambda: set["asyncio.Task[None]"]())

    # Questions

    async def status(self) -> Status:
        """F (L1818-L1827)."""
        answer = await self.session.ask("F", STATUS)
        if answer.text == "E4":
            self.program_error = True
        elif answer.text == "E5":
            self.overflow = True
        return Status(answer.text == "B", answer.sent_ns, self._arrived_ns("F", answer), answer.at_ns)

    def _arrived_ns(self, command: str, answer: Answer) -> int:
        """When the end of what was answered can have been at the unit at the earliest."""
        return answer.sent_ns + self.session.line.wire_ns(len(self.session.framed(command)))

    async def place(self) -> Place:
        """V1 (L1926-L1931) of a unit that tells it. Raises `Busy`."""
        answer = await self.session.ask("V1", POSITION)
        return Place(int(_group(answer)), self._arrived_ns("V1", answer), answer.at_ns)

    async def position(self) -> int:
        """Where it is, like `place`."""
        return (await self.place()).counts

    async def points(self) -> tuple[dict[int, bool], dict[int, bool]]:
        """User inputs and outputs by number (V2, L2443-L2460). Raises `Busy`."""
        answer = await self.session.ask("V2", POINTS)
        if answer.text == "B":
            raise Busy("V2")
        return _bits(int(answer.text[1])), _bits(int(answer.text[2]))

    async def holds_sentinel(self) -> bool:
        """Whether the volatile memory is the one that was loaded. Raises `Busy`."""
        return int(_group(await self.session.ask(f"VR{SENTINEL_REGISTER}", REGISTER))) == SENTINEL

    async def require_not_restarted(self, while_it_was: str, remedy: str) -> None:
        """Raises `CannotDo` for one that was switched off and on: it takes a program all the same, and knows neither
        where it stands nor how fast it may go."""
        name = self.session.name
        try:
            held = await self.holds_sentinel()
        except Busy:
            raise CannotDo("moving", f"{name} executes a program", "wait, or stop it") from None
        if not held:
            raise CannotDo("not-loaded", f"{name} was restarted while it was {while_it_was}", remedy)

    async def leave_programming(self) -> None:
        """PX, if an upload was broken off; for holders of `loading`."""
        if self.programming:
            with suppress(Busy):
                await self.session.ask("PX", EITHER)
            self.programming = False

    async def ready(self) -> int:
        """Where it stands; `CannotDo` when it is busy or has a fault. For holders of `loading`."""
        try:
            if (await self.status()).busy:
                raise Busy("F")
            await self.leave_programming()
            found = await self.position()
        except Busy:
            raise CannotDo("moving", f"{self.session.name} executes a program", "wait, or stop it") from None
        self.require_no_fault()
        self.rest_counts = found
        return found

    def require_no_fault(self) -> None:
        """Raises `CannotDo`."""
        if self.overflow:
            raise CannotDo(
                "counter-overflow",
                f"{self.session.name}: the position counter has run over",
                "clear it with `tutti reset`, then home",
            )

    async def rest(self, until_ns: int) -> Status | None:
        """Wait until it is ready; None when it still is not at `until_ns`."""
        while True:
            now = await self.status()
            if not now.busy:
                return now
            if self.clock.now_ns() >= until_ns:
                return None
            await sleep_ns(self.clock, _LOOK_NS)

    # Programs

    def in_one_go(self) -> AbstractAsyncContextManager[None]:
        """A program is loaded and begun so. Otherwise every other unit of the line could have its turn between two
        lines, and this one be switched off and on meanwhile, unnoticed: it is not in Programming Mode then, and carries
        out at once what was to become a part of its program."""
        return self.session.line.together()

    async def load(self, lines: Sequence[str], since: int) -> None:
        """Have `lines` in working memory, and see to it that they are. Raises `CannotDo`."""
        program = tuple(lines)
        try:
            if self.program != program:
                self.program, self.programming = None, True
                await self.session.upload(program, since)
                self.programming = False
            found = await self.session.listing()
        except Busy:
            raise CannotDo("moving", f"{self.session.name} executes a program", "wait, or stop it") from None
        except CannotDo:
            self.program = None
            raise
        if tuple(found) != program:
            self.program = None
            raise CannotDo(
                "load-garbled",
                f"{self.session.name} was given {' '.join(program)!r}, and lists {' '.join(found)!r}",
                "arm again; check the cable, and whether somebody else programs it",
            )
        self.program = program

    async def run(self, since: int, doing: Doing) -> Answer:
        """Execute the program (E), unless a stop has come since. Raises `CannotDo`."""
        session = self.session
        session.require_no_stop(since)
        self.doing = doing
        try:
            return await session.begin("E", since)
        except Busy:
            self.doing = "nothing"
            raise CannotDo("moving", f"{session.name} executes a program", "wait, or stop it") from None
        except BaseException:
            # Cancelled, or without an answer: nobody would stop it any more.
            self.doing = "nothing"
            with suppress(LinkClosed):
                self.stop("Z")
            raise

    # Stopping

    def stop(self, command: Literal["Z", "K"], *after: str) -> int:
        """Write a stop at once, and see to it afterwards that it was taken; host time of writing.

        after: what brings an output to rest. Raises `LinkClosed`.
        """
        at_ns = self.session.shout(command, *(after if command == "K" else ()))
        task = asyncio.get_running_loop().create_task(self._confirm(command, after))
        self._stopping.add(task)
        task.add_done_callback(self._stopping.discard)
        return at_ns

    async def stop_now(self) -> None:
        """Like `stop` by ramp, for a caller who waits until it is confirmed."""
        self.stop("Z")
        await self.stopped()

    async def stopped(self) -> None:
        """Until every stop has been confirmed, or could not be."""
        while self._stopping:
            await asyncio.gather(*self._stopping, return_exceptions=True)

    def forget_stops(self) -> None:
        for task in self._stopping:
            task.cancel()

    async def _confirm(self, command: Literal["Z", "K"], after: Sequence[str]) -> None:
        """Say the stop again in its turn, so that the answer is certain; kill what does not take it.

        A unit with a checksum may not understand Z at address 3, where the checksum is itself a CR (L1066-L1081).
        """
        before = self.rest_counts
        with suppress(LinkClosed, CannotDo, DriverFault):
            try:
                await self.session.tell(command)
            except (Busy, CannotDo, DriverFault):
                command = "K"
                self.session.shout("K")
                await self.session.tell("K")
            if command == "K" and await self._moved_from(before):
                self.lost = True
            if after:
                await self._after(after)

    async def _moved_from(self, counts: int) -> bool:
        try:
            return await self.position() != counts
        except Busy:
            return True

    async def _after(self, commands: Sequence[str]) -> None:
        """Commands that are taken at rest only."""
        for command in commands:
            while True:
                try:
                    await self.session.tell(command)
                    break
                except Busy:
                    await sleep_ns(self.clock, _LOOK_NS)


def _group(answer: Answer) -> str:
    if answer.text == "B":
        raise Busy("query")
    found = re.search(r"[+-]?\d+$", answer.text)
    assert found is not None  # its form was asked for
    return found[0]


def _bits(value: int) -> dict[int, bool]:
    return {number: bool(value & 1 << (number - 1)) for number in (1, 2, 3)}
