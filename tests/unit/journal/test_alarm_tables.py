"""Alarms in the journal: kept over a reopening, a damaged one left out, the history bounded; statistics that add up."""

import pytest
from unit.journal.engines import Engine, OpenJournal

from orchestrator.coordinator.journal.facts import AlarmChange, AlarmNotice, StatisticsRow
from orchestrator.coordinator.journal.sql import alarm_tables
from orchestrator.model.operation.alarms import AlarmCause, AlarmRecord
from orchestrator.model.operation.transitions import raise_alarm

UTC = "2026-01-01T00:00:00.000000Z"


def record(subject: str, change: str) -> AlarmRecord:
    return raise_alarm(None, AlarmCause("disconnected", subject, "t", "a"), UTC).model_copy(update={"change": change})


def test_alarms_and_notices_are_kept_and_a_damaged_one_is_named(engine: Engine) -> None:
    journal = engine.open()
    one, two = record("gantry", "1-1"), record("stage", "1-2")
    journal.alarms.store_changes([AlarmChange(one, notify=True), AlarmChange(two, notify=True)])
    journal.alarms.store_tries("1-2", 3)
    journal.close()
    journal = engine.open()
    assert journal.alarms.load_alarms() == ([one, two], [])
    assert journal.alarms.load_notices() == [AlarmNotice(one), AlarmNotice(two, 3)]
    journal.alarms.delete_notice("1-1")
    journal.alarms.store_changes([], forgotten=[one.id])
    journal.database.write("UPDATE alarms SET body = replace(body, 'high', 'low')")
    assert journal.alarms.load_alarms() == ([], [two.id])
    assert journal.alarms.load_notices() == [AlarmNotice(two, 3)]
    assert journal.alarms.load_history(10) == [two, one]


def test_of_the_history_the_newest_changes_are_kept(journal: OpenJournal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alarm_tables, "MAX_HISTORY", 3)
    for number in range(5):
        journal.alarms.store_changes([AlarmChange(record("gantry", f"1-{number}"))])
    assert [each.change for each in journal.alarms.load_history(10)] == ["1-4", "1-3", "1-2"]
    assert len(journal.alarms.load_alarms()[0]) == 1


def test_figures_add_up_and_the_worst_is_the_largest(journal: OpenJournal) -> None:
    rows = [StatisticsRow("2026-01-01", "pair", "a+b", figure, 5.0) for figure in ("moves", "worst_ns")]
    journal.statistics.add_rows(rows)
    journal.statistics.add_rows([row._replace(value=2.0) for row in rows])
    journal.statistics.add_rows([rows[0]._replace(day="2026-01-02")])
    assert [(row.day, row.value) for row in journal.statistics.read_rows("2026-01-01")] == [
        ("2026-01-01", 7.0),
        ("2026-01-01", 5.0),
        ("2026-01-02", 5.0),
    ]
    assert len(journal.statistics.read_rows("2026-01-02")) == 1
