"""The driver's knowledge of the controller between two commands, and the queries that several components use."""

import asyncio
import re
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager, suppress
from dataclasses import dataclass, field
from typing import Literal

from adapters.smc30.session import ControllerBusy, Smc30Answer, Smc30Session
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal

EITHER = re.compile(r"Y|E4")  # to PX, which Standby may refuse
STATUS = re.compile(r"[RB]|E[45]")
POSITION = re.compile(r"V([+-]?[0-9]{1,7})|B")  # L2051-L2056
POINTS = re.compile(r"V([0-7])([0-7])|B")
REGISTER = re.compile(r"V?(?:R?5(?:10|09)=|R)?([0-9]{1,5})|B")
SENTINEL = 7  # the content of the register as long as the controller has not lost its volatile memory
SENTINEL_REGISTER = 510
NO_CONVERSION = "con=1.0000"
_POLL_NS = 20 * NS_PER_MS

MotionCause = Literal["nothing", "step", "jog", "home"]


@dataclass(frozen=True, slots=True)
class ActivityReading:
    """The answer to a query of what the controller does, which was written at sent_ns; valid at some instant between
    the two others. counts: its position, where the answer has shown that too."""

    busy: bool
    sent_ns: int
    arrived_ns: int
    at_ns: int
    counts: int | None = None


@dataclass(frozen=True, slots=True)
class PositionReading:
    """The answer to V1; valid at some instant between the two given."""

    counts: int
    arrived_ns: int
    at_ns: int


@dataclass(slots=True)
class Smc30State:
    """One connection to one controller.

    rest_counts: its position when it last was at rest.
    enabled: as set by the adapter; the controller cannot be queried for it.
    lost: K has stopped it in motion, so that its position is unknown (L1848-L1859).
    limit: the end at which a motion has ended too early, until a motion ends at its target, a jog begins, a reference
    is found, or faults are cleared. The inputs at the ends of travel cannot be queried (L767-L827).
    program_error, overflow: reported by F, once.
    program: the program in working memory, as far as is known.
    live: whether V1 is answered in motion; None: not known yet.
    doing: the cause of its motion.
    """

    session: Smc30Session
    clock: Clock
    rest_counts: int = 0
    enabled: bool = True
    lost: bool = False
    limit: Literal["none", "forward", "reverse"] = "none"
    program_error: bool = False
    overflow: bool = False
    program: tuple[str, ...] | None = None
    programming: bool = False
    """It may have been left in Programming Mode: the command that leaves it has not been answered."""
    live: bool | None = None
    doing: MotionCause = "nothing"
    loading: asyncio.Lock = field(default_factory=asyncio.Lock)
    """Lock for changing the program, and for all commands that would become a part of it."""
    _stopping: "set[asyncio.Task[None]]" = field(default_factory=lambda: set["asyncio.Task[None]"]())

    # Queries

    async def read_status(self) -> ActivityReading:
        """Query F (L1818-L1827)."""
        answer = await self.session.send_query("F", STATUS)
        if answer.text == "E4":
            self.program_error = True
        elif answer.text == "E5":
            self.overflow = True
        return ActivityReading(answer.text == "B", answer.sent_ns, self._arrived_ns("F", answer), answer.at_ns)

    async def read_end(self) -> ActivityReading:
        """Query whether it still executes something: by V1, which shows where it stands as well, of a controller that
        refuses that while it does (L1519-L1522); of any other one by F."""
        if self.live is not False:
            return await self.read_status()
        answer = await self.session.send_query("V1", POSITION)
        arrived_ns = self._arrived_ns("V1", answer)
        is_busy = answer.text == "B"
        counts = None if is_busy else int(_matched_group(answer))
        return ActivityReading(is_busy, answer.sent_ns, arrived_ns, answer.at_ns, counts)

    def _arrived_ns(self, command: str, answer: Smc30Answer) -> int:
        """Return the earliest arrival of the end of the answered command at the controller."""
        return answer.sent_ns + self.session.line.wire_ns(len(self.session.frame_command(command)))

    async def read_place(self) -> PositionReading:
        """Query V1 (L1926-L1931), of a controller that answers it. Raises `ControllerBusy`."""
        answer = await self.session.send_query("V1", POSITION)
        return PositionReading(int(_matched_group(answer)), self._arrived_ns("V1", answer), answer.at_ns)

    async def read_position(self) -> int:
        """Return its position, like `read_place`."""
        return (await self.read_place()).counts

    async def read_points(self) -> tuple[dict[int, bool], dict[int, bool]]:
        """Return user inputs and outputs by number (V2, L2443-L2460). Raises `ControllerBusy`."""
        answer = await self.session.send_query("V2", POINTS)
        if answer.text == "B":
            raise ControllerBusy("V2")
        return _point_levels(int(answer.text[1])), _point_levels(int(answer.text[2]))

    async def holds_sentinel(self) -> bool:
        """Return whether the volatile memory is the one that was loaded. Raises `ControllerBusy`."""
        return await self.read_register(SENTINEL_REGISTER) == SENTINEL

    async def read_register(self, number: int) -> int:
        """Return the content of a user register (L3006-L3015). Raises `ControllerBusy`."""
        return int(_matched_group(await self.session.send_query(f"VR{number}", REGISTER)))

    async def require_not_restarted(self, while_it_was: str, remedy: str) -> None:
        """Raise `Refusal` for a controller that was power-cycled: it accepts a program all the same, but its position
        is unknown and its rate settings are lost."""
        try:
            is_held = await self.holds_sentinel()
        except ControllerBusy:
            raise self.moving_refusal() from None
        if not is_held:
            raise Refusal("not-loaded", f"{self.session.name} was restarted while it was {while_it_was}", remedy)

    def moving_refusal(self) -> Refusal:
        """Return the refusal of what a controller does not accept while it executes a program."""
        return Refusal("moving", f"{self.session.name} executes a program", "wait for its end, or stop it")

    async def leave_programming(self) -> None:
        """Send PX if an upload was broken off; for holders of `loading`."""
        if self.programming:
            with suppress(ControllerBusy):
                await self.session.send_query("PX", EITHER)
            self.programming = False

    async def require_ready(self) -> int:
        """Return its position; raise `Refusal` when it is busy or has a fault. For holders of `loading`."""
        try:
            if (await self.read_status()).busy:
                raise ControllerBusy("F")
            await self.leave_programming()
            position = await self.read_position()
        except ControllerBusy:
            raise self.moving_refusal() from None
        self.require_no_fault()
        self.rest_counts = position
        return position

    def require_no_fault(self) -> None:
        """Raise `Refusal` while the controller has a fault."""
        if self.overflow:
            raise Refusal(
                "counter-overflow",
                f"{self.session.name}: the position counter has overflowed",
                "clear it with `tutti reset`, then home",
            )

    async def wait_until_ready(self, until_ns: int) -> ActivityReading | None:
        """Wait until it is ready; None when it still is not at `until_ns`."""
        while True:
            status = await self.read_status()
            if not status.busy:
                return status
            if self.clock.now_ns() >= until_ns:
                return None
            await sleep_ns(self.clock, _POLL_NS)

    # Programs

    def exclusive_turn(self) -> AbstractAsyncContextManager[None]:
        """Return a context in which a program is loaded and started in one turn. Otherwise every other controller of
        the line could have its turn between two lines, and a power cycle of this one could go unnoticed: it would
        not be in Programming Mode then, and execute at once commands that should become a part of its program."""
        return self.session.line.exclusive_turn()

    async def load_program(self, lines: Sequence[str], since: int) -> None:
        """Load `lines` into working memory, and verify them. Raises `Refusal`.

        The conversion factor is set before them: it would change every length (L3048-L3064), another client may have
        set it, and no query shows it.
        """
        program = tuple(lines)
        try:
            await self.session.send_setting(NO_CONVERSION)
            if self.program != program:
                self.program, self.programming = None, True
                await self.session.upload_program(program, since)
                self.programming = False
            listing = await self.session.list_program()
        except ControllerBusy:
            raise self.moving_refusal() from None
        except Refusal:
            self.program = None
            raise
        if tuple(listing) != program:
            self.program = None
            raise Refusal(
                "load-garbled",
                f"{self.session.name} was given {' '.join(program)!r}, and lists {' '.join(listing)!r}",
                "arm it again; check the cable, and whether another client programs it",
            )
        self.program = program

    async def run_program(self, since: int, doing: MotionCause) -> Smc30Answer:
        """Execute the program (E), unless a stop has come since. Raises `Refusal`."""
        session = self.session
        session.require_no_stop(since)
        self.doing = doing
        try:
            return await session.send_once("E", since)
        except ControllerBusy:
            self.doing = "nothing"
            raise self.moving_refusal() from None
        except BaseException:
            # Cancelled or unanswered: no caller would stop it later.
            self.doing = "nothing"
            with suppress(LinkClosed):
                self.write_stop("Z")
            raise

    # Stops

    def write_stop(self, command: Literal["Z", "K"], *after: str) -> int:
        """Write a stop at once, and confirm afterwards that it was accepted; return the host time of writing.

        after: commands that make an output passive. Raises `LinkClosed`.
        """
        at_ns = self.session.write_at_once(command, *(after if command == "K" else ()))
        task = asyncio.get_running_loop().create_task(self._confirm_stop(command, after))
        self._stopping.add(task)
        task.add_done_callback(self._stopping.discard)
        return at_ns

    async def stop_and_confirm(self) -> None:
        """Like `write_stop` by ramp, for a caller that waits for the confirmation."""
        self.write_stop("Z")
        await self.wait_for_stops()

    async def wait_for_stops(self) -> None:
        """Wait until every stop has been confirmed, or could not be."""
        while self._stopping:
            await asyncio.gather(*self._stopping, return_exceptions=True)

    def cancel_confirmations(self) -> None:
        for task in self._stopping:
            task.cancel()

    async def _confirm_stop(self, command: Literal["Z", "K"], after: Sequence[str]) -> None:
        """Repeat the stop in its turn, so that its answer is unambiguous; kill a motion that does not accept it.

        A controller with a checksum may not understand Z at address 3, where the checksum is itself a CR (L1066-L1081).
        """
        old_counts = self.rest_counts
        with suppress(LinkClosed, Refusal, ControllerFault):
            try:
                await self.session.send_setting(command)
            except (ControllerBusy, Refusal, ControllerFault):
                command = "K"
                self.session.write_at_once("K")
                await self.session.send_setting("K")
            if command == "K" and await self._moved_from(old_counts):
                self.lost = True
            if after:
                await self._send_at_rest(after)

    async def _moved_from(self, counts: int) -> bool:
        try:
            return await self.read_position() != counts
        except ControllerBusy:
            return True

    async def _send_at_rest(self, commands: Sequence[str]) -> None:
        """Send commands that are accepted at rest only."""
        for command in commands:
            while True:
                try:
                    await self.session.send_setting(command)
                    break
                except ControllerBusy:
                    await sleep_ns(self.clock, _POLL_NS)


def _matched_group(answer: Smc30Answer) -> str:
    if answer.text == "B":
        raise ControllerBusy("query")
    number_match = re.search(r"[+-]?\d+$", answer.text)
    assert number_match is not None  # the expected pattern guarantees the group
    return number_match[0]


def _point_levels(value: int) -> dict[int, bool]:
    return {number: bool(value & 1 << (number - 1)) for number in (1, 2, 3)}
