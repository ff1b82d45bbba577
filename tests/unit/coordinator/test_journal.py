"""The journal: its contents, the upgrade from older versions, and its behaviour when the disk fails."""

import asyncio
import sqlite3
import threading
from pathlib import Path

import pytest

from orchestrator.clock.executor import ThreadExecutor
from orchestrator.coordinator.journal.facts import KeyedJob, QueueEntryOptions, RetryOrigin, StepDecision
from orchestrator.coordinator.journal.records import DamagedRecord, EpochOvertaken, JobHasEnded, JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal, require_journal
from orchestrator.coordinator.journal.sqlite.schema import MIGRATIONS, SCHEMA, VERSION
from orchestrator.model.jobs.files import parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.approval import JobApproval, JobPlan
from orchestrator.model.queue import APPROVAL, WAITS_FOR_APPROVAL, QueueStop, QueueTerms
from orchestrator.model.report import FINISHED_STATES, JobReport, JobState, JobTransition

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


def end(journal: SqliteJournal, job_id: str, state: JobState = "done") -> None:
    transition = JobTransition(state=state, reason="", actor="a", utc=utc(2))
    journal.record_end(job_id, transition, report(job_id, state))


def test_accepted_is_on_disk_with_its_terms(tmp_path: Path) -> None:
    path = tmp_path / "state" / "journal.db"
    journal = SqliteJournal(path)
    terms = QueueTerms(priority=3, repeat=2, after="b", at="2026-12-01T12:00:00+02:00", missed="run", held=True)
    assert journal.accept_job("a", "key", JOB, utc(1), QueueEntryOptions(terms, RetryOrigin("z", 1))) == ("a", True)
    assert journal.accept_job("b", "key", JOB, utc(2)) == ("a", False)
    # Another process sees it at once, even if this one dies.
    row = SqliteJournal(path).load_record("a")
    assert row is not None
    assert row.terms == terms
    assert (row.at_utc, row.due, row.held_by) == ("2026-12-01T10:00:00.000000Z", False, "unknown")
    assert (row.origin, row.from_step, row.place) == ("z", 1, 1)
    assert journal.database.connection.execute("PRAGMA synchronous").fetchone() == (2,)


def test_jobs_are_found_by_state_name_and_time() -> None:
    journal = SqliteJournal(":memory:")
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


def test_a_job_that_is_no_longer_queued_cannot_be_restored() -> None:
    journal = SqliteJournal(":memory:")
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


def test_old_jobs_are_deleted_with_all_their_records() -> None:
    journal = SqliteJournal(":memory:")
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


def test_an_ended_job_stays_ended_and_an_older_leader_cannot_write() -> None:
    journal = SqliteJournal(":memory:")
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


@pytest.mark.parametrize("version", range(1, VERSION))
def test_upgrade_from_older_versions(tmp_path: Path, version: int) -> None:
    path = tmp_path / "journal.db"
    old = sqlite3.connect(path)
    steps = SCHEMA + "".join(MIGRATIONS[each] for each in range(1, version))
    old.executescript(f"{steps} PRAGMA user_version={version};")
    for number, state in enumerate(("done", "queued", "running"), 1):
        values = (f"j{number}", f"k{number}", "scan", "anna", JOB.model_dump_json(), state, "why", utc(number))
        old.execute(
            "INSERT INTO jobs (id, client_key, name, actor, body, state, reason, submitted_utc)"
            " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            values,
        )
    if version >= 3:
        old.execute("UPDATE jobs SET place = number")
    old.commit()
    old.close()
    journal = SqliteJournal(path)
    assert [(row.id, row.place, row.terms) for row in journal.list_unfinished()] == [
        ("j2", 2, QueueTerms()),
        ("j3", 3, QueueTerms()),
    ]
    assert journal.accept_job("x", "k1", JOB, utc(4)) == ("j1", False)
    # Its keys had no owner: they count for all.
    assert journal.accept_job("x", "k1", JOB, utc(4), QueueEntryOptions(key_owner="anna")) == ("j1", False)
    assert journal.accept_job("j4", "k4", JOB, utc(4)) == ("j4", True)
    assert journal.database.connection.execute("PRAGMA user_version").fetchone() == (VERSION,)
    journal.close()
    assert [row.id for row in SqliteJournal(path).list_unfinished()] == ["j2", "j3", "j4"]


def test_jobs_of_an_older_version_keep_their_checksums(tmp_path: Path) -> None:
    """Those of version 9 were made without the column `proposed`."""
    path = tmp_path / "journal.db"
    journal = SqliteJournal(path)
    journal.accept_job("a", "a", JOB, utc(1))
    columns = [f"ALTER TABLE jobs DROP COLUMN {name}" for name in ("proposed", "request_digest", "continues")]
    columns.append("ALTER TABLE point_rows DROP COLUMN flown")
    for statement in ("DROP TABLE approvals", "DROP TABLE commands", "DROP TABLE learned", *columns):
        journal.database.connection.execute(statement)
    journal.database.connection.execute("PRAGMA user_version=9")
    journal.close()
    journal = SqliteJournal(path)
    assert journal.load_job("a") == JOB
    row = journal.load_record("a")
    assert row is not None and not row.proposed
    journal.database.connection.execute("UPDATE jobs SET proposed = 1")
    with pytest.raises(DamagedRecord, match="its checksum is wrong"):
        journal.load_job("a")


def test_a_key_is_of_its_owner_alone() -> None:
    journal = SqliteJournal(":memory:")
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


def test_an_approval_releases_its_job_and_is_deleted_with_it() -> None:
    journal = SqliteJournal(":memory:")
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
    journal.database.connection.execute("UPDATE approvals SET body = replace(body, 'anna', 'anne')")
    with pytest.raises(DamagedRecord, match="the approval of job a is damaged"):
        journal.approvals.load_approval("a")
    end(journal, "a", "cancelled")
    assert not journal.approvals.approve_job(approval("a"), approved)
    journal.approvals.void_approval("a", changed)
    row = journal.load_record("a")
    assert row is not None and row.state == "cancelled"
    assert journal.prune_jobs(utc(9), 0) == 1 and journal.approvals.load_approval("a") is None


def refused(path: Path) -> str:
    """The result of opening; the file is unchanged."""
    before = path.read_bytes()
    with pytest.raises(JournalError) as caught:
        SqliteJournal(path)
    assert path.read_bytes() == before
    assert str(path) in str(caught.value)
    assert caught.value.remedy
    return str(caught.value)


def test_a_foreign_file_is_not_touched(tmp_path: Path) -> None:
    text = tmp_path / "text"
    text.write_text("no data base at all" * 100)
    assert "file is not a database" in refused(text)
    other = tmp_path / "other.db"
    db = sqlite3.connect(other)
    db.execute("CREATE TABLE meta (mine)")
    db.commit()
    db.close()
    assert "is a database, but not a journal" in refused(other)
    newer = tmp_path / "newer.db"
    db = sqlite3.connect(newer)
    db.execute(f"PRAGMA user_version={VERSION + 1}")
    db.commit()
    db.close()
    assert f"schema {VERSION + 1} is newer than this Tutti's {VERSION}" in refused(newer)
    with pytest.raises(JournalError, match="cannot be used"):
        SqliteJournal(tmp_path)


def test_a_damaged_journal_is_reported_and_not_written_to(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    journal = SqliteJournal(path)
    for number in range(300):
        journal.accept_job(str(number), str(number), JOB, utc(1))
    journal.close()
    data = bytearray(path.read_bytes())
    assert len(data) > 8 * 4096
    for page in range(2, 8):
        data[page * 4096 : page * 4096 + 64] = bytes(64)
    path.write_bytes(data)
    assert "cannot be used" in refused(path)


def test_a_disk_that_fills_up_or_turns_read_only(tmp_path: Path) -> None:
    journal = SqliteJournal(tmp_path / "journal.db")
    db = journal.database.connection
    pages = db.execute("PRAGMA page_count").fetchone()[0]
    db.execute(f"PRAGMA max_page_count={pages + 4}")
    accepted = 0
    with pytest.raises(JournalError, match="database or disk is full") as caught:
        while True:
            journal.accept_job(str(accepted), str(accepted), JOB, utc(1))
            accepted += 1
    assert "free space" in caught.value.remedy
    # A refused write leaves no partial record, and everything continues when there is space again.
    assert len(journal.list_unfinished()) == accepted
    with pytest.raises(JournalError):
        journal.accept_job("x", "x", JOB, utc(1))
    db.execute("PRAGMA max_page_count=100000")
    assert journal.accept_job("x", "x", JOB, utc(1)) == ("x", True)
    db.execute("PRAGMA query_only=ON")
    with pytest.raises(JournalError, match="readonly database"):
        journal.accept_job("y", "y", JOB, utc(1))
    assert len(journal.list_unfinished()) == accepted + 1
    assert {row.state for row in journal.list_unfinished()}.isdisjoint(FINISHED_STATES)


def test_an_unreadable_body_names_the_job() -> None:
    journal = SqliteJournal(":memory:")
    journal.accept_job("a", "a", JOB, utc(1))
    journal.database.connection.execute("UPDATE jobs SET body = '{}'")
    with pytest.raises(JournalError, match="the Job of job a cannot be read"):
        journal.load_job("a")


def test_a_deleted_or_replaced_file_accepts_nothing(tmp_path: Path) -> None:
    path = tmp_path / "state" / "journal.db"
    journal = SqliteJournal(path)
    assert journal.accept_job("a", "a", JOB, utc(1)) == ("a", True)
    (tmp_path / "state").rename(tmp_path / "moved")
    with pytest.raises(JournalError, match="deleted or replaced") as caught:
        journal.accept_job("b", "b", JOB, utc(1))
    assert "--new-journal" in caught.value.remedy
    SqliteJournal(path).close()
    with pytest.raises(JournalError, match="deleted or replaced"):
        journal.accept_job("b", "b", JOB, utc(1))
    assert SqliteJournal(path).load_record("b") is None and journal.load_record("b") is None


def test_its_files_are_for_its_user_alone_and_no_link_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "state" / "journal.db"
    journal = SqliteJournal(path)
    journal.accept_job("a", "a", JOB, utc(1))
    modes = {each.name: each.stat().st_mode & 0o777 for each in (path.parent, *path.parent.iterdir())}
    files = ("journal.db", "journal.db-points")
    assert modes == {"state": 0o700} | {f"{name}{end}": 0o600 for name in files for end in ("", "-wal", "-shm")}
    victim, link = tmp_path / "victim", tmp_path / "link.db"
    victim.write_text("")
    link.symlink_to(victim)
    with pytest.raises(JournalError, match=r"link\.db: is a symbolic link, to .*victim'; remove it"):
        SqliteJournal(link)
    assert victim.read_bytes() == b""


def test_a_missing_journal_is_required_of_a_fleet_that_had_one(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="journal of this fleet is missing") as caught:
        require_journal(tmp_path / "journal.db")
    assert "--new-journal" in caught.value.remedy
    SqliteJournal(tmp_path / "journal.db")
    require_journal(tmp_path / "journal.db")


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
def test_a_damaged_record_is_a_failed_job_and_affects_no_other(damage: str, shown: str) -> None:
    journal = SqliteJournal(":memory:")
    for job_id in ("a", "b"):
        journal.accept_job(job_id, job_id, JOB, utc(1))
    journal.database.connection.execute(f"UPDATE jobs SET {damage} WHERE id = 'a'")
    first, second = journal.list_unfinished()
    assert (second.id, second.state, second.damage) == ("b", "queued", "")
    assert (first.id, first.state) == ("a", "failed") and first.damage.endswith(shown)
    assert first.terms == QueueTerms() and {each.id for each in journal.find_jobs(9)[0]} == {"a", "b"}
    transition = JobTransition(state="failed", reason=first.damage, actor="x", utc=utc(2))
    journal.fail_damaged(first, transition, report("a", "failed"))
    assert [row.id for row in journal.list_unfinished()] == ["b"]
    assert journal.load_report("a") == report("a", "failed")


@pytest.mark.parametrize("column", ["name", "actor", "body", "submitted_utc", "missed"])
def test_a_bit_that_changes_in_a_job_is_noticed_although_the_job_can_be_read(column: str) -> None:
    """One more second of dwell, or the target of a move."""
    journal = SqliteJournal(":memory:")
    terms = QueueTerms(at="2026-12-01T12:00:00+02:00", missed="run")
    journal.accept_job("a", "a", JOB, utc(1), QueueEntryOptions(terms))
    change = "replace(body, '1', '3')" if column == "body" else f"replace({column}, substr({column}, 2, 1), '2')"
    journal.database.connection.execute(f"UPDATE jobs SET {column} = {change}")
    with pytest.raises(DamagedRecord, match="the Job of job a cannot be read: its checksum is wrong"):
        journal.load_job("a")


@pytest.mark.parametrize("damaged", ["meta", "meta_copies"])
def test_a_bit_that_changes_in_a_value_is_taken_back_from_its_copy(damaged: str) -> None:
    journal = SqliteJournal(":memory:")
    journal.take_epoch(6)
    assert journal.fleet_time_scale("k", 1234, "s") == ("s", 1234)
    stop = QueueStop(reason="test", actor="anna", utc=utc(1))
    journal.store_queue_stop(stop)
    journal.store_instances({"a": "i1"})
    journal.database.connection.execute(f"UPDATE {damaged} SET value = replace(replace(value, '7', '3'), '2', '6')")
    journal.database.connection.execute(f"UPDATE {damaged} SET value = 'x' WHERE key IN ('kernel_id', 'instances')")
    assert journal.take_epoch(0) == 8
    assert journal.fleet_time_scale("k", 99, "t") == ("s", 1234)
    assert journal.load_queue_stop() == stop and journal.load_instances() == {"a": "i1"}


def test_a_scale_whose_origin_cannot_be_read_begins_anew() -> None:
    journal = SqliteJournal(":memory:")
    journal.fleet_time_scale("k", 1234, "s")
    for table in ("meta", "meta_copies"):
        journal.database.connection.execute(f"UPDATE {table} SET value = '12x4' WHERE key = 'origin_host_ns'")
    assert journal.fleet_time_scale("k", 99, "t") == ("t", 99)


def test_damaged_bytes_and_damaged_values_of_the_queue(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    journal = SqliteJournal(path)
    for job_id in ("a", "b"):
        journal.accept_job(job_id, job_id, JOB, utc(1))
    db = journal.database.connection
    db.execute("UPDATE jobs SET body = CAST(X'7B22FF' AS TEXT), name = CAST(X'FF41' AS TEXT) WHERE id = 'a'")
    db.execute("UPDATE transitions SET state = 'q' WHERE job_id = 'a'")
    db.executemany("INSERT INTO meta VALUES (?, '{x')", [("queue_stop",), ("instances",)])
    assert [row.name for row in journal.list_unfinished()] == ["\ufffdA", "scan"]
    for load in (journal.load_job, journal.list_transitions):
        with pytest.raises(DamagedRecord, match="of job a cannot be read"):
            load("a")
    assert journal.load_job("b") == JOB
    stop = journal.load_queue_stop()
    assert stop is not None and "damaged" in stop.reason and journal.load_instances() == {}
    db.execute("INSERT OR REPLACE INTO meta VALUES ('epoch', '1x')")
    with pytest.raises(JournalError, match="its epoch '1x' is damaged"):
        journal.take_epoch(0)


def test_it_is_closed_after_the_calls_that_still_use_it() -> None:
    """Closed under a call of another thread, SQLite ended a coordinator that had lost its leadership with a
    segmentation fault."""
    journal, runs = SqliteJournal(":memory:"), ThreadExecutor("journal")
    go_on, used = threading.Event(), list[str]()

    def slow() -> None:
        go_on.wait(30)
        journal.require_latest_epoch(1)
        used.append("read")

    async def leave() -> None:
        reading, closing = asyncio.ensure_future(runs(slow)), asyncio.ensure_future(runs(journal.close))
        await asyncio.sleep(0)
        go_on.set()
        await reading
        await closing
        with pytest.raises(JournalError, match="closed"):
            await runs(journal.require_latest_epoch, 1)

    asyncio.run(leave())
    assert used == ["read"]
