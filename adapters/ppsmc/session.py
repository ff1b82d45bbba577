"""The conversation on one connection: batches of lines, each closed by a token that comes back behind its answers.

Only queries are answered, several answers look alike (`?s` and `?p`), some have as many lines as the unit has axes, and
messages may come in between. So every batch ends with `us<token>` and `?us` (L3152, L4388): what comes until the token
is its answers, whole and in order, and what a lost batch still sends is told by its own token. Before a new token is
given the old one is read: it is 0 after a restart (L3158). A blocked unit answers
`?s` and `?p` alone (L1404): those are asked without a token then.
"""

import asyncio
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from adapters.contract import CannotDo, DriverFault
from adapters.ppsmc.replies import ASK_POSITIONS, ASK_STATUS, ASK_USER_STATUS, Bits, Query, states
from orchestrator.clock.base import NS_PER_MS, Clock, Timer, sleep_ns
from orchestrator.link.base import Link, LinkClosed

EOL = "\r\n"
# Ends a half-typed line without completing it: `goto1:5` must not become a command by our line end.
SPOILER = "!"
_FIRST_TOKEN = 1_000_000  # no port byte, and nothing that a person would choose
_LAST_TOKEN = 2_000_000_000
_MOST_LINES = 5000
_LINES_AT_MOST = 14  # of an exchange that only asks
_LONGEST_ANSWER = 120  # characters of one answer, for the time that it takes on a serial line
_DELIMITERS = re.compile(r"[\r\n]")


@dataclass(frozen=True, slots=True)
class Line:
    """A line as it came. at_ns: host time when its end was taken from the operating system."""

    text: str
    at_ns: int


@dataclass(frozen=True, slots=True)
class Heard:
    """What was said to a batch, by query and all of it. written_ns: when the batch was handed over (or would be, at
    the latest)."""

    answers: dict[str, list[Line]]
    written_ns: int
    said: list[Line]

    def one(self, query: Query) -> Line:
        return self.answers[query.text][0]

    def text(self, query: Query) -> str:
        return self.one(query).text

    def lines(self, query: Query) -> list[str]:
        return [line.text for line in self.answers[query.text]]

    def __contains__(self, query: Query) -> bool:
        return query.text in self.answers


Answered = asyncio.Future[Heard]


@dataclass(slots=True)
class Pending:
    """A batch whose answers are still to come, for so long after it is written."""

    token: str
    queries: tuple[Query, ...]
    data: bytes
    written_ns: int
    wait_ns: int
    answered: Answered = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    timer: Timer | None = None

    def settle(self, heard: Heard) -> None:
        if self.timer is not None:
            self.timer.cancel()
        if not self.answered.done():
            self.answered.set_result(heard)

    def fail(self, error: Exception) -> None:
        if self.timer is not None:
            self.timer.cancel()
        if not self.answered.done():
            self.answered.set_exception(error)
            self.answered.exception()  # looked at: a waiter that was cancelled meanwhile leaves no unheard error


class Session:
    """The conversation with one unit.

    slow_ns: the slowest execution of one command. token: the last one of an earlier connection, 0 without any.
    restarted: the unit has forgotten the token; stays so until somebody takes note.
    greeting: what the unit said first.
    """

    def __init__(self, link: Link, clock: Clock, answer_ns: int, slow_ns: int, token: int = 0) -> None:
        self.link = link
        self.greeting = ""
        self.blocked = False
        self.restarted = False
        self._known = token > 0
        self._clock = clock
        self._answer_ns = answer_ns
        self._slow_ns = slow_ns
        self._token = max(token, _FIRST_TOKEN)
        self._turn = asyncio.Lock()
        self._pending: dict[str, Pending] = {}
        self._lost: set[str] = set()
        self._heard: list[Line] = []
        self._plain: asyncio.Event | None = None
        self._rest = ""
        self._astray = True  # nobody knows what was said before
        self._closed: LinkClosed | None = None
        self._quiet = (0, 0)
        self._reader = asyncio.get_running_loop().create_task(self._read())

    async def close(self) -> None:
        self._reader.cancel()
        await self.link.close()
        self._lose(LinkClosed(f"{self.link.place} is closed"))

    @property
    def token(self) -> int:
        """The last token that may have been written: what `?us` gives as long as the unit is not restarted."""
        return self._token

    # Saying things

    async def ask(self, *queries: Query) -> Heard:
        """The answers to queries, which are asked once more when they go wrong. Raises `DriverFault`."""
        return await self.settle((), *queries)

    async def settle(self, commands: Sequence[str], *queries: Query) -> Heard:
        """Give commands that may as well be given twice, then ask; all once more when it goes wrong."""
        try:
            return await self.say(commands, *queries)
        except DriverFault as error:
            if error.fault.code == "blocked":
                raise
            self._astray = True
        return await self.say(commands, *queries)

    async def say(self, commands: Sequence[str], *queries: Query, still: Callable[[], None] | None = None) -> Heard:
        """Give commands, then ask. Not repeated. still: called when it is its turn; if it raises, nothing is sent."""
        async with self._turn:
            await self._prepare()
            if still is not None:
                still()
            return await self._once(commands, queries)

    def block_sent(self) -> None:
        """`block` is on its way: it clears the unit's command buffers (L1409), and what was asked stays unanswered."""
        self.blocked = True
        for pending in list(self._pending.values()):
            self.forget(pending)
            self._lost.add(pending.token)
            pending.fail(_blocked(self.link.place))

    async def ask_blocked(self) -> tuple[Line, Line]:
        """`?s` and `?p`, which a blocked unit answers, too; asked again, for a block clears even them when it comes.

        `blocked` says whether it is.
        """
        async with self._turn:
            try:
                return await self._ask_plain()
            except DriverFault:
                return await self._ask_plain()

    async def release(self) -> None:
        """`unblock`, in both of the manual's spellings (L1396, L3126); then everything is asked for anew."""
        async with self._turn:
            self._write("unblock", "unlock")
            self.blocked = False
            self._astray = True

    async def converse(self, command: str) -> str:
        """Any line, and whatever is said to it."""
        async with self._turn:
            if self.blocked:
                self._write(command)
                self.blocked = False
                await sleep_ns(self._clock, self._slow_ns)
                return ""
            await self._prepare()
            pending = self._batch((command,), ())
            self.link.write(pending.data)
            heard = await pending.answered
            self._astray = True  # it may have changed how answers end
            return "\n".join(line.text for line in heard.said[:-1])

    def interrupt(self, *commands: str) -> int:
        """Write past everything else, at once; gives the instant. Our lines are handed over whole, so that this is
        always at the beginning of a line."""
        return self._write(*commands)

    def expect(self, commands: Sequence[str], queries: Sequence[Query], written_by_ns: int) -> Pending:
        """Somebody else writes the batch's `data` by that instant: keep the place of its answers."""
        return self._batch(commands, queries, written_by_ns)

    def written(self, pending: Pending, at_ns: int) -> None:
        """The batch that was expected was written at that instant."""
        pending.written_ns = at_ns
        if pending.token in self._pending and pending.timer is not None:
            pending.timer.cancel()
            pending.timer = self._clock.call_at_ns(at_ns + pending.wait_ns, partial(self._expire, pending))

    def forget(self, pending: Pending) -> None:
        """The batch was never written."""
        if pending.timer is not None:
            pending.timer.cancel()
        self._pending.pop(pending.token, None)

    def alone(self) -> asyncio.Lock:
        """Held by whoever must have nothing else under way on the connection."""
        return self._turn

    def keep_quiet(self, until_ns: int, line_at_ns: int) -> None:
        """Begin no exchange that would still be executed when another writer writes, at `line_at_ns`."""
        self._quiet = (line_at_ns - _LINES_AT_MOST * self._slow_ns - self.wire_ns(4 * _LONGEST_ANSWER), until_ns)

    def end_quiet(self) -> None:
        self._quiet = (0, 0)

    def wire_ns(self, characters: int) -> int:
        """How long so many characters are on the wire."""
        return characters * self.link.char_ns

    # Inside

    def _write(self, *commands: str) -> int:
        return self.link.write("".join(command + EOL for command in commands).encode())

    def _batch(self, commands: Sequence[str], queries: Sequence[Query], written_ns: int | None = None) -> Pending:
        if self._closed is not None:
            raise self._closed
        self._token = self._token + 1 if self._token < _LAST_TOKEN else _FIRST_TOKEN
        token = str(self._token)
        lines = [*commands, *(query.text for query in queries), "?us", f"us{token}", "?us"]
        data = "".join(line + EOL for line in lines).encode()
        since_ns = self._clock.now_ns() if written_ns is None else written_ns
        answers = sum(20 if query.form.many else 1 for query in queries)
        wait_ns = self._answer_ns + len(lines) * self._slow_ns + self.wire_ns(len(data) + answers * _LONGEST_ANSWER)
        before = sum(each.written_ns <= since_ns for each in self._pending.values())
        wait_ns += (before + 1) * self._slow_ns * 10
        pending = self._pending[token] = Pending(token, tuple(queries), data, since_ns, wait_ns)
        pending.timer = self._clock.call_at_ns(since_ns + wait_ns, partial(self._expire, pending))
        return pending

    async def _once(self, commands: Sequence[str], queries: Sequence[Query]) -> Heard:
        pending = self._batch(commands, queries)
        self.link.write(pending.data)
        try:
            return await pending.answered
        except DriverFault as error:
            if error.fault.code != "no-answer":
                raise
            await self._look_for_block(error)
            raise

    async def _prepare(self) -> None:
        while self._quiet[0] <= self._clock.now_ns() < self._quiet[1]:
            await sleep_ns(self._clock, NS_PER_MS)
        if self.blocked:
            raise _blocked(self.link.place)
        if self._astray:
            # End what is half-typed (each TCP connection has lines of its own), then agree on delimiters.
            spoiler = (SPOILER,) if self.link.char_ns else ()
            await self._once((*spoiler, "txdel3", "echo0"), ())
            self._astray = False

    async def _look_for_block(self, error: DriverFault) -> None:
        try:
            await self._ask_plain()
        except DriverFault:
            raise error from None
        if self.blocked:
            raise _blocked(self.link.place) from None

    async def _ask_plain(self) -> tuple[Line, Line]:
        self._require_open()
        self._heard.clear()
        changed = self._plain = asyncio.Event()
        until_ns = self._clock.now_ns() + self._answer_ns + 2 * self._slow_ns + self.wire_ns(2 * _LONGEST_ANSWER)
        timer = self._clock.call_at_ns(until_ns, changed.set)
        try:
            self._write(ASK_STATUS.text, ASK_POSITIONS.text)
            while True:
                await changed.wait()
                self._require_open()
                changed.clear()
                found = [line for line in self._heard if ASK_POSITIONS.form.fits(line.text)]
                if len(found) >= 2 and ASK_STATUS.form.fits(found[0].text):
                    self._heard.clear()
                    self.blocked = any(each & Bits.BLOCKED for each in states(found[0].text).values())
                    return found[0], found[1]
                if self._clock.now_ns() >= until_ns:
                    raise self._no_answer(f"{ASK_STATUS.text} and {ASK_POSITIONS.text}")
        finally:
            timer.cancel()
            self._plain = None

    def _expire(self, pending: Pending) -> None:
        if self._pending.pop(pending.token, None) is None:
            return
        self._lost.add(pending.token)
        self._astray = True
        first = pending.data.decode().split(EOL, 1)[0]
        pending.fail(self._no_answer(f"the lines from {first!r}"))

    def _no_answer(self, what: str) -> DriverFault:
        return DriverFault(
            "no-answer",
            f"no answer to {what} on {self.link.place}",
            "check power and cable; a unit that is shutting down or shows a dialogue does not answer",
        )

    def _require_open(self) -> None:
        if self._closed is not None:
            raise self._closed

    async def _read(self) -> None:
        try:
            while True:
                received = await self.link.read()
                *whole, self._rest = _DELIMITERS.split(self._rest + received.data.decode("latin-1"))
                for each in whole:
                    text = each.strip("\x02\x03\0 \t")  # the frame of txp1 (L4708)
                    if text:
                        self._take(Line(text, received.at_ns))
        except LinkClosed as error:
            self._lose(error)

    def _lose(self, error: LinkClosed) -> None:
        self._closed = error
        for pending in list(self._pending.values()):
            pending.fail(error)
        self._pending.clear()
        if self._plain is not None:
            self._plain.set()

    def _take(self, line: Line) -> None:
        if self._astray and not self.greeting and line.text.lower().startswith("smc "):
            self.greeting = line.text
            return
        pending = self._pending.pop(line.text, None)
        if pending is not None:
            self._answer(pending)
            self._heard.clear()
        elif line.text in self._lost:
            # The end of a lost batch; or what `?us` gives now because that batch was executed after all.
            self._lost.discard(line.text)
            self._heard = [line]
        else:
            self._heard.append(line)
            del self._heard[:-_MOST_LINES]
        if self._plain is not None:
            self._plain.set()

    def _answer(self, pending: Pending) -> None:
        """Share out the lines before the token; what fits nothing is a message (echo, L1824)."""
        answers: dict[str, list[Line]] = {}
        left, said = list(self._heard), list(self._heard)
        for query in (*pending.queries, ASK_USER_STATUS):
            mine: list[Line] = []
            while left:
                if not query.form.fits(left[0].text):
                    if mine:
                        break
                    left.pop(0)
                    continue
                mine.append(left.pop(0))
                if not query.form.many:
                    break
            if not mine and not query.form.many:
                self._astray = True
                said = "; ".join(line.text for line in self._heard) or "nothing"
                pending.fail(
                    DriverFault(
                        "garbage",
                        f"asked {query.text!r} on {self.link.place}, expected {query.form.words}, "
                        f"received {said[:200]!r}",
                        "check cable and ground; is the option installed that the question is about?",
                    )
                )
                return
            answers[query.text] = mine
        if answers[ASK_USER_STATUS.text][0].text == "0":
            self.restarted = self.restarted or self._known
        self._known = True
        pending.settle(Heard(answers, pending.written_ns, said))


def _blocked(place: str) -> DriverFault:
    return DriverFault(
        "blocked",
        f"the controller at {place} is blocked: somebody has sent `block`",
        "make sure that it may move, then release it with `tutti reset` (it sends `unblock`)",
    )


def refusal(error: DriverFault) -> CannotDo:
    """The same as a refusal: nothing has begun."""
    return CannotDo(error.fault.code, error.fault.text, error.fault.remedy)
