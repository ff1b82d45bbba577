"""The exchanges with a controller: one command at a time, its reply line by line, with a timeout."""

import asyncio
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from adapters.contract import DriverLog
from adapters.toolkit.lines.dialect import LineDialect, LineStatus, LineStep
from adapters.toolkit.pending_reply import PendingReply
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal

LONGEST_LINE = 2000  # characters; more without an end of line is no text
MOST_LINES = 500  # of one reply
QUIET_NS = 30 * NS_PER_MS  # without a byte: what was under way has arrived
_LOOK_NS = 20 * NS_PER_MS
_CHECK = "check power, cable and baud rate, and that this is the right make"
_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True)
class LineReply:
    """A whole reply. sent_ns: when the command was written. at_ns: when its last line arrived. characters: of that
    line."""

    lines: Sequence[str]
    sent_ns: int
    at_ns: int
    characters: int


@dataclass(slots=True)
class ExpectedReply:
    """A reply that is expected."""

    is_done: Callable[[str], bool]
    sent_ns: int
    answer: PendingReply[LineReply] = field(default_factory=PendingReply[LineReply])
    lines: list[str] = field(default_factory=list[str])


class LineSession:
    """The exchanges over one open link. on_restart: called when the controller says that it has restarted."""

    def __init__(self, link: Link, dialect: LineDialect, clock: Clock, answer_ns: int, log: DriverLog) -> None:
        self.link = link
        self.turn = asyncio.Lock()
        self.restarted = False
        self.is_resetting = False
        """A restart that the controller reports now is the driver's own reset."""
        self.on_restart: Callable[[], None] = lambda: None
        self._dialect = dialect
        self._clock = clock
        self._answer_ns = answer_ns
        self._log = log
        self._expected: ExpectedReply | None = None
        self._partial = ""
        self._received_ns = 0
        self._disturbed = False
        self._closed: LinkClosed | None = None
        self._split = re.compile("|".join(re.escape(terminator) for terminator in dialect.traits.terminators))
        self._reader = asyncio.get_running_loop().create_task(self._read_lines())

    async def run_step(self, step: LineStep) -> LineReply:
        """Write the bytes of a step and return its reply. Raises `Refusal`, `ControllerFault`, `LinkClosed`."""
        async with self.turn:
            return await self._exchange(step)

    async def run_once(self, step: LineStep, check: Callable[[], None]) -> LineReply:
        """Run a step that begins a motion, after `check`, which raises when it must not begin any more."""
        async with self.turn:
            await self._settle()
            check()
            return await self._exchange(step)

    async def ask(self, step: LineStep, read: Callable[[Sequence[str]], _Value | None]) -> tuple[_Value, LineReply]:
        """Return the value in the reply to a query. Raises like `run_step`."""
        reply = await self.run_step(step)
        value = read(reply.lines)
        if value is None:
            self._disturbed = True
            raise self._garbage_fault(step, reply.lines)
        return value, reply

    async def ask_status(self) -> tuple[LineStatus, LineReply]:
        """Read the controller's status. A question without a reply is asked once more: it changes nothing, and one lost
        character is no reason to give up a move that runs. Raises like `run_step`."""
        step, reader = self._dialect.ask_status(), self._dialect.read_status
        try:
            return await self.ask(step, reader)
        except ControllerFault as fault:
            if fault.code != "no-answer":
                raise
            self._log.warning("asked again", command=repr(step.data), reason=fault.text)
        return await self.ask(step, reader)

    async def run_procedure(self, steps: Sequence[LineStep]) -> None:
        """Run steps in order, each to its end. Raises like `run_step`."""
        for step in steps:
            if step.data:
                await self.run_step(step)
            if step.until:
                await self.wait_for_state(step)

    async def wait_for_state(self, step: LineStep) -> LineStatus:
        """Read the status until it is one of `step.until`. Raises `ControllerFault` on its timeout."""
        limit_ns = self._clock.now_ns() + round((step.timeout_s or 10.0) * NS_PER_S)
        while True:
            status, _ = await self.ask_status()
            if status.state in step.until:
                return status
            if self._clock.now_ns() > limit_ns:
                raise ControllerFault(
                    "not-stopping",
                    f"{self.link.endpoint} is {status.state}, and not {' or '.join(step.until)}",
                    "stop it at the controller",
                )
            await sleep_ns(self._clock, _LOOK_NS)

    def write_at_once(self, data: bytes) -> int:
        """Write past everything else. Raises `LinkClosed`."""
        return self.link.write(data)

    def expect(self, is_done: Callable[[str], bool]) -> ExpectedReply:
        """Expect the reply to bytes that another writer writes, while holding `turn`. Raises `LinkClosed`."""
        if self._closed is not None:
            raise self._closed
        self._expected = ExpectedReply(is_done, self._clock.now_ns())
        return self._expected

    async def wait_for_reply(self, expected: ExpectedReply, timeout_ns: int, step: LineStep) -> LineReply:
        """Wait for an expected reply."""
        expected.answer.timer = self._clock.call_at_ns(
            self._clock.now_ns() + timeout_ns, lambda: self._handle_timeout(expected, step)
        )
        try:
            return await expected.answer.future
        except asyncio.CancelledError:
            self._disturbed = True
            raise
        finally:
            expected.answer.cancel_timeout()
            if self._expected is expected:
                self._expected = None

    async def drain(self) -> None:
        """Discard what arrives until the line is quiet."""
        limit_ns = self._clock.now_ns() + 2 * self._answer_ns
        quiet_ns = QUIET_NS + 20 * self.link.char_ns
        self._received_ns = self._clock.now_ns()
        while self._clock.now_ns() < min(limit_ns, self._received_ns + quiet_ns):
            self._require_open()
            await sleep_ns(self._clock, self._received_ns + quiet_ns - self._clock.now_ns())
        self._partial = ""
        self._disturbed = False

    def disturb(self) -> None:
        """Replies may be missing or late: the next exchange begins on a quiet line."""
        self._disturbed = True

    async def close(self) -> None:
        self._reader.cancel()
        self._handle_loss(LinkClosed(f"{self.link.endpoint} was closed"))
        await self.link.close()

    # Internals

    async def _settle(self) -> None:
        if self._disturbed:
            # A late reply must not be taken for that of the next command.
            self.link.write(self._dialect.spoiler)
            await self.drain()

    async def _exchange(self, step: LineStep) -> LineReply:
        self._require_open()
        await self._settle()
        if step.is_done is None:
            at_ns = self.link.write(step.data)
            return LineReply((), at_ns, at_ns, 0)
        expected_reply = self.expect(step.is_done)
        try:
            expected_reply.sent_ns = self.link.write(step.data)
        except BaseException:
            self._expected = None
            raise
        usual_ns = self._answer_ns + (len(step.data) + 100) * self.link.char_ns
        timeout_ns = usual_ns if step.timeout_s is None else round(step.timeout_s * NS_PER_S)
        return await self.wait_for_reply(expected_reply, timeout_ns, step)

    def _handle_timeout(self, expected: ExpectedReply, step: LineStep) -> None:
        self._disturbed = True
        if expected.lines:
            expected.answer.set_failure(self._garbage_fault(step, expected.lines))
            return
        text = f"no reply to {step.data!r} on {self.link.endpoint}" + _explain_expected(step)
        expected.answer.set_failure(ControllerFault("no-answer", text, _CHECK))

    def _garbage_fault(self, step: LineStep, lines: Sequence[str]) -> ControllerFault:
        reply_text = "; ".join(lines)[:200] + _explain_expected(step)
        return ControllerFault(
            "garbage", f"{self.link.endpoint}: the reply to {step.data!r} cannot be read: {reply_text}", _CHECK
        )

    def _require_open(self) -> None:
        if self._closed is not None:
            raise self._closed

    async def _read_lines(self) -> None:
        try:
            while True:
                chunk = await self.link.read()
                self._received_ns = self._clock.now_ns()
                *whole_lines, remainder = self._split.split(self._partial + chunk.data.decode("latin-1"))
                self._partial = remainder if len(remainder) <= LONGEST_LINE else ""
                for line in whole_lines:
                    text = line.strip("\r\n\0 ")
                    if text:
                        self._handle_line(text, len(line) + 1, chunk.at_ns)
        except LinkClosed as error:
            self._handle_loss(error)

    def _handle_line(self, text: str, characters: int, at_ns: int) -> None:
        meaning = self._dialect.classify_line(text)
        if meaning == "restarted" and not self.is_resetting:
            self.restarted = True
            self._log.warning("the controller says that it has restarted", line=text[:100])
            self.on_restart()
        if meaning == "restarted" and self.is_resetting:
            meaning = "reply"  # to the reset
        expected_reply = self._expected
        if expected_reply is None or meaning != "reply":
            return
        expected_reply.lines.append(text)
        if refusal := self._dialect.find_refusal(text):
            self._expected = None
            expected_reply.answer.set_failure(
                Refusal("refused", f"{self.link.endpoint} refuses the command: {refusal}", "see its manual")
            )
        elif expected_reply.is_done(text):
            self._expected = None
            expected_reply.answer.set_reply(LineReply(expected_reply.lines, expected_reply.sent_ns, at_ns, characters))
        elif len(expected_reply.lines) > MOST_LINES:
            self._expected = None
            self._disturbed = True
            expected_reply.answer.set_failure(self._garbage_fault(LineStep(), expected_reply.lines[:3]))

    def _handle_loss(self, error: LinkClosed) -> None:
        self._closed = error
        if self._expected is not None:
            self._expected.answer.set_failure(error)
            self._expected = None


def _explain_expected(step: LineStep) -> str:
    return f"; expected is {step.expected}" if step.expected else ""
