"""The exchanges on one connection: batches of lines, each closed by a token that returns after its answers.

Only queries are answered, several answers look alike (`?s` and `?p`), some have as many lines as the controller has
axes, and messages may come in between. So every batch ends with `us<token>` and `?us` (L3152, L4388): everything
received until the token is its answers, whole and in order, and late answers of a lost batch are recognised by its
token. Before a new token is sent the old one is read: it is 0 after a restart (L3158). A blocked controller answers
only `?s` and `?p` (L1404): those are queried without a token then.
"""

import asyncio
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from adapters.contract import NULL_LOG
from adapters.ppsmc.replies import ASK_POSITIONS, ASK_STATUS, ASK_USER_STATUS, FormattedQuery, StatusBits, parse_states
from adapters.toolkit.pending_reply import PendingReply
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal

EOL = "\r\n"
# Ends a half-typed line without completing it: `goto1:5` must not become a command by this session's line end.
SPOILER = "!"
_FIRST_TOKEN = 1_000_000  # not a port byte, and not a value that a user would choose
_LAST_TOKEN = 2_000_000_000
_MOST_LINES = 5000
_LINES_AT_MOST = 14  # of an exchange with queries only
_LONGEST_ANSWER = 120  # characters of one answer, for its transmission time on a serial line
_DELIMITERS = re.compile(r"[\r\n]")


@dataclass(frozen=True, slots=True)
class PpSmcLine:
    """A received line. at_ns: host time when its end was taken from the operating system."""

    text: str
    at_ns: int


@dataclass(frozen=True, slots=True)
class TokenReply:
    """The answers to a batch, by query, and all of its lines. written_ns: when the batch was handed over (at the
    latest)."""

    answers: dict[str, list[PpSmcLine]]
    written_ns: int
    all_lines: list[PpSmcLine]

    def first_line(self, query: FormattedQuery) -> PpSmcLine:
        return self.answers[query.text][0]

    def first_text(self, query: FormattedQuery) -> str:
        return self.first_line(query).text

    def reply_texts(self, query: FormattedQuery) -> list[str]:
        return [line.text for line in self.answers[query.text]]

    def __contains__(self, query: FormattedQuery) -> bool:
        return query.text in self.answers


@dataclass(slots=True)
class PendingBatch:
    """A batch whose answers are outstanding. wait_ns: their timeout after the write."""

    token: str
    queries: tuple[FormattedQuery, ...]
    data: bytes
    written_ns: int
    wait_ns: int
    answer: PendingReply[TokenReply] = field(default_factory=PendingReply[TokenReply])


class PpSmcSession:
    """The exchanges with one controller.

    slow_ns: the slowest execution of one command.
    token: the last token of an earlier connection, 0 without any.
    restarted: the controller has lost the token; stays set until it is handled.
    greeting: the controller's first message.
    """

    def __init__(self, link: Link, clock: Clock, answer_ns: int, slow_ns: int, token: int = 0) -> None:
        self.link = link
        self.log = NULL_LOG
        self.greeting = ""
        self.blocked = False
        self.restarted = False
        self._known = token > 0
        self._clock = clock
        self._answer_ns = answer_ns
        self._slow_ns = slow_ns
        self._token = max(token, _FIRST_TOKEN)
        self._turn = asyncio.Lock()
        self._pending: dict[str, PendingBatch] = {}
        self._lost: set[str] = set()
        self._received_lines: list[PpSmcLine] = []
        self._plain: asyncio.Event | None = None
        self._partial_line = ""
        self._out_of_step = True  # the previous traffic is unknown
        self._closed: LinkClosed | None = None
        self._quiet = (0, 0)
        self._reader = asyncio.get_running_loop().create_task(self._read_lines())

    async def close(self) -> None:
        self._reader.cancel()
        await self.link.close()
        self._handle_link_loss(LinkClosed(f"{self.link.endpoint} is closed"))

    @property
    def last_token(self) -> int:
        """The last token that may have been written: the answer to `?us` as long as the controller is not restarted."""
        return self._token

    # Exchanges

    async def send_queries(self, *queries: FormattedQuery) -> TokenReply:
        """Return the answers to queries, which are repeated once when they fail. Raises `ControllerFault`."""
        return await self.send_repeatable((), *queries)

    async def send_repeatable(self, commands: Sequence[str], *queries: FormattedQuery) -> TokenReply:
        """Send commands that may be sent twice, then queries; all are repeated once on a failure."""
        try:
            return await self.send_once(commands, *queries)
        except ControllerFault as error:
            if error.code == "blocked":
                raise
            self._out_of_step = True
            self.log.warning(f"the exchange is repeated: {error.text}", code=error.code)
        return await self.send_once(commands, *queries)

    async def send_once(
        self, commands: Sequence[str], *queries: FormattedQuery, before_send: Callable[[], None] | None = None
    ) -> TokenReply:
        """Send commands, then queries, without repetition. before_send: called when it is its turn; if it raises,
        nothing is
        sent."""
        async with self._turn:
            await self._synchronise()
            if before_send is not None:
                before_send()
            return await self._run_batch(commands, queries)

    def handle_block(self) -> None:
        """Handle a `block` under way: it clears the controller's command buffers (L1409), and outstanding queries stay
        unanswered."""
        self.blocked = True
        for pending in list(self._pending.values()):
            self.remove_expected(pending)
            self._lost.add(pending.token)
            pending.answer.set_failure(_blocked_fault(self.link.endpoint))

    async def query_blocked(self) -> tuple[PpSmcLine, PpSmcLine]:
        """Query `?s` and `?p`, which a blocked controller answers, too; repeated, because an arriving block clears even
        these.

        `blocked` shows whether it is.
        """
        async with self._turn:
            try:
                return await self._query_plain()
            except ControllerFault as error:
                self.log.warning(f"the query of a blocked controller is repeated: {error.text}")
                return await self._query_plain()

    async def unblock_controller(self) -> None:
        """Send `unblock`, in both of the manual's spellings (L1396, L3126); then start the exchanges again."""
        async with self._turn:
            self._write_lines("unblock", "unlock")
            self.blocked = False
            self._out_of_step = True

    async def send_raw(self, command: str) -> str:
        """Send any command, and return whatever the reply is."""
        async with self._turn:
            if self.blocked:
                self._write_lines(command)
                self.blocked = False
                await sleep_ns(self._clock, self._slow_ns)
                return ""
            await self._synchronise()
            pending = self._build_batch((command,), ())
            self.link.write(pending.data)
            reply = await pending.answer.future
            self._out_of_step = True  # it may have changed the delimiters of answers
            return "\n".join(line.text for line in reply.all_lines[:-1])

    def write_at_once(self, *commands: str) -> int:
        """Write at once, bypassing everything else; return the instant. Each command of the session is handed over as a
        whole, so that this is always at the beginning of a line."""
        return self._write_lines(*commands)

    def expect_batch(
        self, commands: Sequence[str], queries: Sequence[FormattedQuery], written_by_ns: int
    ) -> PendingBatch:
        """Expect the answers to a batch whose `data` another writer writes by that instant."""
        return self._build_batch(commands, queries, written_by_ns)

    def record_write(self, pending: PendingBatch, at_ns: int) -> None:
        """Record when the expected batch was written."""
        pending.written_ns = at_ns
        if pending.token in self._pending:
            pending.answer.cancel_timeout()
            pending.answer.timer = self._clock.call_at_ns(
                at_ns + pending.wait_ns, partial(self._handle_timeout, pending)
            )

    def remove_expected(self, pending: PendingBatch) -> None:
        """Remove an expected batch that was never written."""
        pending.answer.cancel_timeout()
        self._pending.pop(pending.token, None)

    def exclusive_lock(self) -> asyncio.Lock:
        """Return the lock for exclusive use of the connection."""
        return self._turn

    def keep_quiet(self, until_ns: int, line_at_ns: int) -> None:
        """Begin no exchange that would still be executed when another writer writes, at `line_at_ns`."""
        self._quiet = (line_at_ns - _LINES_AT_MOST * self._slow_ns - self.wire_ns(4 * _LONGEST_ANSWER), until_ns)

    def end_quiet(self) -> None:
        self._quiet = (0, 0)

    def wire_ns(self, characters: int) -> int:
        """Return the transmission time of `characters` characters."""
        return characters * self.link.char_ns

    # Internals

    def _write_lines(self, *commands: str) -> int:
        return self.link.write("".join(command + EOL for command in commands).encode())

    def _build_batch(
        self, commands: Sequence[str], queries: Sequence[FormattedQuery], written_ns: int | None = None
    ) -> PendingBatch:
        if self._closed is not None:
            raise self._closed
        self._token = self._token + 1 if self._token < _LAST_TOKEN else _FIRST_TOKEN
        token = str(self._token)
        lines = [*commands, *(query.text for query in queries), "?us", f"us{token}", "?us"]
        data = "".join(line + EOL for line in lines).encode()
        since_ns = self._clock.now_ns() if written_ns is None else written_ns
        answers = sum(20 if query.form.many else 1 for query in queries)
        wait_ns = self._answer_ns + len(lines) * self._slow_ns + self.wire_ns(len(data) + answers * _LONGEST_ANSWER)
        earlier_count = sum(pending_reply.written_ns <= since_ns for pending_reply in self._pending.values())
        wait_ns += (earlier_count + 1) * self._slow_ns * 10
        pending = self._pending[token] = PendingBatch(token, tuple(queries), data, since_ns, wait_ns)
        pending.answer.timer = self._clock.call_at_ns(since_ns + wait_ns, partial(self._handle_timeout, pending))
        return pending

    async def _run_batch(self, commands: Sequence[str], queries: Sequence[FormattedQuery]) -> TokenReply:
        pending = self._build_batch(commands, queries)
        self.link.write(pending.data)
        try:
            return await pending.answer.future
        except ControllerFault as error:
            if error.code != "no-answer":
                raise
            await self._detect_block(error)
            raise

    async def _synchronise(self) -> None:
        while self._quiet[0] <= self._clock.now_ns() < self._quiet[1]:
            await sleep_ns(self._clock, NS_PER_MS)
        if self.blocked:
            raise _blocked_fault(self.link.endpoint)
        if self._out_of_step:
            # End a half-typed line (each TCP connection has its own line buffer), then set the delimiters.
            spoiler = (SPOILER,) if self.link.char_ns else ()
            await self._run_batch((*spoiler, "txdel3", "echo0"), ())
            self._out_of_step = False
            self.log.info("the session is synchronised", place=self.link.endpoint)

    async def _detect_block(self, error: ControllerFault) -> None:
        try:
            await self._query_plain()
        except ControllerFault:
            raise error from None
        if self.blocked:
            self.log.warning("the controller is blocked: a client has sent `block`")
            raise _blocked_fault(self.link.endpoint) from None

    async def _query_plain(self) -> tuple[PpSmcLine, PpSmcLine]:
        self._require_open()
        self._received_lines.clear()
        change_event = self._plain = asyncio.Event()
        until_ns = self._clock.now_ns() + self._answer_ns + 2 * self._slow_ns + self.wire_ns(2 * _LONGEST_ANSWER)
        timer = self._clock.call_at_ns(until_ns, change_event.set)
        try:
            self._write_lines(ASK_STATUS.text, ASK_POSITIONS.text)
            while True:
                await change_event.wait()
                self._require_open()
                change_event.clear()
                reply_lines = [line for line in self._received_lines if ASK_POSITIONS.form.matches_text(line.text)]
                if len(reply_lines) >= 2 and ASK_STATUS.form.matches_text(reply_lines[0].text):
                    self._received_lines.clear()
                    self.blocked = any(
                        state_bits & StatusBits.BLOCKED for state_bits in parse_states(reply_lines[0].text).values()
                    )
                    return reply_lines[0], reply_lines[1]
                if self._clock.now_ns() >= until_ns:
                    raise self._no_answer(f"{ASK_STATUS.text} and {ASK_POSITIONS.text}")
        finally:
            timer.cancel()
            self._plain = None

    def _handle_timeout(self, pending: PendingBatch) -> None:
        if self._pending.pop(pending.token, None) is None:
            return
        self._lost.add(pending.token)
        self._out_of_step = True
        first = pending.data.decode().split(EOL, 1)[0]
        pending.answer.set_failure(self._no_answer(f"the lines from {first!r}"))

    def _no_answer(self, what: str) -> ControllerFault:
        return ControllerFault(
            "no-answer",
            f"no reply to {what} on {self.link.endpoint}",
            "check power and cable; a controller that is shutting down or shows a dialogue does not answer",
        )

    def _require_open(self) -> None:
        if self._closed is not None:
            raise self._closed

    async def _read_lines(self) -> None:
        try:
            while True:
                chunk = await self.link.read()
                *whole_lines, self._partial_line = _DELIMITERS.split(self._partial_line + chunk.data.decode("latin-1"))
                for whole_line in whole_lines:
                    text = whole_line.strip("\x02\x03\0 \t")  # the frame of txp1 (L4708)
                    if text:
                        self._handle_line(PpSmcLine(text, chunk.at_ns))
        except LinkClosed as error:
            self._handle_link_loss(error)

    def _handle_link_loss(self, error: LinkClosed) -> None:
        self._closed = error
        for pending in list(self._pending.values()):
            pending.answer.set_failure(error)
        self._pending.clear()
        if self._plain is not None:
            self._plain.set()

    def _handle_line(self, line: PpSmcLine) -> None:
        if self._out_of_step and not self.greeting and line.text.lower().startswith("smc "):
            self.greeting = line.text
            return
        pending = self._pending.pop(line.text, None)
        if pending is not None:
            self._assign_answers(pending)
            self._received_lines.clear()
        elif line.text in self._lost:
            # The end of a lost batch; or the present answer to `?us`, because that batch was executed after all.
            self._lost.discard(line.text)
            self._received_lines = [line]
        else:
            self._received_lines.append(line)
            del self._received_lines[:-_MOST_LINES]
        if self._plain is not None:
            self._plain.set()

    def _assign_answers(self, pending: PendingBatch) -> None:
        """Assign the lines before the token to the queries; a line that matches none is a message (echo, L1824)."""
        answers: dict[str, list[PpSmcLine]] = {}
        lines_left, received_lines = list(self._received_lines), list(self._received_lines)
        for query in (*pending.queries, ASK_USER_STATUS):
            query_lines: list[PpSmcLine] = []
            while lines_left:
                if not query.form.matches_text(lines_left[0].text):
                    if query_lines:
                        break
                    lines_left.pop(0)
                    continue
                query_lines.append(lines_left.pop(0))
                if not query.form.many:
                    break
            if not query_lines and not query.form.many:
                self._out_of_step = True
                received_text = "; ".join(line.text for line in self._received_lines) or "nothing"
                pending.answer.set_failure(
                    ControllerFault(
                        "garbage",
                        f"asked {query.text!r} on {self.link.endpoint}, expected {query.form.words}, "
                        f"received {received_text[:200]!r}",
                        "check cable and ground; is the option installed that the query concerns?",
                    )
                )
                return
            answers[query.text] = query_lines
        if answers[ASK_USER_STATUS.text][0].text == "0":
            self.restarted = self.restarted or self._known
        self._known = True
        pending.answer.set_reply(TokenReply(answers, pending.written_ns, received_lines))


def _blocked_fault(place: str) -> ControllerFault:
    return ControllerFault(
        "blocked",
        f"the controller at {place} is blocked: a client has sent `block`",
        "ensure that it may move, then unblock it with `tutti reset` (it sends `unblock`)",
    )


def as_refusal(error: ControllerFault) -> Refusal:
    """Return the same as a refusal: nothing has begun."""
    return Refusal(error.code, error.text, error.remedy)
