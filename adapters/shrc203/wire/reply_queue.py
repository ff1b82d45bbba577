"""The commands whose replies are outstanding, in the order of the replies."""

from collections import deque
from dataclasses import dataclass, field, replace

from adapters.shrc203.wire.replies import DONE, ShrcReplyFormat
from adapters.toolkit.pending_reply import PendingReply
from orchestrator.clock.base import Clock
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault

EOL = "\r\n"
LONGEST_REPLY = 128  # characters that a reply may take to arrive, beyond the time allowed for answering


@dataclass(frozen=True, slots=True)
class ShrcLine:
    """A received line.

    at_ns: host time when its end was taken from the operating system.
    command_ns: when the command that it answers was written, 0 for an unsolicited line."""

    text: str
    at_ns: int
    command_ns: int = 0


@dataclass(slots=True, eq=False)
class ShrcPending:
    """A command whose reply is outstanding."""

    command: str
    form: ShrcReplyFormat
    written_ns: int
    answer: PendingReply[ShrcLine] = field(default_factory=PendingReply[ShrcLine])

    def set_reply(self, line: ShrcLine) -> None:
        self.answer.set_reply(replace(line, command_ns=self.written_ns))


class ReplyQueue:
    """The outstanding replies of one controller. char_ns: one character on the slowest part of the connection."""

    def __init__(self, link: Link, clock: Clock, char_ns: int, answer_ns: int) -> None:
        self._link = link
        self._clock = clock
        self._char_ns = char_ns
        self._answer_ns = answer_ns
        self.pending: deque[ShrcPending] = deque()
        self.out_of_step = True  # the previous traffic is unknown
        self.closed: LinkClosed | None = None

    @property
    def head(self) -> ShrcPending | None:
        """The reply that comes next."""
        return self.pending[0] if self.pending else None

    def close(self, error: LinkClosed) -> None:
        """Fail all outstanding replies: the link is lost."""
        self.closed = error
        while self.pending:
            self.pending.popleft().answer.set_failure(error)

    def require_open(self) -> None:
        """Raise `LinkClosed` when the link is lost."""
        if self.closed is not None:
            raise self.closed

    def enqueue(self, command: str, form: ShrcReplyFormat, written_ns: int | None = None) -> ShrcPending:
        """Expect the reply to a command that is written now, or by another writer at `written_ns`."""
        if self.closed is not None:
            raise self.closed
        since_ns = self._clock.now_ns() if written_ns is None else written_ns
        pending = ShrcPending(command, form, since_ns)
        # A command that another writer writes later is answered later: exchanges until then precede it.
        later_count = sum(queued_reply.written_ns > since_ns for queued_reply in self.pending)
        self.pending.insert(len(self.pending) - later_count, pending)
        self._set_timeout(pending, since_ns)
        return pending

    def expect_reply(self, command: str, written_by_ns: int, latest_ns: int) -> ShrcPending:
        """Expect the reply to a command that another writer writes by `written_by_ns`, or as late as `latest_ns` while
        this session is quiet."""
        pending = self.enqueue(command, DONE, written_by_ns)
        self._set_timeout(pending, latest_ns)
        return pending

    def record_write(self, pending: ShrcPending, at_ns: int) -> None:
        """Record when the expected command was written."""
        pending.written_ns = at_ns
        if pending in self.pending:
            self._set_timeout(pending, at_ns)

    def remove_expected(self, pending: ShrcPending) -> None:
        """Remove an expected command that was never written."""
        pending.answer.cancel_timeout()
        if pending in self.pending:
            self.pending.remove(pending)

    def _set_timeout(self, pending: ShrcPending, since_ns: int) -> None:
        """Set the timeout of a reply, counted from when its command is written."""
        pending.answer.cancel_timeout()
        byte_count = sum(len(queued_reply.command) + len(EOL) + LONGEST_REPLY for queued_reply in self.pending)
        pending.answer.timer = self._clock.call_at_ns(
            since_ns + self._answer_ns + self._char_ns * (byte_count), lambda: self._handle_timeout(pending)
        )

    def _handle_timeout(self, pending: ShrcPending) -> None:
        if pending in self.pending:
            self.pending.remove(pending)
        self.out_of_step = True
        pending.answer.set_failure(
            ControllerFault(
                "no-answer",
                f"no reply to {pending.command!r} on {self._link.endpoint}; expected {pending.form.words}",
                "check power, cable, baud rate, and that the controller is in HOST mode",
            )
        )
