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

from adapters.contract import NULL_LOG
from adapters.ppsmc.batches import EOL, LONGEST_ANSWER, BatchQueue, PpSmcLine, TokenReply, blocked_fault
from adapters.ppsmc.replies import ASK_POSITIONS, ASK_STATUS, FormattedQuery, StatusBits, parse_states
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal

# Ends a half-typed line without completing it: `goto1:5` must not become a command by this session's line end.
SPOILER = "!"
_LINES_AT_MOST = 14  # of an exchange with queries only
_DELIMITERS = re.compile(r"[\r\n]")


class PpSmcSession:
    """The exchanges with one controller.

    slow_ns: the slowest execution of one command.
    token: the last token of an earlier connection, 0 without any.
    greeting: the controller's first message.
    """

    def __init__(self, link: Link, clock: Clock, answer_ns: int, slow_ns: int, token: int = 0) -> None:
        self.link = link
        self.log = NULL_LOG
        self.greeting = ""
        self.blocked = False
        self._clock = clock
        self._answer_ns = answer_ns
        self._slow_ns = slow_ns
        self._turn = asyncio.Lock()
        self.batches = BatchQueue(link, clock, answer_ns, slow_ns, token)
        self._plain: asyncio.Event | None = None
        self._partial_line = ""
        self._quiet = (0, 0)
        self._reader = asyncio.get_running_loop().create_task(self._read_lines())

    async def close(self) -> None:
        self._reader.cancel()
        await self.link.close()
        self._handle_link_loss(LinkClosed(f"{self.link.endpoint} is closed"))

    @property
    def last_token(self) -> int:
        """The last token that may have been written: the answer to `?us` as long as the controller is not restarted."""
        return self.batches.last_token

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
            self.batches.out_of_step = True
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
        self.batches.fail_blocked()

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
            self.batches.out_of_step = True

    async def send_raw(self, command: str) -> str:
        """Send any command, and return whatever the reply is."""
        async with self._turn:
            if self.blocked:
                self._write_lines(command)
                self.blocked = False
                await sleep_ns(self._clock, self._slow_ns)
                return ""
            await self._synchronise()
            pending = self.batches.build_batch((command,), ())
            self.link.write(pending.data)
            reply = await pending.answer.future
            self.batches.out_of_step = True  # it may have changed the delimiters of answers
            return "\n".join(line.text for line in reply.all_lines[:-1])

    def write_at_once(self, *commands: str) -> int:
        """Write at once, bypassing everything else; return the instant. Each command of the session is handed over as a
        whole, so that this is always at the beginning of a line."""
        return self._write_lines(*commands)

    def exclusive_lock(self) -> asyncio.Lock:
        """Return the lock for exclusive use of the connection."""
        return self._turn

    def keep_quiet(self, until_ns: int, line_at_ns: int) -> None:
        """Begin no exchange that would still be executed when another writer writes, at `line_at_ns`."""
        self._quiet = (line_at_ns - _LINES_AT_MOST * self._slow_ns - self.wire_ns(4 * LONGEST_ANSWER), until_ns)

    def end_quiet(self) -> None:
        self._quiet = (0, 0)

    def wire_ns(self, characters: int) -> int:
        """Return the transmission time of `characters` characters."""
        return characters * self.link.char_ns

    # Internals

    def _write_lines(self, *commands: str) -> int:
        return self.link.write("".join(command + EOL for command in commands).encode())

    async def _run_batch(self, commands: Sequence[str], queries: Sequence[FormattedQuery]) -> TokenReply:
        pending = self.batches.build_batch(commands, queries)
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
            raise blocked_fault(self.link.endpoint)
        if self.batches.out_of_step:
            # End a half-typed line (each TCP connection has its own line buffer), then set the delimiters.
            spoiler = (SPOILER,) if self.link.char_ns else ()
            await self._run_batch((*spoiler, "txdel3", "echo0"), ())
            self.batches.out_of_step = False
            self.log.info("the session is synchronised", place=self.link.endpoint)

    async def _detect_block(self, error: ControllerFault) -> None:
        try:
            await self._query_plain()
        except ControllerFault:
            raise error from None
        if self.blocked:
            self.log.warning("the controller is blocked: a client has sent `block`")
            raise blocked_fault(self.link.endpoint) from None

    async def _query_plain(self) -> tuple[PpSmcLine, PpSmcLine]:
        self.batches.require_open()
        self.batches.received_lines.clear()
        change_event = self._plain = asyncio.Event()
        until_ns = self._clock.now_ns() + self._answer_ns + 2 * self._slow_ns + self.wire_ns(2 * LONGEST_ANSWER)
        timer = self._clock.call_at_ns(until_ns, change_event.set)
        try:
            self._write_lines(ASK_STATUS.text, ASK_POSITIONS.text)
            while True:
                await change_event.wait()
                self.batches.require_open()
                change_event.clear()
                reply_lines = [
                    line for line in self.batches.received_lines if ASK_POSITIONS.form.matches_text(line.text)
                ]
                if len(reply_lines) >= 2 and ASK_STATUS.form.matches_text(reply_lines[0].text):
                    self.batches.received_lines.clear()
                    self.blocked = any(
                        state_bits & StatusBits.BLOCKED for state_bits in parse_states(reply_lines[0].text).values()
                    )
                    return reply_lines[0], reply_lines[1]
                if self._clock.now_ns() >= until_ns:
                    raise self.batches.no_answer_fault(f"{ASK_STATUS.text} and {ASK_POSITIONS.text}")
        finally:
            timer.cancel()
            self._plain = None

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

    def _handle_line(self, line: PpSmcLine) -> None:
        if self.batches.out_of_step and not self.greeting and line.text.lower().startswith("smc "):
            self.greeting = line.text
            return
        self.batches.take_line(line)
        if self._plain is not None:
            self._plain.set()

    def _handle_link_loss(self, error: LinkClosed) -> None:
        self.batches.close(error)
        if self._plain is not None:
            self._plain.set()


def as_refusal(error: ControllerFault) -> Refusal:
    """Return the same as a refusal: nothing has begun."""
    return Refusal(error.code, error.text, error.remedy)
