"""The batches whose answers are outstanding, each closed by a token that returns after them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from adapters.ppsmc.replies import ASK_USER_STATUS, FormattedQuery
from adapters.toolkit.pending_reply import PendingReply
from orchestrator.clock.base import Clock
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import ControllerFault

EOL = "\r\n"
LONGEST_ANSWER = 120  # characters of one answer, for its transmission time on a serial line
_FIRST_TOKEN = 1_000_000  # not a port byte, and not a value that a user would choose
_LAST_TOKEN = 2_000_000_000
_MOST_LINES = 5000


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


class BatchQueue:
    """The outstanding batches of one controller.

    slow_ns: the slowest execution of one command. token: the last token of an earlier connection, 0 without any.
    restarted: the controller has lost the token; stays set until it is handled. last_token: the last one that may have
    been written: the answer to `?us` as long as the controller is not restarted."""

    def __init__(self, link: Link, clock: Clock, answer_ns: int, slow_ns: int, token: int) -> None:
        self._link = link
        self._clock = clock
        self._answer_ns = answer_ns
        self._slow_ns = slow_ns
        self._known = token > 0
        self.restarted = False
        self.last_token = max(token, _FIRST_TOKEN)
        self.pending: dict[str, PendingBatch] = {}
        self._lost: set[str] = set()
        self.received_lines: list[PpSmcLine] = []
        self.out_of_step = True  # the previous traffic is unknown
        self.closed: LinkClosed | None = None

    def require_open(self) -> None:
        """Raise `LinkClosed` when the link is lost."""
        if self.closed is not None:
            raise self.closed

    def build_batch(
        self, commands: Sequence[str], queries: Sequence[FormattedQuery], written_ns: int | None = None
    ) -> PendingBatch:
        """Return a batch whose answers are expected: it is written now, or by another writer at `written_ns`."""
        if self.closed is not None:
            raise self.closed
        self.last_token = self.last_token + 1 if self.last_token < _LAST_TOKEN else _FIRST_TOKEN
        token = str(self.last_token)
        lines = [*commands, *(query.text for query in queries), "?us", f"us{token}", "?us"]
        data = "".join(line + EOL for line in lines).encode()
        since_ns = self._clock.now_ns() if written_ns is None else written_ns
        answers = sum(20 if query.form.many else 1 for query in queries)
        wait_ns = (
            self._answer_ns + len(lines) * self._slow_ns + self._link.char_ns * (len(data) + answers * LONGEST_ANSWER)
        )
        earlier_count = sum(pending_reply.written_ns <= since_ns for pending_reply in self.pending.values())
        wait_ns += (earlier_count + 1) * self._slow_ns * 10
        pending = self.pending[token] = PendingBatch(token, tuple(queries), data, since_ns, wait_ns)
        pending.answer.timer = self._clock.call_at_ns(since_ns + wait_ns, partial(self._handle_timeout, pending))
        return pending

    def expect_batch(
        self, commands: Sequence[str], queries: Sequence[FormattedQuery], written_by_ns: int
    ) -> PendingBatch:
        """Expect the answers to a batch whose `data` another writer writes by that instant."""
        return self.build_batch(commands, queries, written_by_ns)

    def record_write(self, pending: PendingBatch, at_ns: int) -> None:
        """Record when the expected batch was written."""
        pending.written_ns = at_ns
        if pending.token in self.pending:
            pending.answer.cancel_timeout()
            pending.answer.timer = self._clock.call_at_ns(
                at_ns + pending.wait_ns, partial(self._handle_timeout, pending)
            )

    def remove_expected(self, pending: PendingBatch) -> None:
        """Remove an expected batch that was never written."""
        pending.answer.cancel_timeout()
        self.pending.pop(pending.token, None)

    def fail_blocked(self) -> None:
        """Fail all outstanding batches: the controller is blocked, and has cleared its buffers."""
        for pending in list(self.pending.values()):
            self.remove_expected(pending)
            self._lost.add(pending.token)
            pending.answer.set_failure(blocked_fault(self._link.endpoint))

    def close(self, error: LinkClosed) -> None:
        """Fail all outstanding batches: the link is lost."""
        self.closed = error
        for pending in list(self.pending.values()):
            pending.answer.set_failure(error)
        self.pending.clear()

    def take_line(self, line: PpSmcLine) -> None:
        """Take a received line: the end of a batch, or one of its answers."""
        pending = self.pending.pop(line.text, None)
        if pending is not None:
            self._assign_answers(pending)
            self.received_lines.clear()
        elif line.text in self._lost:
            # The end of a lost batch; or the present answer to `?us`, because that batch was executed after all.
            self._lost.discard(line.text)
            self.received_lines = [line]
        else:
            self.received_lines.append(line)
            del self.received_lines[:-_MOST_LINES]

    def _assign_answers(self, pending: PendingBatch) -> None:
        """Assign the lines before the token to the queries; a line that matches none is a message (echo, L1824)."""
        answers: dict[str, list[PpSmcLine]] = {}
        lines_left, received_lines = list(self.received_lines), list(self.received_lines)
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
                self.out_of_step = True
                received_text = "; ".join(line.text for line in self.received_lines) or "nothing"
                pending.answer.set_failure(
                    ControllerFault(
                        "garbage",
                        f"asked {query.text!r} on {self._link.endpoint}, expected {query.form.words}, "
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

    def _handle_timeout(self, pending: PendingBatch) -> None:
        if self.pending.pop(pending.token, None) is None:
            return
        self._lost.add(pending.token)
        self.out_of_step = True
        first = pending.data.decode().split(EOL, 1)[0]
        pending.answer.set_failure(self.no_answer_fault(f"the lines from {first!r}"))

    def no_answer_fault(self, what: str) -> ControllerFault:
        """Return the fault of a missing answer."""
        return ControllerFault(
            "no-answer",
            f"no reply to {what} on {self._link.endpoint}",
            "check power and cable; a controller that is shutting down or shows a dialogue does not answer",
        )


def blocked_fault(place: str) -> ControllerFault:
    return ControllerFault(
        "blocked",
        f"the controller at {place} is blocked: a client has sent `block`",
        "ensure that it may move, then unblock it with `tutti reset` (it sends `unblock`)",
    )
