"""Calls of the journal that wait at the same time are one commit.

While one commit is on its way to the disk, further calls wait; then all of them are run together, in the order in which
they were made. Each gets its own result or error, and only once all are on disk. What nothing waits for (`later`) is
run with the next call that writes, or that reads the same part of the journal: what is read or relied on is not older.
"""

import asyncio
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.executor import Executor
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.reads import READS
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.store import JournalStore

T = TypeVar("T")

LATER_NS = NS_PER_S  # at most, for a call that nothing waits for


class RecordLater(Protocol):
    """Calls the journal with the next call. on_error: called with an error of the journal."""

    def __call__(
        self, on_error: Callable[[JournalError], None], function: Callable[..., object], *values: Any
    ) -> None: ...


class GroupedCalls:
    """The calls of one coordinator. find_epoch: returns its epoch; once another coordinator has taken one from the
    journal, every call is refused, even if its heartbeat has not arrived. run: runs calls in their order."""

    def __init__(
        self,
        journal: JournalStore,
        run: Executor,
        clock: Clock,
        find_epoch: Callable[[], int],
        tasks: TaskOwner,
    ) -> None:
        self._journal = journal
        self._run = run
        self._clock = clock
        self._find_epoch = find_epoch
        self.on_error: Callable[[JournalError], None] = lambda _: None
        """Called with each error of the journal."""
        self._waiting: list[JournalCall] = []
        self._turn = asyncio.Lock()
        self._is_due = False
        self._tasks = tasks

    async def __call__(self, function: Callable[..., T], *values: Any) -> T:
        """Call the journal. Raises what `function` raises, and `EpochOvertaken`."""
        call = JournalCall(function, values)
        self._waiting.append(call)
        try:
            async with self._turn:
                if not call.is_done:
                    await self._run_calls(self._take_waiting())
        except asyncio.CancelledError:
            if call in self._waiting:
                self._waiting.remove(call)
            raise
        return call.take_result()

    def later(self, on_error: Callable[[JournalError], None], function: Callable[..., object], *values: Any) -> None:
        """Call the journal with the next call, at the latest after `LATER_NS`. on_error: called with its error."""
        self._waiting.append(JournalCall(function, values, on_error))
        if not self._is_due:
            self._is_due = True
            self._clock.call_at_ns(self._clock.now_ns() + LATER_NS, self._begin_flush)

    async def flush(self) -> None:
        """Run all calls that nothing waits for."""
        self._is_due = False
        async with self._turn:
            calls, self._waiting = self._waiting, []
            if calls:
                await self._run_calls(calls)

    def _begin_flush(self) -> None:
        self._tasks.spawn(self.flush())

    def _take_waiting(self) -> list[JournalCall]:
        """The calls to be run now."""
        calls, self._waiting = self._waiting, []
        tables = {call.table for call in calls if call.on_error is None}
        if all(_is_read(call) for call in calls if call.on_error is None):
            self._waiting = [call for call in calls if call.on_error is not None and call.table not in tables]
            calls = [call for call in calls if call.on_error is None or call.table in tables]
        return calls

    async def _run_calls(self, calls: list[JournalCall]) -> None:
        try:
            await self._run(self._journal.run_group, calls, self._find_epoch())
        except asyncio.CancelledError:
            # Those of others are still to be run, or are being run by the executor: then they are not run again.
            self._waiting[:0] = calls
            raise
        except JournalError as error:
            for call in calls:
                call.fail(error)
        for call in calls:
            if isinstance(call.error, JournalError):
                self.on_error(call.error)
                if call.on_error is not None:
                    call.on_error(call.error)
            elif call.error is not None and call.on_error is not None:
                self._tasks.on_defect(call.error, False)  # noqa: FBT003 - a callback


def _is_read(call: JournalCall) -> bool:
    return call.table is None or call.name in READS
