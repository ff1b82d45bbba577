"""The journal in a file: the upgrade from older versions, and its behaviour when the disk fails."""

import sqlite3
from pathlib import Path

import pytest

from orchestrator.coordinator.journal.facts import QueueEntryOptions
from orchestrator.coordinator.journal.records import DamagedRecord, JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal, require_journal
from orchestrator.coordinator.journal.sqlite.schema import MIGRATIONS, SCHEMA, VERSION
from orchestrator.model.jobs.files import parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import FINISHED_STATES

JOB = parse_document("schema: tutti.job/1\nname: scan\nsteps: [{do: dwell, duration: 1 s}]\n", Job, "test")


def utc(day: int) -> str:
    return f"2026-11-{day:02}T10:00:00.000000Z"


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


def test_damaged_bytes_make_their_own_record_unreadable(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    journal = SqliteJournal(path)
    for job_id in ("a", "b"):
        journal.accept_job(job_id, job_id, JOB, utc(1))
    db = journal.database.connection
    db.execute("UPDATE jobs SET body = CAST(X'7B22FF' AS TEXT), name = CAST(X'FF41' AS TEXT) WHERE id = 'a'")
    db.execute("UPDATE transitions SET state = 'q' WHERE job_id = 'a'")
    assert [row.name for row in journal.list_unfinished()] == ["\ufffdA", "scan"]
    for load in (journal.load_job, journal.list_transitions):
        with pytest.raises(DamagedRecord, match="of job a cannot be read"):
            load("a")
    assert journal.load_job("b") == JOB


def test_it_is_on_the_disk_when_it_is_committed() -> None:
    assert SqliteJournal(":memory:").database.select("PRAGMA synchronous") == [(2,)]
