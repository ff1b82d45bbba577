"""What is to be written of alarms: in order, as soon as the journal can be written, without anything waiting for it."""

import asyncio
from collections.abc import Callable

from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.coordinator.fleet.positions import JournalCalls
from orchestrator.coordinator.journal.facts import AlarmChange
from orchestrator.coordinator.journal.records import EpochOvertaken, JournalError
from orchestrator.coordinator.journal.store import AlarmJournal
from orchestrator.model.operation.alarms import AlarmRecord

RETRY_NS = 2 * NS_PER_S
MAX_UNWRITTEN = 2_000  # changes; then the oldest are lost for the history


class AlarmStore:
    """Writes changes of alarms, and what becomes of notices."""

    def __init__(self, tables: AlarmJournal, execute: JournalCalls, clock: Clock) -> None:
        self._tables = tables
        self._execute = execute
        self._clock = clock
        self._changes: list[AlarmChange] = []
        self._forgotten: list[str] = []
        self._tries: dict[str, int | None] = {}
        """By notice: how often its command has failed; None: it is done with."""
        self._wake = asyncio.Event()
        self._lock = asyncio.Lock()
        self.on_result: Callable[[JournalError | None], None] = lambda _: None
        """Called with the error of a write; None: it is done."""

    def add_change(self, change: AlarmChange) -> None:
        """Write a change soon."""
        self._changes = [*self._changes, change][-MAX_UNWRITTEN:]
        self._wake.set()

    def forget_alarm(self, alarm_id: str) -> None:
        """Delete an alarm soon; its history stays."""
        self._forgotten.append(alarm_id)
        self._wake.set()

    def note_tries(self, change: str, tries: int | None) -> None:
        """Write soon how often the command for a notice has failed; None: the notice is done with."""
        self._tries[change] = tries
        self._wake.set()

    async def load_history(self, limit: int) -> list[AlarmRecord]:
        """The newest changes, the newest first. Raises `JournalError`."""
        return await self._execute(self._tables.load_history, limit)

    async def write_pending(self, *urgent: AlarmChange) -> None:
        """Write what is pending, and changes of the caller after it. Raises `JournalError`; then what was pending still
        is, and the caller's changes are not."""
        async with self._lock:
            changes, forgotten, tries = self._changes, self._forgotten, self._tries
            self._changes, self._forgotten, self._tries = [], [], {}
            try:
                if changes or forgotten or urgent:
                    await self._execute(self._tables.store_changes, [*changes, *urgent], forgotten)
                    changes, forgotten = [], []
                while tries:
                    change, count = next(iter(tries.items()))
                    if count is None:
                        await self._execute(self._tables.delete_notice, change)
                    else:
                        await self._execute(self._tables.store_tries, change, count)
                    del tries[change]
            except BaseException:
                self._changes, self._forgotten = [*changes, *self._changes], [*forgotten, *self._forgotten]
                self._tries = tries | self._tries
                raise

    async def run(self) -> None:
        """Write whatever is pending, again and again; return when another coordinator leads."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            try:
                await self.write_pending()
                self.on_result(None)
            except EpochOvertaken:
                return
            except JournalError as error:
                self.on_result(error)
                await sleep_ns(self._clock, RETRY_NS)
                self._wake.set()
