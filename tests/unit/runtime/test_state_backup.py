"""Backups, exports and imports of a state folder: what they contain, and what they refuse."""

import hashlib
import io
import json
import re
import sqlite3
import stat
import tarfile
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from random import Random

import numpy as np
import pytest
from click.testing import CliRunner, Result

from adapters.controller.state.store import AdapterMemory, FileStore
from orchestrator.bus.latch import FileLatchStore
from orchestrator.cli.main import main
from orchestrator.coordinator.journal.facts import AlarmChange, QueueEntryOptions, StepDecision
from orchestrator.coordinator.journal.records import BadBackup, JournalError
from orchestrator.coordinator.journal.sqlite.inspection import check_journal
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.portable import import_journal, read_stored_epoch
from orchestrator.coordinator.journal.sqlite.schema import MIGRATIONS, SCHEMA, VERSION
from orchestrator.model.files.private_files import replace_private_file
from orchestrator.model.jobs.files import parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.operation.approval import JobApproval, JobPlan
from orchestrator.model.positions.entries import SavedPosition
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobTransition
from orchestrator.model.state import EstopLatch
from orchestrator.model.steps.points import PointAxis, make_header
from orchestrator.model.units import Unit
from orchestrator.runtime.state.folder import FLEET_FILE, JOURNAL, StateLock

JOB = parse_document("schema: tutti.job/1\nname: scan\nsteps: [{do: dwell, duration: 1 s}]\n", Job, "test")
UTC = "2026-01-02T03:04:05.000000Z"
POINTS = np.arange(6, dtype="<f8").tobytes()
AXES = [PointAxis(axis="gantry.x", unit=Unit("mm"))]
DIGEST = f"sha256:{hashlib.sha256(make_header(AXES) + POINTS).hexdigest()}"
LATCH = EstopLatch(event="e1", actor="anna", reason="smoke", utc=UTC)


def make_folder(folder: Path) -> SqliteJournal:
    """A state folder as a fleet leaves it, or has it while it runs: the journal is open."""
    journal = SqliteJournal(folder / JOURNAL)
    for _ in range(3):
        journal.take_epoch(0)
    for number, state in enumerate(("done", "running", "queued")):
        name = f"job{number}"
        journal.accept_job(name, f"key{number}", JOB, UTC, QueueEntryOptions(QueueTerms(proposed=number == 2)))
        if state != "queued":
            journal.record_decision(name, StepDecision(0, 3, 5, "gantry"), UTC)
            journal.record_transition(name, JobTransition(state=state, reason="why", actor="anna", utc=UTC))
    approval = JobApproval(job_id="job2", plan=JobPlan.of({"job": "x"}), actor="anna", utc=UTC)
    journal.approvals.approve_job(approval, JobTransition(state="queued", reason="ok", actor="anna", utc=UTC))
    journal.store_position(SavedPosition(name="sample", axes={"gantry.x": "1.5 mm"}, actor="anna", utc=UTC))
    alarm = AlarmRecord(
        id="a", kind="disk", subject="s", priority="low", text="t", action="", state="normal", raised_utc=UTC
    )
    journal.alarms.store_changes([AlarmChange(alarm, notify=True)])
    journal.points.begin_upload(DIGEST, AXES, 6, UTC, ())
    journal.points.add_part(DIGEST, 0, POINTS, UTC)
    FileStore(folder / "adapters" / "gantry.json").save(AdapterMemory(epoch=7, offsets={"x": Fraction(2)}))
    FileLatchStore(folder / "estop.json").save(LATCH)
    replace_private_file(folder / FLEET_FILE, b"{}")
    return journal


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["journal", *map(str, words)], prog_name="tutti")


def done(*words: str | Path) -> str:
    result = run(*words)
    assert result.exit_code == 0, (words, result.output)
    return result.output


def read_tables(path: Path) -> dict[str, list[tuple[object, ...]]]:
    """All rows of the tables that an import leaves as they are."""
    db = sqlite3.connect(path)
    names = [name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    found = {name: db.execute(f"SELECT * FROM {name}").fetchall() for name in names if not name.startswith("meta")}
    db.close()
    return found


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A state folder that stays open, with a backup and an export of it beside."""
    root = tmp_path_factory.mktemp("source")
    journal = make_folder(root / "state")
    done("backup", "--state", root / "state", "-o", root / "lab.tar")
    done("export", "--state", root / "state", "-o", root / "lab.jsonl")
    assert stat.S_IMODE((root / "lab.tar").stat().st_mode) == 0o600
    assert stat.S_IMODE((root / "lab.jsonl").stat().st_mode) == 0o600
    assert sorted(each.name for each in root.iterdir()) == ["lab.jsonl", "lab.tar", "state"]
    assert "exists" in run("backup", "--state", root / "state", "-o", root / "lab.tar").output
    journal.close()
    return root


@pytest.mark.parametrize("file", ["lab.tar", "lab.jsonl"])
def test_what_is_imported_is_what_was_there(source: Path, tmp_path: Path, file: str) -> None:
    folder = tmp_path / "state"
    if file == "lab.jsonl":  # which has no stores: those of the folder count
        FileStore(folder / "adapters" / "gantry.json").save(AdapterMemory(epoch=7))
    shown = json.loads(done("import", source / file, "--state", folder, "--json"))
    assert shown["epoch"] == 8 and shown["jobs"] == {"done": 1, "queued": 1, "running": 1} and not shown["damages"]
    for name in (JOURNAL, f"{JOURNAL}-points"):
        assert read_tables(folder / name) == read_tables(source / "state" / name)
        assert stat.S_IMODE((folder / name).stat().st_mode) == 0o600
    if file == "lab.tar":
        assert FileStore(folder / "adapters" / "gantry.json").load().offsets == {"x": 2}
        assert FileLatchStore(folder / "estop.json").load() == LATCH
        assert (folder / FLEET_FILE).read_bytes() == b"{}"
    assert json.loads(done("check", "--state", folder, "--json"))["damages"] == []
    journal = SqliteJournal(folder / JOURNAL)
    assert journal.take_epoch(0) == 9
    stop = journal.load_queue_stop()
    assert stop is not None and file in stop.reason
    assert journal.points.read_rows(DIGEST, 4, 2) == [(4.0,), (5.0,)]
    journal.close()


def test_an_import_keeps_what_is_newer_and_the_journal_of_before(source: Path, tmp_path: Path) -> None:
    folder = tmp_path / "state"
    before = SqliteJournal(folder / JOURNAL)
    for _ in range(20):
        before.take_epoch(0)
    before.close()
    FileStore(folder / "adapters" / "gantry.json").save(AdapterMemory(epoch=20, offsets={"x": Fraction(5)}))
    assert "it has a journal already" in run("import", source / "lab.tar", "--state", folder).output
    lock = StateLock(folder)
    assert "another `tutti up` uses" in run("import", source / "lab.tar", "--state", folder, "--replace").output
    lock.release()
    assert read_stored_epoch(folder / JOURNAL) == 20
    shown = json.loads(done("import", source / "lab.tar", "--state", folder, "--replace", "--json"))
    assert shown["epoch"] == 21 and "adapters/gantry.json" in shown["left_out"]
    assert FileStore(folder / "adapters" / "gantry.json").load().offsets == {"x": 5}
    assert json.loads(done("check", "--state", shown["replaced"], "--json"))["epoch"] == 20
    assert read_stored_epoch(folder / JOURNAL) == 21


@pytest.mark.parametrize("version", [1, 5])
def test_an_export_of_an_older_schema_is_migrated(tmp_path: Path, version: int) -> None:
    old = tmp_path / "old" / JOURNAL
    old.parent.mkdir()
    db = sqlite3.connect(old)
    statements = SCHEMA + "".join(MIGRATIONS[each] for each in range(1, version))
    db.executescript(f"{statements} PRAGMA user_version={version}; INSERT INTO meta VALUES ('epoch', '4');")
    db.execute(
        "INSERT INTO jobs (id, client_key, name, actor, body, state, reason, submitted_utc)"
        " VALUES ('j', 'k', 'scan', 'anna', ?, 'queued', 'why', ?)",
        (JOB.model_dump_json(), UTC),
    )
    db.commit()
    db.close()
    contents = old.read_bytes()
    assert f"schema {version}, which becomes {VERSION}" in done("check", "--state", old.parent)
    done("export", "--state", old.parent, "-o", tmp_path / "old.jsonl")
    assert old.read_bytes() == contents
    assert json.loads((tmp_path / "old.jsonl").read_text().splitlines()[0])["journal_schema"] == version
    shown = json.loads(done("import", tmp_path / "old.jsonl", "--state", tmp_path / "new", "--json"))
    assert shown["epoch"] == 5 and shown["jobs"] == {"queued": 1}
    assert check_journal(tmp_path / "new" / JOURNAL).schema == VERSION


def change_line(text: str, number: int, new: str) -> str:
    lines = text.splitlines(keepends=True)
    lines[number] = new + "\n"
    return "".join(lines)


def remove_checksums(text: str) -> str:
    """An export as earlier versions wrote it."""
    lines = [{key: value for key, value in json.loads(line).items() if key != "sum"} for line in text.splitlines()]
    lines[0]["schema"] = "tutti.journal-export/1"
    return "".join(f"{json.dumps(line)}\n" for line in lines)


def test_a_change_of_any_byte_of_an_export_is_refused_with_its_line(source: Path, tmp_path: Path) -> None:
    contents = (source / "lab.jsonl").read_bytes()
    random = Random(1)
    for place in sorted(random.sample(range(len(contents)), 40)):
        changed = bytearray(contents)
        changed[place] ^= 1 << random.randrange(8)
        with pytest.raises(BadBackup) as refused:
            import_journal(io.BytesIO(bytes(changed)), "file", tmp_path / f"{place}.journal")
        assert re.match(r"file:\d+: |file: it ends", str(refused.value)), (place, refused.value)


def test_an_export_without_checksums_is_imported_and_said(source: Path, tmp_path: Path) -> None:
    file = tmp_path / "old.jsonl"
    file.write_text(remove_checksums((source / "lab.jsonl").read_text()))
    refused = run("import", file, "--state", tmp_path / "new", "--require-checksum")
    assert refused.exit_code == 2 and "wrote no checksums" in refused.output
    assert "a change in it could not be seen" in done("import", file, "--state", tmp_path / "new")
    assert json.loads(done("import", source / "lab.jsonl", "--state", tmp_path / "other", "--json"))["checked"]


def flip_and_look(path: Path, contents: bytes, place: int, bit: int) -> None:
    """A flipped bit is found by the check or by the opening of the journal, or has no effect; it is never an error of
    another kind."""
    changed = bytearray(contents)
    changed[place] ^= 1 << bit
    path.write_bytes(changed)
    with suppress(JournalError):
        check_journal(path)
    with suppress(JournalError):
        journal = SqliteJournal(path)
        try:
            for job in journal.list_unfinished():
                with suppress(JournalError):
                    journal.load_job(job.id)
                with suppress(JournalError):
                    journal.list_transitions(job.id)
            journal.list_positions()
        finally:
            journal.close()
    for other in path.parent.glob(f"{path.name}-*"):
        other.unlink()


def test_a_flipped_bit_of_a_journal_is_found_or_has_no_effect(tmp_path: Path) -> None:
    make_folder(tmp_path / "state").close()
    contents = (tmp_path / "state" / JOURNAL).read_bytes()
    random = Random(2)
    used = [place for place, byte in enumerate(contents) if byte]  # pages are mostly empty
    for place in random.sample(used, 120):
        flip_and_look(tmp_path / "journal", contents, place, random.randrange(8))


@pytest.mark.nightly
def test_each_byte_of_a_journal_is_flipped_in_turn(tmp_path: Path) -> None:
    make_folder(tmp_path / "state").close()
    contents = (tmp_path / "state" / JOURNAL).read_bytes()
    random = Random(3)
    for place, byte in enumerate(contents):
        if byte:
            flip_and_look(tmp_path / "journal", contents, place, random.randrange(8))


def test_what_cannot_be_imported_changes_nothing(source: Path, tmp_path: Path) -> None:
    folder, file = tmp_path / "state", tmp_path / "file"
    folder.mkdir()
    packed, text = (source / "lab.tar").read_bytes(), (source / "lab.jsonl").read_text()
    changed = bytearray(packed)
    changed[len(packed) // 2] ^= 1
    newer = text.replace(f'"journal_schema":{VERSION}', f'"journal_schema":{VERSION + 1}')
    old, lines = remove_checksums(text), text.splitlines(keepends=True)
    cases: list[tuple[bytes, str]] = [
        *((packed[: len(packed) * part // 8], "is cut off") for part in range(1, 8)),
        (packed[:100], "neither a backup nor an export"),
        (b"", "neither a backup nor an export"),
        (b"\x7fELF" * 300, "neither a backup nor an export"),
        (bytes(changed), "is not what was written"),
        (b"{}\n", "file:1: it is no export"),
        (newer.encode(), f"schema {VERSION + 1} is newer"),
        (text[:-20].encode(), "it is no JSON object"),
        (text[: text[:-1].rindex("\n") + 1].encode(), "without its last line"),
        (change_line(text, 3, "nonsense").encode(), "file:4: it is no JSON object"),
        (change_line(text, 3, '{"table": "odd", "row": {}}').encode(), "file:4: it is no record of a table"),
        (change_line(old, 3, '{"table": "meta", "row": {"key": 1}}').encode(), "the column 'value' is missing"),
        (change_line(old, 3, '{"end": 9}').encode(), "it states 9 records, and there are 2"),
        (change_line(text, 3, '{"end": 9}').encode(), "file:4: it is no last line"),
        (text.replace('"state": "queued"', '"state": "done"', 1).encode(), ": its checksum is wrong"),
        ("".join(lines[:4] + lines[5:]).encode(), "file:5: its checksum is wrong"),
        ("".join([*lines[:4], lines[5], lines[4], *lines[6:]]).encode(), "file:5: its checksum is wrong"),
        (text.replace('"tutti":"', '"tutti":"1', 1).encode(), "the checksum of all lines is wrong"),
        (text.replace("export/2", "export/1", 1).encode(), "file:2: it is no record"),
        ((text + lines[-1]).encode(), "lines behind the last one"),
    ]
    for contents, expected in cases:
        file.write_bytes(contents)
        result = run("import", file, "--state", folder)
        assert result.exit_code == 2 and expected in result.output and str(file) in result.output, result.output
        assert [each.name for each in folder.iterdir()] == ["lock"], expected
    assert "it is a folder" in run("import", folder, "--state", folder).output


def test_a_backup_with_a_path_out_of_the_folder_is_refused(source: Path, tmp_path: Path) -> None:
    for name in ("../escaped.json", "adapters/../../escaped.json", "other.json"):
        with tarfile.open(source / "lab.tar") as old, tarfile.open(tmp_path / "evil.tar", "w") as new:
            for entry in old:
                data = old.extractfile(entry)
                new.addfile(entry, data)
            new.addfile(tarfile.TarInfo(name))
        result = run("import", tmp_path / "evil.tar", "--state", tmp_path / "state")
        assert result.exit_code == 2 and "does not belong into a backup" in result.output
    assert sorted(each.name for each in tmp_path.iterdir()) == ["evil.tar", "state"]


def test_the_check_finds_every_damage(tmp_path: Path) -> None:
    journal = make_folder(tmp_path)
    for statement in (
        "UPDATE jobs SET actor = 'bert' WHERE id = 'job0'",
        "UPDATE jobs SET state = 'odd' WHERE id = 'job1'",
        "UPDATE positions SET body = replace(body, '1.5', '2.5')",
        "UPDATE approvals SET crc = 1",
        "UPDATE alarm_history SET body = '{'",
        "UPDATE alarm_notices SET crc = 2",
        "UPDATE transitions SET state = 'odd' WHERE state = 'done'",
        "UPDATE meta_copies SET value = '77' WHERE key = 'epoch'",
        "INSERT INTO reports VALUES ('job0', '{}')",
        "INSERT INTO point_rows VALUES ('job0', 1, 2, 'done', '', 0, 0, 0, 0, '[', '{}', NULL)",
    ):
        journal.database.write(statement)
    journal.close()
    points = sqlite3.connect(tmp_path / f"{JOURNAL}-points")
    points.execute("UPDATE parts SET crc = 3")
    points.commit()
    points.close()
    result = run("check", "--state", tmp_path, "--json")
    assert result.exit_code == 1
    found = json.loads(result.output)
    assert found["epoch"] == 3
    places = [each["place"].split()[0] for each in found["damages"]]
    names = ["alarm_history", "alarm_notices", "approvals", "jobs", "jobs", "meta", "point_rows", "points", "positions"]
    assert sorted(places) == [*names, "reports", "transitions"]
    assert all(each["remedy"] for each in found["damages"])
    path = tmp_path / JOURNAL
    contents = bytearray(path.read_bytes())
    contents[4096 * 3 : 4096 * 3 + 64] = bytes(64)
    path.write_bytes(contents)
    assert run("check", "--state", tmp_path).exit_code == 1
    path.write_bytes(b"no database" * 1000)
    assert "file is not a database" in run("check", "--state", tmp_path).output
    assert run("check", "--state", tmp_path / "none").exit_code == 2
