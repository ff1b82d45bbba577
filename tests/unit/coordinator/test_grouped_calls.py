"""Calls of the journal that wait at the same time are one commit, and each has its own result."""

import asyncio
import sqlite3
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from cluster.worlds import job

from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.owner import TaskOwner
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.facts import StepDecision
from orchestrator.coordinator.journal.grouped_calls import LATER_NS, GroupedCalls
from orchestrator.coordinator.journal.records import EpochOvertaken, JobHasEnded, JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.model.operation.commands import CommandRecord
from orchestrator.model.report import JobState, JobTransition
from orchestrator.runtime.virtual.disk import VirtualDisk
from orchestrator.runtime.virtual.journal import JournalCalls

UTC = "2026-11-21T10:00:00.000000Z"
WRITE_NS = 5 * NS_PER_MS
COMMAND = CommandRecord(utc=UTC, actor="anna", verb="submit", subject="a", refused="")


def change(state: JobState) -> JobTransition:
    return JobTransition(state=state, reason="", actor="anna", utc=UTC)


class Desk:
    """A journal with two jobs, and the calls of a coordinator on a disk that takes `WRITE_NS` for each call."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.disk = VirtualDisk(clock)
        self.disk.draw_delay_ns = lambda: WRITE_NS
        self.journal = SqliteJournal(":memory:")
        self.epoch = self.journal.take_epoch(0)
        for name in "ab":
            self.journal.accept_job(name, name, job("[{do: dwell, duration: 1 s}]"), UTC)
        self.counted = JournalCalls(self.disk)
        run = self.counted.make_executor()
        self.calls = GroupedCalls(self.journal, run, clock, lambda: self.epoch, TaskOwner())
        self.errors: list[str] = []
        self.calls.on_error = lambda error: self.errors.append(str(error))

    async def change(self, name: str, state: JobState) -> None:
        await self.calls(self.journal.record_transition, name, change(state))

    def change_later(self, name: str, state: JobState) -> None:
        self.calls.later(lambda error: None, self.journal.record_transition, name, change(state))

    def states(self, name: str) -> list[str]:
        return [transition.state for transition in self.journal.list_transitions(name)]


def run_desk(main: Callable[[Desk], Coroutine[Any, Any, None]]) -> None:
    run_virtual(lambda clock: main(Desk(clock)))


def test_calls_that_wait_are_one_commit() -> None:
    async def main(desk: Desk) -> None:
        states: list[JobState] = ["planning", "arming", "armed", "committed", "running"]
        await asyncio.gather(*(desk.change("a", state) for state in states))
        assert desk.states("a") == ["queued", *states]
        # The first was alone; the others came while it was written.
        assert desk.counted.writes == 2
        assert desk.clock.now_ns() == 2 * WRITE_NS

    run_desk(main)


def test_each_call_has_its_own_error() -> None:
    async def main(desk: Desk) -> None:
        await desk.change("b", "cancelled")
        first = asyncio.ensure_future(desk.change("a", "planning"))
        await asyncio.sleep(0)
        results = await asyncio.gather(
            desk.change("a", "arming"), desk.change("b", "done"), desk.change("a", "armed"), return_exceptions=True
        )
        await first
        assert results[0] is None and isinstance(results[1], JobHasEnded) and results[2] is None
        assert desk.states("a") == ["queued", "planning", "arming", "armed"] and desk.states("b")[-1] == "cancelled"
        assert desk.counted.writes == 3 and len(desk.errors) == 1

    run_desk(main)


def test_what_nothing_waits_for_is_written_with_the_next_write() -> None:
    async def main(desk: Desk) -> None:
        desk.change_later("a", "arming")
        desk.change_later("a", "armed")
        await asyncio.sleep(0.1)
        assert desk.states("a") == ["queued"] and desk.counted.writes == 0
        await desk.calls(desk.journal.record_decision, "a", StepDecision(0, desk.epoch, 1, "c"), UTC)
        assert desk.states("a") == ["queued", "arming", "armed"] and desk.counted.writes == 1

    run_desk(main)


def test_what_nothing_waits_for_is_written_after_a_second() -> None:
    async def main(desk: Desk) -> None:
        desk.change_later("a", "arming")
        desk.clock.call_at_ns(LATER_NS // 2, lambda: desk.change_later("a", "armed"))
        await asyncio.sleep(1.1)
        assert desk.states("a") == ["queued", "arming", "armed"] and desk.counted.writes == 1
        desk.change_later("a", "running")
        await asyncio.sleep(1.1)
        assert desk.states("a")[-1] == "running" and desk.counted.writes == 2

    run_desk(main)


def test_a_read_takes_what_waits_for_its_own_part_of_the_journal() -> None:
    async def main(desk: Desk) -> None:
        desk.calls.later(lambda error: None, desk.journal.commands.store_command, COMMAND)
        assert len(await desk.calls(desk.journal.list_transitions, "a")) == 1
        assert desk.counted.writes == 0
        desk.change_later("a", "arming")
        assert [item.state for item in await desk.calls(desk.journal.list_transitions, "a")] == ["queued", "arming"]
        assert desk.counted.writes == 1 and desk.journal.commands.list_commands(9) == []
        assert len(await desk.calls(desk.journal.commands.list_commands, 9)) == 1

    run_desk(main)


def test_a_full_disk_fails_the_writes_of_a_group_and_not_its_reads() -> None:
    async def main(desk: Desk) -> None:
        first = asyncio.ensure_future(desk.calls(desk.journal.list_transitions, "a"))
        await asyncio.sleep(0)
        desk.disk.full = True
        lost: list[str] = []
        desk.calls.later(lambda error: lost.append(str(error)), desk.journal.commands.store_command, COMMAND)
        write, read = await asyncio.gather(
            desk.change("a", "arming"), desk.calls(desk.journal.list_transitions, "a"), return_exceptions=True
        )
        assert isinstance(write, JournalError) and len(lost) == 1
        assert not isinstance(read, BaseException) and [item.state for item in read] == ["queued"]
        await first

    run_desk(main)


def test_a_call_that_is_cancelled_takes_no_other_with_it() -> None:
    async def main(desk: Desk) -> None:
        first = asyncio.ensure_future(desk.change("a", "planning"))
        desk.change_later("a", "arming")
        second = asyncio.ensure_future(desk.change("b", "planning"))
        third = asyncio.ensure_future(desk.change("b", "arming"))
        await asyncio.sleep(0.001)
        first.cancel()
        third.cancel()
        with suppress(asyncio.CancelledError):
            await first
        await second
        # The executor does what it has begun, or not: here it had not.
        assert desk.states("a")[-1] == "arming" and desk.states("b") == ["queued", "planning"]
        assert desk.states("a").count("arming") == 1

    run_desk(main)


def test_another_leader_refuses_the_whole_group() -> None:
    async def main(desk: Desk) -> None:
        desk.journal.take_epoch(0)
        desk.change_later("a", "arming")
        with pytest.raises(EpochOvertaken):
            await desk.change("a", "armed")
        assert desk.states("a") == ["queued"] and len(desk.errors) == 2

    run_desk(main)


class FullDatabase(sqlite3.Connection):
    """A database whose disk is full at the first COMMIT of more than one call."""

    full = True

    def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:  # type: ignore[override]
        if sql == "COMMIT" and self.full:
            self.full = False
            super().execute("ROLLBACK")
            raise sqlite3.OperationalError("database or disk is full")
        return super().execute(sql, *values)


def test_a_group_that_cannot_be_committed_is_run_call_by_call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "journal.db"
    journal = SqliteJournal(path)
    journal.accept_job("a", "a", job("[{do: dwell, duration: 1 s}]"), UTC)
    journal.close()
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *values, **names: connect(*values, factory=FullDatabase, **names))
    journal = SqliteJournal(path)
    calls = [JournalCall(journal.record_transition, ("a", change(state))) for state in ("planning", "arming")]
    journal.run_group(calls, 0)
    assert [call.take_result() for call in calls] == [None, None] and all(call.is_done for call in calls)
    assert [item.state for item in journal.list_transitions("a")] == ["queued", "planning", "arming"]
    journal.run_group(calls, 0)  # what is done is not done again
    assert len(journal.list_transitions("a")) == 3
