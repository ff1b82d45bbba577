"""The exchanges on the line: one command at a time, asynchronous lines distinguished from replies, resynchronisation.

Every command gets exactly one line in the order of arrival (L229-L237). Between them come completion lines `1`, `2`,
`3`, and `COMP` and `TRIG` of programs. A stop and the command that starts a move are written concurrently; their
replies have their place in the same queue.
"""

import asyncio
from collections.abc import Callable

from adapters.contract import NULL_LOG
from adapters.shrc203.wire.completions import COMPLETIONS, Completions
from adapters.shrc203.wire.replies import ANYTHING, COMMAND, DONE, MODE, REFUSALS, ShrcReplyFormat, refusal_of
from adapters.shrc203.wire.reply_queue import EOL, LONGEST_REPLY, ReplyQueue, ShrcLine
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal, TuttiError

PROGRAM_EVENTS = ("COMP", "TRIG")
COMPLETION_LATE_NS = 100 * NS_PER_MS  # a completion line is considered lost after this time
_QUIET_NS = 30 * NS_PER_MS  # silence for this long: no late reply is under way
_TRIES = 3


class _CompletionOutstanding(TuttiError):
    """A completion is outstanding: a bare digit is ambiguous."""


class ShrcSession:
    """The exchanges with one controller. char_ns: one character on the slowest part of the connection."""

    def __init__(self, link: Link, clock: Clock, char_ns: int, answer_ns: int) -> None:
        self.link = link
        self.log = NULL_LOG
        self.char_ns = char_ns
        self._clock = clock
        self._answer_ns = answer_ns
        self._turn = asyncio.Lock()
        self.replies = ReplyQueue(link, clock, char_ns, answer_ns)
        self._partial_line = b""
        self._searching = False
        self._quiet = (0, 0)
        self._reader = asyncio.get_running_loop().create_task(self._read_lines())
        self.changed = asyncio.Event()
        self.completions = Completions(clock, self.changed)

    async def close(self) -> None:
        self._reader.cancel()
        await self.link.close()
        self._handle_link_loss(LinkClosed(f"{self.link.endpoint} is closed"))

    # Exchanges

    async def send_query(self, command: str, form: ShrcReplyFormat) -> str:
        """Return the reply to a query, without its blanks. A query that was garbled in transit is repeated once."""
        line = await self.query_line(command, form)
        return line.text

    async def query_digit(self, command: str, form: ShrcReplyFormat) -> str | None:
        """Like `send_query`, for queries whose answer may be a bare digit; None while a completion is outstanding."""

        def require_no_completion() -> None:
            if self.completions.expected:
                raise _CompletionOutstanding

        try:
            return (await self.query_line(command, form, require_no_completion)).text
        except _CompletionOutstanding:
            return None

    async def query_line(
        self, command: str, form: ShrcReplyFormat, before_send: Callable[[], None] | None = None
    ) -> ShrcLine:
        """Like `send_query`, with the time stamp of the reply. before_send: as for `send_setting`."""
        try:
            line = await self._run_exchange(command, form, before_send)
            if line.text not in REFUSALS:
                return line
            self.log.info(f"{command!r} was refused; the query is repeated", answer=line.text)
        except ControllerFault as error:
            self.replies.out_of_step = True
            self.log.warning(f"the query {command!r} is repeated: {error.text}", code=error.code)
        line = await self._run_exchange(command, form, before_send)
        if line.text in REFUSALS:
            refusal = refusal_of(command)
            raise ControllerFault(refusal.code, refusal.text, refusal.remedy)
        return line

    async def query_optional(self, command: str, form: ShrcReplyFormat) -> str | None:
        """Return the reply to a query that is refused when there is nothing to report; None then."""
        line = await self._run_exchange(command, form)
        return None if line.text in REFUSALS else line.text

    async def try_query(self, command: str, form: ShrcReplyFormat) -> ShrcLine | None:
        """Return the reply to a query that is not worth a repetition; None when it fails."""
        try:
            line = await self._run_exchange(command, form)
        except ControllerFault as error:
            self.replies.out_of_step = True
            self.log.info(f"the query {command!r} failed and is not repeated: {error.text}", code=error.code)
            return None
        return None if line.text in REFUSALS else line

    async def send_setting(self, command: str, before_send: Callable[[], None] | None = None) -> None:
        """Send a setting. Raises `Refusal` when the controller refuses it.

        before_send: called when it is the command's turn; if it raises, nothing is sent.
        """
        line = await self._run_exchange(command, DONE, before_send)
        if line.text in REFUSALS:
            refusal = refusal_of(command)
            raise Refusal(refusal.code, refusal.text, refusal.remedy)

    async def try_setting(self, command: str) -> bool:
        """Send a setting that may be refused; return whether it was accepted."""
        line = await self._run_exchange(command, DONE)
        return line.text not in REFUSALS

    async def set_and_echo(self, command: str, before_send: Callable[[], None] | None = None) -> str:
        """Like `send_setting`; return what the controller has understood (`?:CMD`), without another exchange in
        between."""
        async with self._turn:
            await self._synchronise()
            if before_send is not None:
                before_send()
            line = await self._send_once(command, DONE)
            if line.text not in REFUSALS:
                return (await self._send_once("?:CMD", COMMAND)).text.upper()
        refusal = refusal_of(command)
        raise Refusal(refusal.code, refusal.text, refusal.remedy)

    async def send_raw(self, command: str) -> str:
        """Send any command, and return whatever the reply is."""
        return (await self._run_exchange(command, ANYTHING)).text

    def write_at_once(self, *commands: str) -> int:
        """Write at once, bypassing everything else; return the instant. Each command of the session is handed over as a
        whole, so that this is always at the beginning of a line."""
        for command in commands:
            self.replies.enqueue(command, DONE)
        return self.link.write("".join(command + EOL for command in commands).encode())

    def send_command(self, command: str, form: ShrcReplyFormat) -> "asyncio.Future[ShrcLine]":
        """Write a command at once, after those already written, and return its future reply."""
        pending = self.replies.enqueue(command, form)
        self.link.write((command + EOL).encode())
        return pending.answer.future

    def keep_quiet(self, until_ns: int, line_at_ns: int) -> None:
        """Begin no exchange that would still be under way when another writer writes, at `line_at_ns`."""
        self._quiet = (line_at_ns - self._answer_ns // 10 - self.wire_ns(2 * LONGEST_REPLY), until_ns)

    def end_quiet(self) -> None:
        self._quiet = (0, 0)

    def wire_ns(self, characters: int) -> int:
        """Return the transmission time of `characters` characters."""
        return characters * self.char_ns

    # Internals

    async def _run_exchange(
        self, command: str, form: ShrcReplyFormat, before_send: Callable[[], None] | None = None
    ) -> ShrcLine:
        async with self._turn:
            await self._synchronise()
            if before_send is not None:
                before_send()
            return await self._send_once(command, form)

    async def _synchronise(self) -> None:
        while self._quiet[0] <= self._clock.now_ns() < self._quiet[1]:
            await sleep_ns(self._clock, NS_PER_MS)
        if self.replies.out_of_step:
            await self._resynchronise()

    async def _send_once(self, command: str, form: ShrcReplyFormat) -> ShrcLine:
        pending = self.replies.enqueue(command, form)
        self.link.write((command + EOL).encode())
        return await pending.answer.future

    async def _resynchronise(self) -> None:
        """Resynchronise: end a half-typed command, query the mode, and discard everything that does not match."""
        while self.replies.pending:  # each has its timeout, so that this loop ends
            await sleep_ns(self._clock, 5 * NS_PER_MS)
            self.replies.require_open()
        for tries_left in reversed(range(_TRIES)):
            self._searching = True
            try:
                self.link.write(EOL.encode())
                await self._send_once("?:MODE", MODE)
            except ControllerFault as error:
                self.log.warning(f"resynchronising: {error.text}", tries_left=tries_left)
                if not tries_left:
                    raise
                continue
            finally:
                self._searching = False
            self._searching = True
            try:
                await sleep_ns(self._clock, _QUIET_NS)
            finally:
                self._searching = False
            self.replies.out_of_step = False
            self.log.info("the session is synchronised", place=self.link.endpoint)
            return

    async def _read_lines(self) -> None:
        try:
            while True:
                chunk = await self.link.read()
                *whole_lines, self._partial_line = (self._partial_line + chunk.data).split(b"\n")
                for line_bytes in whole_lines:
                    text = line_bytes.decode("latin-1").replace(" ", "").strip("\r\0")
                    if text:
                        self._classify_line(ShrcLine(text, chunk.at_ns))
        except LinkClosed as error:
            self._handle_link_loss(error)

    def _handle_link_loss(self, error: LinkClosed) -> None:
        self.replies.close(error)
        self.changed.set()

    def _classify_line(self, line: ShrcLine) -> None:
        """Classify a line: completion, program event, reply, or garbage."""
        if line.text in PROGRAM_EVENTS:
            return
        if line.text in COMPLETIONS and self._is_completion(line):
            return
        pending = next((reply for reply in self.replies.pending if reply.form.matches_line(line.text)), None)
        head = self.replies.head
        if self._searching:
            if pending is not None:
                self.replies.pending.remove(pending)
                pending.set_reply(line)
        elif head is None:
            self.replies.out_of_step = True  # a reply that no task awaits: the next one may be late as well
        else:
            self.replies.pending.popleft()
            if head is pending or line.text in REFUSALS:
                head.set_reply(line)
                return
            self.replies.out_of_step = True
            head.answer.set_failure(
                ControllerFault(
                    "garbage",
                    f"sent {head.command!r}, expected {head.form.words}, received {line.text!r}",
                    "check cable, baud rate and ground; does another program use the same line?",
                )
            )

    def _is_completion(self, line: ShrcLine) -> bool:
        head = self.replies.head
        return self.completions.take_line(
            line, head if head is not None and head.form.matches_line(line.text) else None
        )

    async def wait_changed(self, until_ns: int) -> None:
        """Wait until a completion arrives, `changed` is set, the link is lost (`LinkClosed`), or that instant."""
        timer = self._clock.call_at_ns(until_ns, self.changed.set)
        try:
            await self.changed.wait()
        finally:
            timer.cancel()
        self.changed.clear()
        self.replies.require_open()
