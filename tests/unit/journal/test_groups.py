"""Calls that are one commit: each has its own result or error, on a file as on a server."""

import pytest
from unit.journal.engines import Engine, OpenJournal
from unit.journal.stored_points import AXES, NOON, make_points
from unit.journal.test_journal import JOB, end, utc

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.records import EpochOvertaken, JobHasEnded, JournalError
from orchestrator.model.errors import Refusal
from orchestrator.model.report import JobState, JobTransition


def change(state: JobState) -> JobTransition:
    return JobTransition(state=state, reason="", actor="anna", utc=utc(1))


def list_states(journal: OpenJournal, name: str) -> list[str]:
    return [transition.state for transition in journal.list_transitions(name)]


@pytest.fixture
def two_jobs(journal: OpenJournal) -> OpenJournal:
    for name in "ab":
        journal.accept_job(name, name, JOB, utc(1))
    return journal


def test_an_error_of_one_call_undoes_that_one_alone(two_jobs: OpenJournal, engine: Engine) -> None:
    end(two_jobs, "b", "cancelled")
    calls = [
        JournalCall(two_jobs.record_transition, ("a", change("arming"))),
        JournalCall(two_jobs.record_transition, ("b", change("arming"))),
        JournalCall(two_jobs.list_transitions, ("a",)),
        JournalCall(two_jobs.accept_job, ("c", "a", JOB, utc(1))),
        JournalCall(two_jobs.record_transition, ("a", change("armed"))),
    ]
    two_jobs.run_group(calls, 0)
    assert all(call.is_done for call in calls)
    with pytest.raises(JobHasEnded):
        calls[1].take_result()
    assert [each.state for each in calls[2].take_result()] == ["queued", "arming"]
    assert calls[3].take_result() == ("a", False)
    other = engine.open()
    assert list_states(other, "a") == ["queued", "arming", "armed"] and list_states(other, "b")[-1] == "cancelled"


def test_what_a_call_of_a_group_ends_is_ended_for_those_behind_it(two_jobs: OpenJournal) -> None:
    calls = [
        JournalCall(two_jobs.record_transition, ("a", change("arming"))),
        JournalCall(end, (two_jobs, "a", "cancelled")),
        JournalCall(two_jobs.record_transition, ("a", change("armed"))),
    ]
    two_jobs.run_group(calls, 0)
    assert [call.error for call in calls[:2]] == [None, None] and isinstance(calls[2].error, JobHasEnded)
    assert list_states(two_jobs, "a") == ["queued", "arming", "cancelled"]


@pytest.mark.parametrize("count", [1, 2])
def test_a_coordinator_that_is_overtaken_neither_writes_nor_reads(
    two_jobs: OpenJournal, engine: Engine, count: int
) -> None:
    epoch = two_jobs.take_epoch(0)
    engine.open().take_epoch(0)
    for function, values in ((two_jobs.load_record, ("a",)), (two_jobs.record_transition, ("a", change("arming")))):
        calls = [JournalCall(function, values) for _ in range(count)]
        with pytest.raises(EpochOvertaken):
            two_jobs.run_group(calls, epoch)
            calls[-1].take_result()
    assert list_states(engine.open(), "a") == ["queued"]


def test_an_error_of_the_database_fails_its_own_call_alone(two_jobs: OpenJournal) -> None:
    calls = [
        JournalCall(two_jobs.record_transition, ("a", change("arming"))),
        JournalCall(two_jobs.record_transition, ("none", change("arming"))),
        JournalCall(two_jobs.record_transition, ("b", change("arming"))),
    ]
    two_jobs.run_group(calls, 0)
    assert [call.error for call in calls[::2]] == [None, None]
    assert isinstance(calls[1].error, JournalError)
    assert list_states(two_jobs, "a") == list_states(two_jobs, "b") == ["queued", "arming"]


def test_points_that_are_refused_are_deleted_although_they_are_refused(two_jobs: OpenJournal) -> None:
    digest, rows = make_points(10)
    calls = [
        JournalCall(two_jobs.points.begin_upload, (digest, AXES, 10, NOON, [])),
        JournalCall(two_jobs.points.add_part, (digest, 0, rows[::-1], NOON)),
        JournalCall(two_jobs.record_transition, ("a", change("arming"))),
    ]
    two_jobs.run_group(calls, 0)
    assert isinstance(calls[1].error, Refusal) and two_jobs.points.used_bytes == 0
    assert list_states(two_jobs, "a") == ["queued", "arming"]
