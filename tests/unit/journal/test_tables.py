"""Each table of the journal keeps what is put into it, in its order, and its newest rows."""

from pathlib import Path

import pytest
from unit.journal.engines import Engine, OpenJournal
from unit.journal.test_journal import JOB, end, utc

from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sql import command_table, job_changes
from orchestrator.coordinator.journal.sql.tables import POINTS, RECORD_SCHEMA, RECORDS
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.points import open_points
from orchestrator.coordinator.journal.sqlite.schema import VERSION
from orchestrator.model.operation.commands import CommandRecord
from orchestrator.model.positions.entries import SavedPosition
from orchestrator.model.report import JobTransition, PointRecord, PointWindow, SkewInterval, StepRecording, TimeInterval

TIMES = TimeInterval(earliest_ns=1, latest_ns=2)


def make_command(number: int, actor: str = "anna") -> CommandRecord:
    utc_text = f"2026-01-01T00:00:{number:02}.000000Z"
    return CommandRecord(utc=utc_text, actor=actor, verb="stop", subject=str(number), refused="")


def test_of_the_commands_the_newest_are_kept_and_found(journal: OpenJournal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_table, "MAX_COMMANDS", 4)
    for number in range(6):
        journal.commands.store_command(make_command(number, "anna@192.0.2.1" if number % 2 else "ben%_"))
    assert [each.subject for each in journal.commands.list_commands(10)] == ["5", "4", "3", "2"]
    assert [each.subject for each in journal.commands.list_commands(10, by="anna")] == ["5", "3"]
    assert [each.subject for each in journal.commands.list_commands(10, by="%_")] == ["4", "2"]
    assert [each.subject for each in journal.commands.list_commands(1, make_command(4).utc, "anna")] == ["3"]
    assert journal.database.select("SELECT count(*) FROM commands") == [(4,)]


def test_of_the_recordings_those_of_the_newest_jobs_and_steps_are_kept(
    journal: OpenJournal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job_changes, "MAX_RECORDED_JOBS", 2)
    monkeypatch.setattr(job_changes, "MAX_RECORDED_STEPS", 3)
    for name in "abc":
        journal.accept_job(name, name, JOB, utc(1))
        for step in range(5):
            journal.store_recording(name, StepRecording(name="m", step=step, t0_fleet_ns=1, axes={}))
    journal.store_recording("c", StepRecording(name="m", step=4, t0_fleet_ns=2, axes={}))
    kept = {(name, step) for name in "abc" for step in range(5) if journal.load_recording(name, step) is not None}
    assert kept == {(name, step) for name in "bc" for step in (2, 3, 4)}
    last = journal.load_recording("c", 4)
    assert last is not None and last.t0_fleet_ns == 2


def test_rows_of_points_are_replaced_and_read_in_parts(journal: OpenJournal) -> None:
    points = [
        PointRecord(
            step=step,
            point=point,
            state="done",
            verdict="green",
            t0_fleet_ns=2**52,
            start_skew=SkewInterval(at_least_ns=-1, at_most_ns=5) if point else None,
            took_s=0.1,
            target={"a.x": 0.1},
            measured={"a.x": None},
            good=point == 1,
            window=PointWindow(lower=TIMES, middle=TIMES, upper=TIMES) if point == 2 else None,
        )
        for step in (0, 1)
        for point in (0, 1, 2)
    ]
    journal.point_rows.store_points("a", points)
    changed = points[5].model_copy(update={"state": "failed"})
    journal.point_rows.store_points("a", [changed])
    assert journal.point_rows.load_points("a", (0, 1), 2) == points[2:4]
    assert journal.point_rows.load_points("a", (1, 1), 9) == [changed]
    assert journal.point_rows.load_points("b", (-1, 0), 9) == []


def test_reservations_and_positions(journal: OpenJournal) -> None:
    for holder in ("z", "a"):
        journal.store_reservation(holder, "anna", "oil", ["g.x", "g.y"], utc(3))
    assert [each.holder for each in journal.list_reservations()] == ["z", "a"]
    journal.store_reservation("a", "ben", "oil", [], utc(4))
    journal.delete_reservation("z")
    assert [(each.actor, each.axes) for each in journal.list_reservations()] == [("ben", ())]
    position = SavedPosition.model_validate(
        {"name": "a-park", "axes": {"g.x": "12 mm"}, "actor": "anna", "utc": utc(1)}
    )
    journal.store_position(position.model_copy(update={"name": "a_park"}))
    journal.store_position(position)
    assert [each.name for each in journal.list_positions()[0]] == ["a-park", "a_park"]  # by code points
    journal.database.write("UPDATE positions SET crc = 1 WHERE name = 'a_park'")
    assert journal.list_positions() == ([position], ["a_park"])
    journal.delete_position("a_park")
    assert journal.list_positions() == ([position], [])


def test_jobs_before_another_one_and_by_reference(journal: OpenJournal) -> None:
    for name in ("a1", "a2", "b1"):
        journal.accept_job(name, name, JOB.model_copy(update={"name": name.upper()}), utc(1))
    assert [each.id for each in journal.find_jobs(9, before_id="b1")[0]] == ["a2", "a1"]
    assert [each.id for each in journal.find_referenced_jobs("a")] == ["a2", "a1"]
    assert [each.id for each in journal.find_referenced_jobs("B1")] == ["b1"]
    assert [each.id for each in journal.find_referenced_jobs("a1")] == ["a1"]
    assert journal.find_referenced_jobs("A") == []


def test_many_jobs_are_deleted_in_parts(journal: OpenJournal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_changes, "_DELETED_AT_ONCE", 2)
    for number in range(5):
        journal.accept_job(str(number), str(number), JOB, utc(1))
        end(journal, str(number))
    assert journal.prune_jobs(utc(2), 0) == 5
    assert journal.find_jobs(9) == ([], 0)
    assert journal.database.select("SELECT count(*) FROM transitions") == [(0,)]


def test_a_transition_of_a_job_that_is_not_there_is_refused(journal: OpenJournal) -> None:
    with pytest.raises(JournalError):
        journal.record_transition("x", JobTransition(state="running", reason="", actor="a", utc=utc(1)))
    assert journal.list_transitions("x") == []
    journal.accept_job("x", "x", JOB, utc(1))


def test_the_tables_are_those_that_are_listed(journal: OpenJournal, engine: Engine) -> None:
    for db, tables in ((journal.database, RECORDS), (engine.open_points(), POINTS)):
        for table, columns in tables.items():
            assert db.select(f"SELECT {', '.join(columns)} FROM {table}") == []


def test_a_new_file_has_these_tables_and_columns_in_this_order(tmp_path: Path) -> None:
    listed = SqliteJournal(tmp_path / "journal.db").database.list_columns()
    assert {table: set(columns) for table, columns in listed.items()} == {
        table: set(columns) for table, columns in RECORDS.items()
    }
    assert VERSION == RECORD_SCHEMA
    assert open_points(":memory:").list_columns() == {table: list(columns) for table, columns in POINTS.items()}
