"""The journal: what both engines do alike."""

import asyncio
import threading

import pytest
from unit.journal.engines import Engine, OpenJournal

from orchestrator.clock.executor import ThreadExecutor
from orchestrator.coordinator.journal.facts import KeyedJob, QueueEntryOptions, RetryOrigin, StepDecision
from orchestrator.coordinator.journal.records import DamagedRecord, EpochOvertaken, JobHasEnded, JournalError
from orchestrator.model.jobs.files import parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.approval import JobApproval, JobPlan
from orchestrator.model.queue import APPROVAL, WAITS_FOR_APPROVAL, QueueStop, QueueTerms
from orchestrator.model.report import JobReport, JobState, JobTransition

JOB = parse_document("schema: tutti.job/1\nname: scan\nsteps: [{do: dwell, duration: 1 s}]\n", Job, "test")


def utc(day: int) -> str:
    return f"2026-11-{day:02}T10:00:00.000000Z"


def report(job_id: str, state: JobState) -> JobReport:
    return JobReport(
        job_id=job_id,
        name="scan",
        actor="a",
        state=state,
        reason="",
        epoch=1,
        submitted_utc=utc(1),
        max_start_skew_ns=1,
    )


def end(journal: OpenJournal, job_id: str, state: JobState = "done") -> None:
    transition = JobTransition(state=state, reason="", actor="a", utc=utc(2))
    journal.record_end(job_id, transition, report(job_id, state))


def test_accepted_is_stored_with_its_terms(engine: Engine) -> None:
    journal = engine.open()
    terms = QueueTerms(priority=3, repeat=2, after="b", at="2026-12-01T12:00:00+02:00", missed="run", held=True)
    assert journal.accept_job("a", "key", JOB, utc(1), QueueEntryOptions(terms, RetryOrigin("z", 1))) == ("a", True)
    assert journal.accept_job("b", "key", JOB, utc(2)) == ("a", False)
    # Another process sees it at once, even if this one dies.
    row = engine.open().load_record("a")
    assert row is not None
    assert row.terms == terms
    assert (row.at_utc, row.due, row.held_by) == ("2026-12-01T10:00:00.000000Z", False, "unknown")
    assert (row.origin, row.from_step, row.place) == ("z", 1, 1)


def test_jobs_are_found_by_state_name_and_time(journal: OpenJournal) -> None:
    for number in range(1, 10):
        name = "100% _scan'" if number % 2 else "fill"
        journal.accept_job(str(number), f"k{number}", JOB.model_copy(update={"name": name}), utc(number))
    end(journal, "3", "failed")

    def found(limit: int = 99, **wanted: str) -> list[str]:
        rows, total = journal.find_jobs(limit, **wanted)  # type: ignore[arg-type]
        assert total == len(journal.find_jobs(99, **wanted)[0])  # type: ignore[arg-type]
        return [row.id for row in rows]

    assert found(2) == ["9", "8"]
    assert found(name="_scan'") == ["9", "7", "5", "3", "1"]
    assert found(name="%") == ["9", "7", "5", "3", "1"]
    assert found(state="failed") == ["3"]
    assert found(since_utc=utc(8)) == ["9", "8"]
    assert found(state="queued", name="fill", since_utc=utc(5)) == ["8", "6"]


def test_a_job_that_is_no_longer_queued_cannot_be_restored(journal: OpenJournal) -> None:
    journal.accept_job("a", "a", JOB, utc(1))
    end(journal, "a", "cancelled")
    late = JobTransition(state="queued", reason="held", actor="b", utc=utc(3))
    journal.hold_jobs(["a"], "b", late)
    journal.mark_due("a", late)
    journal.reorder_jobs("a", 5, {"a": 9}, late)
    row = journal.load_record("a")
    assert row is not None
    assert (row.state, row.held_by, row.priority, row.place) == ("cancelled", "", 0, 1)
    assert [each.state for each in journal.list_transitions("a")] == ["queued", "cancelled"]


def test_old_jobs_are_deleted_with_all_their_records(journal: OpenJournal) -> None:
    for number in range(1, 11):
        journal.accept_job(str(number), f"k{number}", JOB, utc(number))
        journal.record_decision(str(number), StepDecision(0, 1, 1, "gantry"), utc(number))
        if number not in (2, 9):
            end(journal, str(number))
    journal.accept_job("x", "x", JOB, utc(11), QueueEntryOptions(QueueTerms(after="3")))
    assert journal.prune_jobs(utc(8), keep=5) == 4
    # 2 has not ended, x comes after 3, and of the newest five none is removed.
    assert sorted(row.id for row in journal.find_jobs(99)[0]) == sorted(["2", "3", "7", "8", "9", "10", "x"])
    assert journal.load_report("4") is None
    assert journal.list_decisions("4") == []
    assert journal.list_transitions("4") == []
    assert journal.accept_job("4", "k4", JOB, utc(12)) == ("4", True)
    assert journal.prune_jobs(utc(30), keep=1000) == 0


def test_an_ended_job_stays_ended_and_an_older_leader_cannot_write(journal: OpenJournal) -> None:
    epoch = journal.take_epoch(0)
    journal.accept_job("1", "k1", JOB, utc(1))
    end(journal, "1")
    with pytest.raises(JobHasEnded, match="job 1 is done already"):
        end(journal, "1", "failed")
    with pytest.raises(JobHasEnded):
        journal.record_decision("1", StepDecision(0, epoch, 1, "gantry"), utc(2))
    assert journal.list_decisions("1") == [] and [each.state for each in journal.list_transitions("1")][-1] == "done"
    journal.require_latest_epoch(epoch)
    journal.take_epoch(0)
    with pytest.raises(EpochOvertaken, match="epoch 1 is over"):
        journal.require_latest_epoch(epoch)


def test_a_key_is_of_its_owner_alone(journal: OpenJournal) -> None:
    for owner in ("anna", "ben"):
        options = QueueEntryOptions(key_owner=owner, digest=f"digest of {owner}")
        assert journal.accept_job(owner, "nightly-1", JOB, utc(1), options) == (owner, True)
        assert journal.accept_job("x", "nightly-1", JOB, utc(2), options) == (owner, False)
        keyed = KeyedJob(owner, JOB.actor, utc(1), f"digest of {owner}")
        assert journal.find_keyed_job(owner, "nightly-1") == keyed
        assert journal.load_job(owner) == JOB
    assert journal.find_keyed_job("eve", "nightly-1") is None


def approval(job_id: str) -> JobApproval:
    return JobApproval(job_id=job_id, plan=JobPlan.of({"job": "test"}), actor="anna", utc=utc(2))


def test_an_approval_releases_its_job_and_is_deleted_with_it(journal: OpenJournal) -> None:
    proposed = QueueEntryOptions(QueueTerms(proposed=True))
    journal.accept_job("a", "a", JOB, utc(1), proposed)
    row = journal.load_record("a")
    assert row is not None and row.terms.proposed and (row.held_by, row.reason) == (APPROVAL, WAITS_FOR_APPROVAL)
    approved = JobTransition(state="queued", reason="approved", actor="anna", utc=utc(2))
    assert journal.approvals.load_approval("a") is None
    assert journal.approvals.approve_job(approval("a"), approved)
    row = journal.load_record("a")
    assert row is not None and (row.held_by, row.reason) == ("", "approved")
    changed = JobTransition(state="queued", reason="held again: x", actor="coordinator", utc=utc(3))
    journal.approvals.void_approval("a", changed)
    found, row = journal.approvals.load_approval("a"), journal.load_record("a")
    assert found == approval("a").model_copy(update={"void": "held again: x"})
    assert row is not None and row.held_by == APPROVAL
    journal.database.write("UPDATE approvals SET body = replace(body, 'anna', 'anne')")
    with pytest.raises(DamagedRecord, match="the approval of job a is damaged"):
        journal.approvals.load_approval("a")
    end(journal, "a", "cancelled")
    assert not journal.approvals.approve_job(approval("a"), approved)
    journal.approvals.void_approval("a", changed)
    row = journal.load_record("a")
    assert row is not None and row.state == "cancelled"
    assert journal.prune_jobs(utc(9), 0) == 1 and journal.approvals.load_approval("a") is None


def test_an_unreadable_body_names_the_job(journal: OpenJournal) -> None:
    journal.accept_job("a", "a", JOB, utc(1))
    journal.database.write("UPDATE jobs SET body = '{}'")
    with pytest.raises(JournalError, match="the Job of job a cannot be read"):
        journal.load_job("a")


@pytest.mark.parametrize(
    ("damage", "shown"),
    [
        ("state = 'queuee'", "the state 'queuee'"),
        ("at_utc = '2026-13-01'", "at '2026-13-01'"),
        ("priority = 4096", "priority 4096"),
        ("missed = 'Skip'", "missed 'Skip'"),
        ("submitted_utc = 'x'", "the time 'x'"),
    ],
)
def test_a_damaged_record_is_a_failed_job_and_affects_no_other(journal: OpenJournal, damage: str, shown: str) -> None:
    for job_id in ("a", "b"):
        journal.accept_job(job_id, job_id, JOB, utc(1))
    journal.database.write(f"UPDATE jobs SET {damage} WHERE id = 'a'")
    first, second = journal.list_unfinished()
    assert (second.id, second.state, second.damage) == ("b", "queued", "")
    assert (first.id, first.state) == ("a", "failed") and first.damage.endswith(shown)
    assert first.terms == QueueTerms() and {each.id for each in journal.find_jobs(9)[0]} == {"a", "b"}
    transition = JobTransition(state="failed", reason=first.damage, actor="x", utc=utc(2))
    journal.fail_damaged(first, transition, report("a", "failed"))
    assert [row.id for row in journal.list_unfinished()] == ["b"]
    assert journal.load_report("a") == report("a", "failed")


@pytest.mark.parametrize("column", ["name", "actor", "body", "submitted_utc", "missed"])
def test_a_bit_that_changes_in_a_job_is_noticed_although_the_job_can_be_read(journal: OpenJournal, column: str) -> None:
    """One more second of dwell, or the target of a move."""
    terms = QueueTerms(at="2026-12-01T12:00:00+02:00", missed="run")
    journal.accept_job("a", "a", JOB, utc(1), QueueEntryOptions(terms))
    change = "replace(body, '1', '3')" if column == "body" else f"replace({column}, substr({column}, 2, 1), '2')"
    journal.database.write(f"UPDATE jobs SET {column} = {change}")
    with pytest.raises(DamagedRecord, match="the Job of job a cannot be read: its checksum is wrong"):
        journal.load_job("a")


@pytest.mark.parametrize("damaged", ["meta", "meta_copies"])
def test_a_bit_that_changes_in_a_value_is_taken_back_from_its_copy(journal: OpenJournal, damaged: str) -> None:
    journal.set_epoch(6)
    journal.take_epoch(0)
    assert journal.fleet_time_scale("k", 1234, "s") == ("s", 1234)
    stop = QueueStop(reason="test", actor="anna", utc=utc(1))
    journal.store_queue_stop(stop)
    journal.store_instances({"a": "i1"})
    journal.database.write(f"UPDATE {damaged} SET value = replace(replace(value, '7', '3'), '2', '6')")
    journal.database.write(f"UPDATE {damaged} SET value = 'x' WHERE key IN ('kernel_id', 'instances')")
    assert journal.take_epoch(0) == 8
    assert journal.fleet_time_scale("k", 99, "t") == ("s", 1234)
    assert journal.load_queue_stop() == stop and journal.load_instances() == {"a": "i1"}


def test_a_scale_whose_origin_cannot_be_read_begins_anew(journal: OpenJournal) -> None:
    journal.fleet_time_scale("k", 1234, "s")
    for table in ("meta", "meta_copies"):
        journal.database.write(f"UPDATE {table} SET value = '12x4' WHERE key = 'origin_host_ns'")
    assert journal.fleet_time_scale("k", 99, "t") == ("t", 99)


def test_it_is_closed_after_the_calls_that_still_use_it(journal: OpenJournal) -> None:
    """Closed under a call of another thread, SQLite ended a coordinator that had lost its leadership with a
    segmentation fault."""
    runs = ThreadExecutor("journal")
    go_on, used = threading.Event(), list[str]()

    def slow() -> None:
        go_on.wait(30)
        journal.require_latest_epoch(0)
        used.append("read")

    async def leave() -> None:
        reading, closing = asyncio.ensure_future(runs(slow)), asyncio.ensure_future(runs(journal.close))
        await asyncio.sleep(0)
        go_on.set()
        await reading
        await closing
        with pytest.raises(JournalError, match="closed"):
            await runs(journal.require_latest_epoch, 0)

    asyncio.run(leave())
    assert used == ["read"]


def test_damaged_values_of_the_queue(journal: OpenJournal) -> None:
    for key in ("queue_stop", "instances", "epoch"):
        journal.database.write("INSERT INTO meta (key, value) VALUES (?, '{x')", (key,))
    stop = journal.load_queue_stop()
    assert stop is not None and "damaged" in stop.reason and journal.load_instances() == {}
    with pytest.raises(JournalError, match=r"its epoch .* is damaged"):
        journal.take_epoch(0)
