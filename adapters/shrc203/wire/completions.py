"""The completion lines of a controller: bare digits, which its moves send when their axes have ended."""

import asyncio
from collections.abc import Callable, Iterable

from adapters.shrc203.wire.reply_queue import ShrcLine, ShrcPending
from orchestrator.clock.base import Clock

COMPLETIONS = ("1", "2", "3")


class Completions:
    """The completions that are expected. changed: set when one arrives."""

    def __init__(self, clock: Clock, changed: asyncio.Event) -> None:
        self._clock = clock
        self._changed = changed
        self.expected: set[int] = set()
        self._expected_since_ns = 0
        self._on_completion: Callable[[int, int], None] | None = None
        self.abandoned = False
        self._before: set[int] = set()
        self.completed: dict[int, int] = {}

    def expect(
        self, motors: set[int], on_completion: Callable[[int, int], None] | None = None, before: Iterable[int] = ()
    ) -> None:
        """Expect completions: from now on a bare digit is the completion of one of `motors`, and its only one; but not
        while a query sent before can be answered by a digit.

        on_completion: called with motor and instant; then further completions of the same motor are expected, until
        `expect_none`. before: motors that complete another move first.
        """
        self.expected = set(motors)
        self._expected_since_ns = self._clock.now_ns()
        self._before = set(before)
        self._on_completion = on_completion
        self.completed = {}
        self.abandoned = False

    def expect_again(self, motor: int) -> None:
        """Expect the motor's completion again: the received one did not belong to this move."""
        self.completed.pop(motor, None)
        self.expected.add(motor)

    def expect_none(self) -> None:
        """Expect no further completions: none can arrive."""
        self.expected = set()
        self._on_completion = None
        self.abandoned = False

    def abandon(self) -> None:
        """Stop awaiting the completions; they may still arrive."""
        self.abandoned = bool(self.expected)

    def take_line(self, line: ShrcLine, reply: ShrcPending | None) -> bool:
        """Return whether a bare digit is a completion, and take it. reply: the next one that it could be."""
        motor = int(line.text)
        if reply is not None and reply.written_ns <= self._expected_since_ns:
            return False  # the expected motion is begun after that query
        if motor in self.expected and self._on_completion is not None:
            self._on_completion(motor, line.at_ns)
            self._changed.set()
            return True
        if motor in self.expected and motor in self._before:
            self._before.discard(motor)
            return True
        if motor in self.expected:
            self.expected.discard(motor)
            self.completed[motor] = line.at_ns
            self._changed.set()
            return True
        # A completion that no task awaits, of a move begun elsewhere, unless it answers the query.
        return reply is None
