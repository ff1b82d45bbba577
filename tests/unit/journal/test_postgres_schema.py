"""The schema of PostgreSQL: journals of every version are opened, and a schema that is none is refused."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

pytest.importorskip("psycopg")
from unit.journal.servers import PostgresServer
from unit.journal.test_journal import JOB, utc

from orchestrator.coordinator.journal.facts import QueueEntryOptions
from orchestrator.coordinator.journal.postgres.journal import PostgresJournal
from orchestrator.coordinator.journal.postgres.opening import open_journal
from orchestrator.coordinator.journal.postgres.schema import MIGRATIONS, SCHEMA, VERSION
from orchestrator.coordinator.journal.records import JournalError

pytestmark = pytest.mark.postgres
FIRST = (Path(__file__).parent / "postgres_schema_1.sql").read_text(encoding="utf-8").partition("\n")[2]
LAYOUT = """
SELECT table_name, column_name, data_type, collation_name, is_nullable, column_default, is_identity, identity_generation
FROM information_schema.columns WHERE table_schema = '{schema}'
UNION ALL SELECT tablename, replace(indexdef, '{schema}.', ''), '', '', '', '', '', ''
FROM pg_indexes WHERE schemaname = '{schema}'
UNION ALL SELECT conrelid::regclass::text, replace(pg_get_constraintdef(oid), '{schema}.', ''), '', '', '', '', '', ''
FROM pg_constraint WHERE connamespace = '{schema}'::regnamespace ORDER BY 1, 2
"""


class Desk:
    def __init__(self, server: PostgresServer, number: int, stack: ExitStack) -> None:
        self.server = server
        self.fleet = f"schema{number}"
        self.schema = f"tutti_{self.fleet}"
        self._stack = stack

    def open(self, fleet: str = "", *, is_new: bool = True) -> PostgresJournal:
        address = self.server.make_address("journal")
        return self._stack.enter_context(closing(open_journal(address, fleet or self.fleet, is_new=is_new)))

    def execute(self, statement: str) -> list[tuple[object, ...]]:
        return self.server.execute(f'SET search_path TO "{self.schema}"; {statement}', "journal")

    def read_layout(self, schema: str) -> list[list[str]]:
        rows = self.server.execute(LAYOUT.format(schema=schema), "journal")
        return [[str(value).replace(f"{schema}.", "") for value in row] for row in rows]

    def refuse(self) -> JournalError:
        with pytest.raises(JournalError) as caught:
            self.open()
        assert caught.value.remedy and "\n" not in str(caught.value)
        return caught.value


@pytest.fixture
def desk(server: PostgresServer, number: int) -> Iterator[Desk]:
    with ExitStack() as stack:
        yield Desk(server, number, stack)


def test_the_first_schema_is_as_it_was_released() -> None:
    assert SCHEMA.removeprefix("\n") == FIRST
    assert sorted(MIGRATIONS) == list(range(1, VERSION))


@pytest.mark.parametrize("version", range(1, VERSION + 1))
def test_a_journal_of_each_version_is_opened_and_led_to_this_one(desk: Desk, version: int) -> None:
    steps = FIRST + "".join(MIGRATIONS[number] for number in range(1, version))
    desk.execute(f"CREATE SCHEMA {desk.schema}; {steps} INSERT INTO journal_schema VALUES ({version})")
    for number, state in enumerate(("done", "queued", "running"), 1):
        columns = "id, client_key, name, actor, body, state, reason, submitted_utc, place"
        body = JOB.model_dump_json().replace("'", "''")
        values = (
            f"'j{number}', E'anna\\nk{number}', 'scan', 'anna', '{body}', '{state}', 'why', '{utc(number)}', {number}"
        )
        desk.execute(f"INSERT INTO jobs ({columns}) VALUES ({values})")
    journal = desk.open()
    assert [(row.id, row.place) for row in journal.list_unfinished()] == [("j2", 2), ("j3", 3)]
    assert journal.accept_job("x", "k1", JOB, utc(4), QueueEntryOptions(key_owner="anna")) == ("j1", False)
    assert journal.accept_job("j4", "k4", JOB, utc(4)) == ("j4", True)
    assert desk.execute("SELECT version FROM journal_schema") == [(VERSION,)]
    fresh = f"{desk.fleet}fresh"
    desk.open(fresh)
    assert desk.read_layout(desk.schema) == desk.read_layout(f"tutti_{fresh}")


def test_sessions_that_begin_at_once_make_one_schema(desk: Desk) -> None:
    first, second = desk.open(), desk.open()
    first.accept_job("a", "a", JOB, utc(1))
    assert second.load_job("a") == JOB
    assert desk.execute("SELECT count(*) FROM journal_schema") == [(1,)]


def test_a_journal_that_is_missing_is_not_begun_where_it_has_to_be_there(desk: Desk) -> None:
    with pytest.raises(JournalError, match=f"the journal of fleet {desk.fleet} is missing"):
        desk.open(is_new=False)
    desk.open().close()
    desk.open(is_new=False)


def test_a_schema_that_is_newer_or_no_journal_is_not_touched(desk: Desk) -> None:
    desk.open().close()
    desk.execute(f"UPDATE journal_schema SET version = {VERSION + 1}")
    assert f"schema {VERSION + 1} is newer than this Tutti's {VERSION}" in str(desk.refuse())
    desk.execute("DROP TABLE journal_schema")
    assert f"the schema {desk.schema} is not a journal of Tutti" in str(desk.refuse())


@pytest.mark.parametrize(
    ("change", "shown"),
    [
        ("ALTER TABLE jobs DROP COLUMN place", "the column place of {schema}.jobs is missing: it was changed by hand"),
        ("ALTER TABLE learned RENAME TO learnt", "the table of {schema}.learned is missing: it was changed by hand"),
    ],
)
def test_a_table_that_was_changed_by_hand_is_named(desk: Desk, change: str, shown: str) -> None:
    desk.open().close()
    desk.execute(change)
    assert shown.format(schema=desk.schema) in str(desk.refuse())


def test_a_table_that_is_changed_while_it_is_in_use_is_named(desk: Desk) -> None:
    journal = desk.open()
    desk.execute("ALTER TABLE positions DROP COLUMN crc")
    with pytest.raises(JournalError, match="a column is missing: a table was changed by hand"):
        journal.list_positions()
    desk.execute("DROP TABLE positions")
    with pytest.raises(JournalError, match="a table is missing: the schema was changed by hand"):
        journal.list_positions()
    assert journal.accept_job("a", "a", JOB, utc(1)) == ("a", True)
