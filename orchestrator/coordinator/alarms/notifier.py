"""The notices of alarms: the command of the fleet file is run for each, until it has succeeded.

At least once: a notice is deleted from the journal after its command has succeeded. `TUTTI_ALARM_CHANGE` names the
change of the alarm, so that a receiver can leave out repetitions.
"""

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from orchestrator.clock.base import sleep_ns
from orchestrator.clock.owner import wait_for_first
from orchestrator.coordinator.alarms.store import AlarmStore
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.journal.facts import AlarmNotice
from orchestrator.coordinator.leadership.environment import RunCommand
from orchestrator.model.alarm_rules import MINUTE_NS, NotifyCommand
from orchestrator.model.operation.alarms import AlarmRecord

MAX_PAUSE_NS = 15 * MINUTE_NS
MAX_NOTICES = 500  # that are pending; then the oldest are given up
VARIABLES = ("id", "kind", "subject", "priority", "text", "action", "state", "raised_utc", "count", "change", "source")


@dataclass(slots=True)
class _PendingNotice:
    record: AlarmRecord
    tries: int
    due_ns: int


def make_variables(record: AlarmRecord) -> dict[str, str]:
    """What the command finds in its environment."""
    return {f"TUTTI_ALARM_{name.upper()}": str(getattr(record, name)).replace("\0", " ") for name in VARIABLES}


class AlarmNotifier:
    """Runs the command of `notify` in the fleet file of `access`, which may have none."""

    def __init__(self, run_command: RunCommand, store: AlarmStore, access: FleetAccess) -> None:
        self._run_command = run_command
        self._store = store
        self._clock = access.clock
        self._view = access.view
        self._log = access.log
        self._pending: dict[str, _PendingNotice] = {}
        self._failures = 0
        self._wake = asyncio.Event()
        self.on_result: Callable[[int, str], None] = lambda _, __: None
        """Called after each try: with the number of failures in succession, and why."""

    def restore(self, notices: Iterable[AlarmNotice]) -> None:
        """Go on with the notices that the last leader has left."""
        for record, tries in notices:
            self._add(record, tries)

    def needs_notice(self, record: AlarmRecord) -> bool:
        """Whether the command is to be run for an alarm. Not for that of the command itself."""
        command = self._view.fleet.notify
        return command is not None and record.priority in command.priorities and record.kind != "notify"

    def add_notice(self, record: AlarmRecord) -> None:
        """Run the command for an alarm."""
        self._add(record, 0)

    def _add(self, record: AlarmRecord, tries: int) -> None:
        self._pending[record.change] = _PendingNotice(record, tries, self._clock.now_ns())
        while len(self._pending) > MAX_NOTICES:
            self._end_notice(next(iter(self._pending)))
        self._wake.set()

    async def run(self) -> None:
        """Run commands, one after the other."""
        while True:
            command = self._view.fleet.notify
            if command is None:
                for change in list(self._pending):
                    self._end_notice(change)
            if command is None or not self._pending:
                self._wake.clear()
                await self._wake.wait()
                continue
            change, notice = min(self._pending.items(), key=lambda entry: entry[1].due_ns)
            await self._wait_until(notice.due_ns)
            if notice.due_ns <= self._clock.now_ns():
                await self._try_notice(command, change, notice)

    async def _wait_until(self, due_ns: int) -> None:
        """Wait for an instant, or for a new notice."""
        left_ns = due_ns - self._clock.now_ns()
        if left_ns > 0:
            self._wake.clear()
            await wait_for_first(sleep_ns(self._clock, left_ns), self._wake.wait())

    async def _try_notice(self, command: NotifyCommand, change: str, notice: _PendingNotice) -> None:
        record = notice.record
        result = await self._run_command(command.command, record.to_json(), make_variables(record), command.timeout)
        reason = result.why or f"exit code {result.exit_code}"
        if result.exit_code == 0:
            self._failures = 0
            self._end_notice(change)
        else:
            self._failures += 1
            self._note_failure(command, change, notice, reason)
        self.on_result(self._failures, reason)

    def _note_failure(self, command: NotifyCommand, change: str, notice: _PendingNotice, why: str) -> None:
        notice.tries += 1
        pause_ns = min(command.pause * 2 ** min(notice.tries - 1, 20), MAX_PAUSE_NS)
        notice.due_ns = self._clock.now_ns() + pause_ns
        given_up = notice.tries >= command.tries
        if given_up:
            self._end_notice(change)
        elif change in self._pending:
            self._store.note_tries(change, notice.tries)
        end = "given up" if given_up else f"try {notice.tries} of {command.tries}"
        self._log.warning(f"the command for alarm {notice.record.id} has failed ({end}): {why}")

    def _end_notice(self, change: str) -> None:
        self._pending.pop(change, None)
        self._store.note_tries(change, None)
