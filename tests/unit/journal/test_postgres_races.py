"""Two coordinators race for one database, statement by statement: what a leader of before writes is never stored."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from random import Random

import pytest

pytest.importorskip("psycopg")
import psycopg
from unit.journal.races import Race
from unit.journal.servers import PostgresServer

from orchestrator.coordinator.journal.postgres.address import read_address
from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, PostgresJournal
from orchestrator.coordinator.journal.postgres.names import name_schema
from orchestrator.coordinator.journal.postgres.session import Session, Statement
from orchestrator.coordinator.journal.postgres.transaction import Fence

pytestmark = pytest.mark.postgres

# The newest decision at each take-over, by the database itself, in the transaction that changes the leader's row.
NOTES = """
SET search_path TO "{schema}";
CREATE TABLE takeovers (epoch bigint, newest bigint);
CREATE FUNCTION note() RETURNS trigger LANGUAGE plpgsql AS
  $$ BEGIN INSERT INTO takeovers SELECT NEW.epoch, coalesce(max(rowid), 0) FROM decisions; RETURN NEW; END $$;
CREATE TRIGGER note AFTER UPDATE ON leader FOR EACH ROW EXECUTE FUNCTION note();
"""
LATE = """
SELECT count(*) FROM "{schema}".decisions AS written
WHERE EXISTS (SELECT 1 FROM "{schema}".takeovers AS taken
  WHERE taken.epoch > written.epoch AND written.rowid > taken.newest)
"""


class Track:
    """Two coordinators of a fleet of its own, and what the database has noted of them."""

    def __init__(self, server: PostgresServer, fleet: str, stack: ExitStack) -> None:
        place = FleetDatabase(read_address(server.make_address("journal")), fleet, deadline_s=0.5)
        journals = [stack.enter_context(closing(PostgresJournal(place))) for _ in range(2)]
        for journal in journals:
            journal.take_epoch(0)
        self._schema = name_schema(fleet)
        self._watcher = stack.enter_context(psycopg.connect(server.make_address("journal"), autocommit=True))
        self._watcher.execute(NOTES.format(schema=self._schema).encode())
        self._watcher.execute(b"SET search_path TO DEFAULT")
        self.race = Race(journals, self._is_blocked)

    def _is_blocked(self, process: int) -> bool:
        query = b"SELECT 1 FROM pg_stat_activity WHERE pid = %s AND wait_event_type = 'Lock'"
        return self._watcher.execute(query, (process,)).fetchone() is not None

    def count(self, query: str) -> int:
        row = self._watcher.execute(query.format(schema=self._schema).encode()).fetchone()
        assert row is not None
        return int(row[0])


@pytest.fixture
def track(server: PostgresServer, number: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Track]:
    with ExitStack() as stack:
        track = Track(server, f"race{number}", stack)
        monkeypatch.setattr(Session, "_run", lambda *values: track.race.send(*values))
        yield track


@pytest.mark.parametrize("rounds", [150, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_no_write_of_a_leader_of_before_is_stored(track: Track, rounds: int) -> None:
    draw = Random(60)
    for _ in range(rounds):
        track.race.run_round(draw)
    assert track.count(LATE) == 0
    assert track.count('SELECT count(*) FROM "{schema}".decisions') > rounds // 2
    assert track.race.refused > rounds // 3 and track.count('SELECT count(*) FROM "{schema}".takeovers') > rounds // 2


def hold_nothing(epoch: int) -> Fence:
    return Fence(Statement("SELECT epoch, false FROM leader"), epoch)


def hold_unlocked(epoch: int) -> Fence:
    return Fence(Statement("SELECT epoch, false FROM leader WHERE epoch = ?", (epoch,)), epoch)


@pytest.mark.parametrize("hold", [hold_nothing, hold_unlocked])
def test_the_races_find_a_write_that_holds_no_epoch(
    track: Track, monkeypatch: pytest.MonkeyPatch, hold: object
) -> None:
    monkeypatch.setattr(Fence, "hold", hold)
    draw = Random(60)
    for _ in range(100):
        track.race.run_round(draw)
        if track.count(LATE):
            return
    raise AssertionError("no late write was found")
