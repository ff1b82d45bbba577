"""One serial port with one unit behind it, or with a bus of up to seven: opened once, spoken to in turns.

Replies carry no address (L1504-L1512), so one exchange is under way at a time, and what comes belongs to it. Beside the
turns two things are written: stops, at once, after which whatever is under way is disturbed and the line is left alone
until no reply can come any more; and the starting lines of steps, each in a slot of its own in which nobody else
speaks, so that what comes in it is the answer to that line.
"""

import asyncio
from collections import Counter
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from adapters.contract import CannotDo, DriverFault
from adapters.smc30.frames import Reply, ReplyReader
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_until_ns
from orchestrator.link.base import Link, LinkClosed, OpenLink

SHARED = "smc30 line"
"""Where the drivers of one line find it in `Setup.shared`."""
LONGEST_REPLY = 24  # characters that a reply may take on the wire, beyond the time allowed for answering
_STRAYS = 3  # so many second answers are no accident


class Disturbed(Exception):
    """A stop was written while a reply was outstanding: nobody knows whose the next replies are."""


@dataclass(slots=True)
class Shot:
    """A slot for one line that is written at `begin_ns`, takes `wire_ns`, and is answered within `each_ns` after that.

    late_ns: how much later than promised it may be written, and once it was, has been.
    heard: its answer; None: none has come, or nobody knows which one is its.
    """

    unit: int | None
    begin_ns: int
    wire_ns: int
    each_ns: int
    late_ns: int = 0
    heard: "asyncio.Future[Reply | None]" = field(
        default_factory=lambda: asyncio.get_running_loop().create_future(), repr=False
    )

    @property
    def end_ns(self) -> int:
        """Until then nobody else speaks: a host that is late gets one slot more."""
        return self.begin_ns + self.wire_ns + 2 * self.each_ns + self.late_ns

    def hear(self, reply: Reply | None) -> None:
        if not self.heard.done():
            self.heard.set_result(reply)


@dataclass(slots=True)
class _Waiting:
    """An exchange whose replies are still to come. first_ns: nothing that comes before can be an answer to it."""

    unit: int | None
    first_ns: int
    replies: "asyncio.Queue[Reply | Exception]" = field(default_factory=lambda: asyncio.Queue[Reply | Exception]())


class Line:
    """One port. Made before any loop runs; every unit of the line joins it when its driver is built."""

    def __init__(self, clock: Clock, with_checksum: bool, answer_ns: int) -> None:
        self.units: set[int | None] = set()
        self.with_checksum = with_checksum
        self.stops = 0
        self._clock = clock
        self._answer_ns = answer_ns
        self._turn = asyncio.Lock()
        self._owner: asyncio.Task[object] | None = None
        self._opening = asyncio.Lock()
        self._reader = ReplyReader(with_checksum)
        self._link: Link | None = None
        self._char_ns = 0
        self._reading: asyncio.Task[None] | None = None
        self._users: set[int | None] = set()
        self._waiting: _Waiting | None = None
        self._shots: list[Shot] = []
        self._answers: list[Reply] = []
        self._settled_ns = 0
        self._last: int | None = None
        self._strays: Counter[int | None] = Counter()

    def join(self, unit: int | None, answer_ns: int) -> int:
        """A unit of the line is known; how many there are now."""
        self.units.add(unit)
        self._answer_ns = max(self._answer_ns, answer_ns)
        return len(self.units)

    def place(self, unit: int | None) -> int:
        """The place of a unit among the addresses of the line, from 0: the agreed order of starting lines."""
        return sorted(each or 0 for each in self.units).index(unit or 0)

    def wire_ns(self, characters: int) -> int:
        """How long so many characters are on the wire."""
        return characters * self._char_ns

    # The port

    async def attach(self, unit: int | None, open_link: OpenLink, char_ns: int) -> None:
        """See to it that the port is open. Raises `LinkRefused`."""
        async with self._opening:
            if self._link is None:
                link = await open_link()
                self._link, self._char_ns = link, max(char_ns, link.char_ns)
                self._reader.clear()
                self._strays.clear()
                self._reading = asyncio.get_running_loop().create_task(self._read(link))
                # What is half-typed is spoilt before it is ended: ended alone, it could be a command.
                link.write(b"?\r")
                self._settle(2)
            self._users.add(unit)

    async def detach(self, unit: int | None) -> None:
        """A unit is left; the port is closed after the last one."""
        async with self._opening:
            self._users.discard(unit)
            link = self._link
            if not self._users and link is not None:
                self._lost(link, LinkClosed(f"{link.place} is closed"))
                if self._reading is not None:
                    self._reading.cancel()
                await link.close()

    @property
    def link(self) -> Link:
        """The open port; raises `LinkClosed`."""
        if self._link is None:
            raise LinkClosed("the serial port is closed")
        return self._link

    # Speaking in turns

    @asynccontextmanager
    async def together(self) -> AsyncGenerator[None]:
        """Exchanges with nobody else's between them; within a turn of the same task, a part of that.

        Turns are given in the order in which they were asked for.
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

    async def exchange(
        self,
        unit: int | None,
        data: bytes,
        whole: Callable[[list[Reply]], bool],
        expected: int = LONGEST_REPLY,
        still: Callable[[], None] | None = None,
    ) -> tuple[int, list[Reply]]:
        """Write a line in its turn and take replies until `whole` has enough; with the instant of writing.

        expected: characters that they take. still: called just before writing; if it raises, nothing is written.
        Raises `Disturbed`, `DriverFault` (no-answer, two-answers), `LinkClosed`. Gives what has come when it is silent.
        """
        async with self.together():
            await self._free(len(data) + expected)
            self._require_one_answer(unit)
            if still is not None:
                still()
            link, stops = self.link, self.stops
            sent_ns = link.write(data)
            arrived_ns = sent_ns + self.wire_ns(len(data))
            waiting = self._waiting = _Waiting(unit, arrived_ns)
            self._last = unit
            replies: list[Reply] = []
            try:
                while not whole(replies):
                    since_ns = max(arrived_ns, replies[-1].at_ns if replies else 0)
                    left_ns = since_ns + self._answer_ns + self.wire_ns(LONGEST_REPLY) - self._clock.now_ns()
                    async with asyncio.timeout(max(left_ns, 0) / NS_PER_S):
                        heard = await waiting.replies.get()
                    if isinstance(heard, Exception):
                        raise heard
                    replies.append(heard)
            except TimeoutError:
                pass
            except asyncio.CancelledError:
                self._settle(len(data))
                raise
            finally:
                self._waiting = None
            if self.stops != stops:
                raise Disturbed
            return sent_ns, replies

    async def _free(self, characters: int) -> None:
        """Until an exchange of so many characters can be ended before the next slot, and no reply is on its way."""
        usual_ns = self.wire_ns(characters) + 10 * NS_PER_MS
        while True:
            now_ns = self._clock.now_ns()
            until_ns = self._settled_ns
            for shot in self._shots:
                if shot.begin_ns - usual_ns <= now_ns < shot.end_ns:
                    until_ns = max(until_ns, shot.end_ns)
            if until_ns <= now_ns:
                return
            await sleep_until_ns(self._clock, until_ns)

    def _require_one_answer(self, unit: int | None) -> None:
        if self._strays[unit] < _STRAYS:
            return
        self._strays[unit] = 0
        raise DriverFault(
            "two-answers",
            f"{self.link.place}: {_named(unit)} gives more answers than it was asked for",
            "do two units have the same address? Is another program on the line?",
        )

    # Speaking at once

    def shout(self, data: bytes) -> int:
        """Write stops now, past everything that is under way; host time of writing. Raises `LinkClosed`."""
        link = self.link
        self.stops += 1
        if self._waiting is not None:
            self._waiting.replies.put_nowait(Disturbed())
        at_ns = link.write(data)
        self._settle(len(data) + LONGEST_REPLY)
        return at_ns

    def reserve(self, shot: Shot) -> None:
        """Keep a slot free. Raises `CannotDo` when another one overlaps it."""
        for other in self._shots:
            if abs(shot.begin_ns - other.begin_ns) < max(shot.each_ns, other.each_ns):
                raise CannotDo(
                    "line-busy",
                    f"{_named(shot.unit)}: the line starts {_named(other.unit)} at that instant",
                    "units of one line start in one step, or at least a second apart",
                )
        self._shots.append(shot)
        self._clock.call_at_ns(shot.end_ns, self._share_out)

    def written(self, shot: Shot, late_ns: int) -> None:
        """Its line was written, so much later than promised: the slot need not be longer than that."""
        shot.late_ns = late_ns
        self._clock.call_at_ns(shot.end_ns, self._share_out)

    def release(self, shot: Shot) -> None:
        """Its line was not and will not be written."""
        shot.hear(None)
        if shot in self._shots:
            self._shots.remove(shot)

    def _share_out(self) -> None:
        """Units answer in the order of their slots: the answers of slots that follow each other are told apart by that,
        because a host that is late could mistake the instants. If one is missing, nobody knows whose it is."""
        now_ns = self._clock.now_ns()
        fired = sorted((shot for shot in self._shots if shot.begin_ns <= now_ns), key=lambda shot: shot.begin_ns)
        if any(shot.end_ns > now_ns for shot in fired):
            return
        answers, self._answers = self._answers, []
        sure = len(answers) == len(fired)
        for number, shot in enumerate(fired):
            shot.hear(answers[number] if sure else None)
            self._shots.remove(shot)

    # Hearing

    async def _read(self, link: Link) -> None:
        try:
            while True:
                received = await link.read()
                for reply in self._reader.feed(received.data, received.at_ns):
                    self._take(reply)
        except LinkClosed as error:
            self._lost(link, error)

    def _take(self, reply: Reply) -> None:
        if any(shot.begin_ns + shot.wire_ns <= reply.at_ns <= shot.end_ns for shot in self._shots):
            self._answers.append(reply)
            return
        waiting = self._waiting
        if waiting is not None and reply.at_ns >= waiting.first_ns:
            waiting.replies.put_nowait(reply)
        elif self._clock.now_ns() >= self._settled_ns:
            # Nobody is asked, or nobody can have answered yet: a second answer to what was asked last.
            self._strays[self._last] += 1
            if waiting is None:
                self._settle(0)

    def _settle(self, characters: int) -> None:
        """Leave the line alone until no reply to what was just written can come any more."""
        until_ns = self._clock.now_ns() + self.wire_ns(characters) + self._answer_ns
        self._settled_ns = max(self._settled_ns, until_ns)

    def _lost(self, link: Link, error: LinkClosed) -> None:
        if self._link is link:
            self._link = None
            self._settled_ns = 0
            self._users.clear()
        if self._waiting is not None:
            self._waiting.replies.put_nowait(error)
        for shot in self._shots:
            shot.hear(None)
        self._shots.clear()
        self._answers.clear()


def _named(unit: int | None) -> str:
    return "the unit" if unit is None else f"unit {unit}"
