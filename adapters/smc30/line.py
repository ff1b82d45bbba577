"""One serial port with one controller, or with a bus of up to seven: opened once, used in turns.

Replies carry no address (L1504-L1512), so one exchange is under way at a time, and a received reply belongs to it.
Outside the turns two things are written. Stops, at once: they disturb the exchange under way, and the line is left idle
until no reply can arrive. And the starting commands of steps, each in a slot of its own without other traffic, so that
a reply in the slot is the answer to that command.
"""

import asyncio
from collections import Counter
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from adapters.smc30.frames import ReceivedReply, ReplyReader
from adapters.smc30.slots import StartSlots, controller_name
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_until_ns
from orchestrator.link.base import Link, LinkClosed, OpenLink
from orchestrator.model.errors import ControllerFault, TuttiError

SHARED = "smc30 line"
"""The key of the line in `DriverSetup.shared`."""
LONGEST_REPLY = 24  # characters of a reply's transmission, beyond the time allowed for answering
_STRAYS = 3  # this number of duplicate answers is not an accident


class ExchangeDisturbed(TuttiError):
    """A stop was written while a reply was outstanding: the sender of the next replies is unknown."""


@dataclass(slots=True)
class _PendingExchange:
    """An exchange whose replies are outstanding. first_ns: earliest arrival of an answer to it."""

    unit: int | None
    first_ns: int
    replies: "asyncio.Queue[ReceivedReply | Exception]" = field(
        default_factory=lambda: asyncio.Queue[ReceivedReply | Exception]()
    )


class Smc30Line:
    """One port. Created before any loop runs; every controller of the line joins it when its driver is created."""

    def __init__(self, clock: Clock, answer_ns: int, *, with_checksum: bool) -> None:
        self.units: set[int | None] = set()
        self.with_checksum = with_checksum
        self.stops = 0
        self.slots = StartSlots(clock)
        self._clock = clock
        self._answer_ns = answer_ns
        self._turn = asyncio.Lock()
        self._owner: asyncio.Task[object] | None = None
        self._opening = asyncio.Lock()
        self._reader = ReplyReader(with_checksum=with_checksum)
        self._link: Link | None = None
        self._char_ns = 0
        self._reading: asyncio.Task[None] | None = None
        self._users: set[int | None] = set()
        self._waiting: _PendingExchange | None = None
        self._settled_ns = 0
        self._last: int | None = None
        self._strays: Counter[int | None] = Counter()

    def register_controller(self, unit: int | None, answer_ns: int) -> int:
        """Register a controller of the line; return their number."""
        self.units.add(unit)
        self._answer_ns = max(self._answer_ns, answer_ns)
        return len(self.units)

    def order_index(self, unit: int | None) -> int:
        """Return the index of a controller among the addresses of the line, from 0: the common order of starting
        commands."""
        return sorted(number or 0 for number in self.units).index(unit or 0)

    def wire_ns(self, characters: int) -> int:
        """Return the transmission time of `characters` characters."""
        return characters * self._char_ns

    # The port

    async def attach_controller(self, unit: int | None, open_link: OpenLink, char_ns: int) -> None:
        """Open the port if it is not open. Raises `LinkRefused`."""
        async with self._opening:
            if self._link is None:
                link = await open_link()
                self._link, self._char_ns = link, max(char_ns, link.char_ns)
                self._reader.clear()
                self._strays.clear()
                self._reading = asyncio.get_running_loop().create_task(self._read_replies(link))
                # A half-typed command is spoiled before it is ended: ended alone, it could be valid.
                link.write(b"?\r")
                self._leave_idle(2)
            self._users.add(unit)

    async def detach_controller(self, unit: int | None) -> None:
        """Detach a controller; the port is closed after the last one."""
        async with self._opening:
            self._users.discard(unit)
            link = self._link
            if not self._users and link is not None:
                self._handle_link_loss(link, LinkClosed(f"{link.endpoint} is closed"))
                if self._reading is not None:
                    self._reading.cancel()
                await link.close()

    @property
    def link(self) -> Link:
        """The open port; raises `LinkClosed`."""
        if self._link is None:
            raise LinkClosed("the serial port is closed")
        return self._link

    # Exchanges in turns

    @asynccontextmanager
    async def exclusive_turn(self) -> AsyncGenerator[None]:
        """Run exchanges without others in between; within a turn of the same task, a part of that.

        Turns are granted in the order of the requests.
        """
        task = asyncio.current_task()
        if self._owner is task:
            yield
            return
        async with self._turn:
            self._owner = task
            try:
                yield
            finally:
                self._owner = None

    async def run_exchange(
        self,
        unit: int | None,
        data: bytes,
        whole: Callable[[list[ReceivedReply]], bool],
        expected: int = LONGEST_REPLY,
        before_send: Callable[[], None] | None = None,
    ) -> tuple[int, list[ReceivedReply]]:
        """Write a command in its turn and collect replies until `whole` has enough; return them with the instant of
        writing.

        expected: characters of the replies. before_send: called just before writing; if it raises, nothing is written.

        Raises `ExchangeDisturbed`, `ControllerFault` (no-answer, two-answers), `LinkClosed`. Returns partial replies
        on a timeout.
        """
        async with self.exclusive_turn():
            await self._wait_for_gap(len(data) + expected)
            self._require_one_answer(unit)
            if before_send is not None:
                before_send()
            link, stops = self.link, self.stops
            sent_ns = link.write(data)
            arrived_ns = sent_ns + self.wire_ns(len(data))
            exchange = self._waiting = _PendingExchange(unit, arrived_ns)
            self._last = unit
            replies: list[ReceivedReply] = []
            try:
                while not whole(replies):
                    since_ns = max(arrived_ns, replies[-1].at_ns if replies else 0)
                    left_ns = since_ns + self._answer_ns + self.wire_ns(LONGEST_REPLY) - self._clock.now_ns()
                    async with asyncio.timeout(max(left_ns, 0) / NS_PER_S):
                        reply = await exchange.replies.get()
                    if isinstance(reply, Exception):
                        raise reply
                    replies.append(reply)
            except TimeoutError:
                self.discard_late_replies()
            except asyncio.CancelledError:
                self._leave_idle(len(data))
                raise
            finally:
                self._waiting = None
            if self.stops != stops:
                raise ExchangeDisturbed
            return sent_ns, replies

    def discard_late_replies(self) -> None:
        """Begin no exchange, and discard what arrives, until no reply to the last command can be outstanding.

        Replies carry no address: without this, a late reply would answer the next query, of another controller too, and
        every query after it would get the reply of the one before.
        """
        self._leave_idle(0)

    async def _wait_for_gap(self, characters: int) -> None:
        """Wait until an exchange of `characters` characters can end before the next slot, and no reply is under way."""
        usual_ns = self.wire_ns(characters) + 10 * NS_PER_MS
        while True:
            now_ns = self._clock.now_ns()
            until_ns = self.slots.find_gap_ns(usual_ns, self._settled_ns)
            if until_ns <= now_ns:
                return
            await sleep_until_ns(self._clock, until_ns)

    def _require_one_answer(self, unit: int | None) -> None:
        if self._strays[unit] < _STRAYS:
            return
        self._strays[unit] = 0
        raise ControllerFault(
            "two-answers",
            f"{self.link.endpoint}: {controller_name(unit)} gives more answers than requested",
            "do two controllers have the same address? Is another program on the line?",
        )

    # Writes outside turns

    def write_at_once(self, data: bytes) -> int:
        """Write stops now, bypassing everything that is under way; return the host time of writing. Raises
        `LinkClosed`."""
        link = self.link
        self.stops += 1
        if self._waiting is not None:
            self._waiting.replies.put_nowait(ExchangeDisturbed())
        at_ns = link.write(data)
        self._leave_idle(len(data) + LONGEST_REPLY)
        return at_ns

    # Reception

    async def _read_replies(self, link: Link) -> None:
        try:
            while True:
                chunk = await link.read()
                for reply in self._reader.feed_bytes(chunk.data, chunk.at_ns):
                    self._handle_reply(reply)
        except LinkClosed as error:
            self._handle_link_loss(link, error)

    def _handle_reply(self, reply: ReceivedReply) -> None:
        if self.slots.take_answer(reply):
            return
        exchange = self._waiting
        if exchange is not None and reply.at_ns >= exchange.first_ns:
            exchange.replies.put_nowait(reply)
        elif self._clock.now_ns() >= self._settled_ns:
            # No query is outstanding, or it cannot be answered yet: a duplicate answer to the last query.
            self._strays[self._last] += 1
            if exchange is None:
                self._leave_idle(0)

    def _leave_idle(self, characters: int) -> None:
        """Leave the line idle until no reply to the last write can arrive."""
        until_ns = self._clock.now_ns() + self.wire_ns(characters) + self._answer_ns
        self._settled_ns = max(self._settled_ns, until_ns)

    def _handle_link_loss(self, link: Link, error: LinkClosed) -> None:
        if self._link is link:
            self._link = None
            self._settled_ns = 0
            self._users.clear()
        if self._waiting is not None:
            self._waiting.replies.put_nowait(error)
        self.slots.free_all()
