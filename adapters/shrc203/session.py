"""The conversation on the line: one command at a time, asynchronous lines told from replies, steps found again.

Every command gets exactly one line in the order of arrival (L229-L237). Between them come completion lines `1`, `2`,
`3`, and `COMP` and `TRIG` of programs. A stop and the line that starts a move are written beside the conversation;
their replies have their place in the same queue.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from adapters.contract import CannotDo, DriverFault
from adapters.shrc203.replies import ANYTHING, COMMAND, DONE, MODE, REFUSALS, Form, refusal
from orchestrator.clock.base import NS_PER_MS, Clock, Timer, sleep_ns
from orchestrator.link.base import Link, LinkClosed

EOL = "\r\n"
COMPLETIONS = ("1", "2", "3")
PROGRAM_EVENTS = ("COMP", "TRIG")
LONGEST_REPLY = 128  # characters that a reply may take to come in, beyond the time allowed for answering
_QUIET_NS = 30 * NS_PER_MS  # nothing comes this long: no late reply is on its way any more
_TRIES = 3


@dataclass(frozen=True, slots=True)
class Line:
    """A line as it came. at_ns: host time when its end was taken from the operating system. asked_ns: when what it
    answers was written, 0 for what nobody has asked."""

    text: str
    at_ns: int
    asked_ns: int = 0


class _Owed(Exception):
    """A completion is owed: a bare digit could be either."""


class Pending:
    """A command whose reply is still to come. `reply` is None when nobody waits for it."""

    def __init__(self, command: str, form: Form, written_ns: int, awaited: bool) -> None:
        self.command = command
        self.form = form
        self.written_ns = written_ns
        self.reply: asyncio.Future[Line] | None = asyncio.get_running_loop().create_future() if awaited else None
        self.timer: Timer | None = None

    def settle(self, line: Line) -> None:
        if self.timer is not None:
            self.timer.cancel()
        if self.reply is not None and not self.reply.done():
            self.reply.set_result(replace(line, asked_ns=self.written_ns))

    def fail(self, error: Exception) -> None:
        if self.timer is not None:
            self.timer.cancel()
        if self.reply is not None and not self.reply.done():
            self.reply.set_exception(error)
            self.reply.exception()  # looked at: a waiter that was cancelled meanwhile leaves no unheard error


class Session:
    """The conversation with one unit. char_ns: one character on the slowest wire of the way."""

    def __init__(self, link: Link, clock: Clock, char_ns: int, answer_ns: int) -> None:
        self.link = link
        self.char_ns = char_ns
        self._clock = clock
        self._answer_ns = answer_ns
        self._turn = asyncio.Lock()
        self._queue: deque[Pending] = deque()
        self._rest = b""
        self._astray = True  # nobody knows what was said before
        self._searching = False
        self._closed: LinkClosed | None = None
        self._quiet = (0, 0)
        self._reader = asyncio.get_running_loop().create_task(self._read())
        self.owed: set[int] = set()
        self._owed_since_ns = 0
        self._each: Callable[[int, int], None] | None = None
        self.abandoned = False
        self._before: set[int] = set()
        self.completed: dict[int, int] = {}
        self.changed = asyncio.Event()

    async def close(self) -> None:
        self._reader.cancel()
        await self.link.close()
        self._lose(LinkClosed(f"{self.link.place} is closed"))

    # Saying things

    async def ask(self, command: str, form: Form) -> str:
        """The reply to a query, without its blanks. A query that went wrong on the wire is asked once more."""
        line = await self.ask_line(command, form)
        return line.text

    async def ask_digits(self, command: str, form: Form) -> str | None:
        """Like `ask`, for what may be answered by a bare digit; None while a completion is owed."""

        def still() -> None:
            if self.owed:
                raise _Owed

        try:
            return (await self.ask_line(command, form, still)).text
        except _Owed:
            return None

    async def ask_line(self, command: str, form: Form, still: Callable[[], None] | None = None) -> Line:
        """Like `ask`, with the time stamp of the reply. still: as for `tell`."""
        try:
            line = await self._exchange(command, form, still)
            if line.text not in REFUSALS:
                return line
        except DriverFault:
            self._astray = True
        line = await self._exchange(command, form, still)
        if line.text in REFUSALS:
            said = refusal(command)
            raise DriverFault(said.code, said.text, said.remedy)
        return line

    async def ask_if_any(self, command: str, form: Form) -> str | None:
        """The reply to a query that is refused when there is nothing to tell; None then."""
        line = await self._exchange(command, form)
        return None if line.text in REFUSALS else line.text

    async def try_to_ask(self, command: str, form: Form) -> Line | None:
        """The reply to a query that is not worth asking twice; None when it goes wrong."""
        try:
            line = await self._exchange(command, form)
        except DriverFault:
            self._astray = True
            return None
        return None if line.text in REFUSALS else line

    async def tell(self, command: str, still: Callable[[], None] | None = None) -> None:
        """Give a setting. Raises `CannotDo` when the controller refuses it.

        still: called when it is the command's turn; if it raises, nothing is sent.
        """
        line = await self._exchange(command, DONE, still)
        if line.text in REFUSALS:
            said = refusal(command)
            raise CannotDo(said.code, said.text, said.remedy)

    async def try_to_tell(self, command: str) -> bool:
        """Give a setting that may well be refused; whether it was taken."""
        line = await self._exchange(command, DONE)
        return line.text not in REFUSALS

    async def tell_and_hear(self, command: str, still: Callable[[], None] | None = None) -> str:
        """Like `tell`; what the unit has understood of it (`?:CMD`), with nothing said in between."""
        async with self._turn:
            await self._prepare()
            if still is not None:
                still()
            line = await self._once(command, DONE)
            if line.text not in REFUSALS:
                return (await self._once("?:CMD", COMMAND)).text.upper()
        said = refusal(command)
        raise CannotDo(said.code, said.text, said.remedy)

    async def converse(self, command: str) -> str:
        """Any line, and whatever is said to it."""
        return (await self._exchange(command, ANYTHING)).text

    def interrupt(self, *commands: str) -> int:
        """Write past everything else, at once; gives the instant. Each of our lines is handed over whole, so that
        this is always at the beginning of a line."""
        for command in commands:
            self._enqueue(command, DONE, awaited=False)
        return self.link.write("".join(command + EOL for command in commands).encode())

    def send(self, command: str, form: Form) -> "asyncio.Future[Line]":
        """Write a line at once, behind what has been written, and give what will be its reply."""
        pending = self._enqueue(command, form, awaited=True)
        self.link.write((command + EOL).encode())
        assert pending.reply is not None
        return pending.reply

    def expect(self, command: str, written_by_ns: int, latest_ns: int) -> Pending:
        """Somebody else writes `command` by `written_by_ns`, or as late as `latest_ns` while everybody else is quiet:
        keep the place of its reply."""
        pending = self._enqueue(command, DONE, awaited=True, written_ns=written_by_ns)
        self._due(pending, latest_ns)
        return pending

    def written(self, pending: Pending, at_ns: int) -> None:
        """What was expected was written at that instant."""
        pending.written_ns = at_ns
        if pending in self._queue:
            self._due(pending, at_ns)

    def forget(self, pending: Pending) -> None:
        """The line was never written."""
        if pending.timer is not None:
            pending.timer.cancel()
        if pending in self._queue:
            self._queue.remove(pending)

    def owe(self, motors: set[int], each: Callable[[int, int], None] | None = None, before: Iterable[int] = ()) -> None:
        """From now on a bare digit is the completion of one of `motors`, and its only one; but not while a question
        is to be answered by one that was asked before.

        each: called with motor and instant; then more of the same motor are owed, until `owe_nothing`. before: motors
        that complete another move before that.
        """
        self.owed = set(motors)
        self._owed_since_ns = self._clock.now_ns()
        self._before = set(before)
        self._each = each
        self.completed = {}
        self.abandoned = False

    def owe_again(self, motor: int) -> None:
        """What came was not the completion of this motor's move."""
        self.completed.pop(motor, None)
        self.owed.add(motor)

    def owe_nothing(self) -> None:
        """No completion can come any more."""
        self.owed = set()
        self._each = None
        self.abandoned = False

    def abandon(self) -> None:
        """Nobody waits for the completions any more; they may come nevertheless."""
        self.abandoned = bool(self.owed)

    def keep_quiet(self, until_ns: int, line_at_ns: int) -> None:
        """Begin no exchange that would still be on the line when another writer writes, at `line_at_ns`."""
        self._quiet = (line_at_ns - self._answer_ns // 10 - self.wire_ns(2 * LONGEST_REPLY), until_ns)

    def end_quiet(self) -> None:
        self._quiet = (0, 0)

    def wire_ns(self, characters: int) -> int:
        """How long so many characters are on the wire."""
        return characters * self.char_ns

    # Inside

    async def _exchange(self, command: str, form: Form, still: Callable[[], None] | None = None) -> Line:
        async with self._turn:
            await self._prepare()
            if still is not None:
                still()
            return await self._once(command, form)

    async def _prepare(self) -> None:
        while self._quiet[0] <= self._clock.now_ns() < self._quiet[1]:
            await sleep_ns(self._clock, NS_PER_MS)
        if self._astray:
            await self._find_step()

    async def _once(self, command: str, form: Form) -> Line:
        pending = self._enqueue(command, form, awaited=True)
        self.link.write((command + EOL).encode())
        assert pending.reply is not None
        return await pending.reply

    def _enqueue(self, command: str, form: Form, *, awaited: bool, written_ns: int | None = None) -> Pending:
        if self._closed is not None:
            raise self._closed
        since_ns = self._clock.now_ns() if written_ns is None else written_ns
        pending = Pending(command, form, since_ns, awaited)
        # A line that somebody else writes later is answered later: what is said until then has its place before it.
        later = sum(each.written_ns > since_ns for each in self._queue)
        self._queue.insert(len(self._queue) - later, pending)
        self._due(pending, since_ns)
        return pending

    def _due(self, pending: Pending, since_ns: int) -> None:
        """It is to be answered in time, counted from when it is written."""
        if pending.timer is not None:
            pending.timer.cancel()
        ahead = sum(len(each.command) + len(EOL) + LONGEST_REPLY for each in self._queue)
        pending.timer = self._clock.call_at_ns(
            since_ns + self._answer_ns + self.wire_ns(ahead), lambda: self._expire(pending)
        )

    def _expire(self, pending: Pending) -> None:
        if pending in self._queue:
            self._queue.remove(pending)
        self._astray = True
        pending.fail(
            DriverFault(
                "no-answer",
                f"no answer to {pending.command!r} on {self.link.place}; expected {pending.form.words}",
                "check power, cable, baud rate, and that the unit is in HOST mode",
            )
        )

    async def _find_step(self) -> None:
        """Find the way back: end what is half-typed, ask for the mode, and drop everything that does not fit it."""
        while self._queue:  # each has its timer, so that this ends
            await sleep_ns(self._clock, 5 * NS_PER_MS)
            self._require_open()
        for left in reversed(range(_TRIES)):
            self._searching = True
            try:
                self.link.write(EOL.encode())
                await self._once("?:MODE", MODE)
            except DriverFault:
                if not left:
                    raise
                continue
            finally:
                self._searching = False
            self._searching = True
            try:
                await sleep_ns(self._clock, _QUIET_NS)
            finally:
                self._searching = False
            self._astray = False
            return

    def _require_open(self) -> None:
        if self._closed is not None:
            raise self._closed

    async def _read(self) -> None:
        try:
            while True:
                received = await self.link.read()
                *whole, self._rest = (self._rest + received.data).split(b"\n")
                for each in whole:
                    text = each.decode("latin-1").replace(" ", "").strip("\r\0")
                    if text:
                        self._take(Line(text, received.at_ns))
        except LinkClosed as error:
            self._lose(error)

    def _lose(self, error: LinkClosed) -> None:
        self._closed = error
        while self._queue:
            self._queue.popleft().fail(error)
        self.changed.set()

    def _take(self, line: Line) -> None:
        """Say what a line is: completion, program event, reply, or garbage."""
        if line.text in PROGRAM_EVENTS:
            return
        if line.text in COMPLETIONS and self._is_completion(line):
            return
        pending = next((each for each in self._queue if each.form.fits(line.text)), None)
        head = self._queue[0] if self._queue else None
        if self._searching:
            if pending is not None:
                self._queue.remove(pending)
                pending.settle(line)
        elif head is None:
            self._astray = True  # a reply that nobody waits for: what comes next may be one too late
        else:
            self._queue.popleft()
            if head is pending or line.text in REFUSALS:
                head.settle(line)
                return
            self._astray = True
            head.fail(
                DriverFault(
                    "garbage",
                    f"sent {head.command!r}, expected {head.form.words}, received {line.text!r}",
                    "check cable, baud rate and ground; is another program on the same line?",
                )
            )

    def _is_completion(self, line: Line) -> bool:
        motor = int(line.text)
        asked = self._queue[0] if self._queue and self._queue[0].form.fits(line.text) else None
        if asked is not None and asked.written_ns <= self._owed_since_ns:
            return False  # what is owed is begun behind that question
        if motor in self.owed and self._each is not None:
            self._each(motor, line.at_ns)
            self.changed.set()
            return True
        if motor in self.owed and motor in self._before:
            self._before.discard(motor)
            return True
        if motor in self.owed:
            self.owed.discard(motor)
            self.completed[motor] = line.at_ns
            self.changed.set()
            return True
        # Nobody waits for it: still a completion, of a move that somebody else made, unless it answers the question.
        return asked is None

    async def wait_changed(self, until_ns: int) -> None:
        """Until a completion comes, somebody sets `changed`, the link is lost (`LinkClosed`), or that instant."""
        timer = self._clock.call_at_ns(until_ns, self.changed.set)
        try:
            await self.changed.wait()
        finally:
            timer.cancel()
        self.changed.clear()
        self._require_open()
