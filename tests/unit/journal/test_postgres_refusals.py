"""Databases that are not as they should be: each refusal is one line with a remedy, and loses nothing."""

import re
from collections.abc import Iterator
from contextlib import ExitStack, closing

import pytest

pytest.importorskip("psycopg")
from unit.journal.servers import PostgresServer, find_free_port
from unit.journal.test_journal import JOB, utc

from orchestrator.coordinator.journal.postgres import session
from orchestrator.coordinator.journal.postgres.journal import PostgresJournal
from orchestrator.coordinator.journal.postgres.opening import open_journal
from orchestrator.coordinator.journal.records import JournalError

pytestmark = pytest.mark.postgres


class Desk:
    """A database and a user of its own."""

    def __init__(self, server: PostgresServer, number: int, stack: ExitStack) -> None:
        self.server = server
        self.database, self.user = f"refusals{number}", f"user{number}"
        server.execute(f"CREATE DATABASE {self.database}")
        server.execute(f"CREATE ROLE {self.user} LOGIN")
        server.execute(f"GRANT CREATE ON DATABASE {self.database} TO {self.user}")
        self._stack = stack

    @property
    def address(self) -> str:
        return self.server.make_address(self.database, self.user)

    def open(self, address: str = "") -> PostgresJournal:
        return self._stack.enter_context(closing(open_journal(address or self.address, "lab")))

    def refuse(self, address: str = "") -> str:
        with pytest.raises(JournalError) as caught:
            self.open(address)
        assert caught.value.remedy and "\n" not in str(caught.value) and "secret" not in str(caught.value)
        assert f":{self.server.port}" in caught.value.text or address
        return str(caught.value)

    def execute(self, statement: str) -> list[tuple[object, ...]]:
        return self.server.execute(statement, self.database)


@pytest.fixture
def desk(server: PostgresServer, number: int) -> Iterator[Desk]:
    with ExitStack() as stack:
        yield Desk(server, number, stack)


def test_a_server_that_cannot_be_reached(desk: Desk) -> None:
    shown = desk.refuse(f"postgresql://tutti:secret@127.0.0.1:{find_free_port()}/x")
    assert "the database cannot be reached" in shown and "Connection refused" in shown
    assert "see whether its server runs" in shown
    for host in ("a..b", "x" * 70, "host.invalid"):
        assert "the database cannot be reached" in desk.refuse(f"postgresql://tutti:secret@{host}/x")
    # Of several hosts the one that is there counts.
    several = f"postgresql://{desk.user}@127.0.0.1:{find_free_port()},127.0.0.1:{desk.server.port}/{desk.database}"
    assert desk.open(several).take_epoch(0) == 1


@pytest.mark.parametrize(
    ("prepare", "user", "database", "shown"),
    [
        ("CREATE ROLE locked LOGIN PASSWORD 'right'", "locked:secret", "", "the password is wrong or missing"),
        ("SELECT 1", "none", "", "its user or its database does not exist (role"),
        ("SELECT 1", "", "none", "its user or its database does not exist (database"),
        ("REVOKE CONNECT ON DATABASE {database} FROM PUBLIC", "", "", "its user may not connect (permission denied"),
        ("ALTER ROLE {user} CONNECTION LIMIT 0", "", "", "the server has no connection left"),
        (
            "ALTER ROLE {user} SET default_transaction_read_only = on",
            "",
            "",
            "it takes no writes: a standby, or read-only",
        ),
        ("REVOKE CREATE ON DATABASE {database} FROM {user}", "", "", "its user may not do that"),
    ],
)
def test_a_user_or_a_database_that_is_refused(desk: Desk, prepare: str, user: str, database: str, shown: str) -> None:
    desk.execute(prepare.format(user=desk.user, database=desk.database))
    try:
        assert shown in desk.refuse(desk.server.make_address(database or desk.database, user or desk.user))
    finally:
        desk.execute("DROP ROLE IF EXISTS locked")


def test_another_encoding_and_a_version_that_is_too_old(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.server.execute("CREATE DATABASE latin ENCODING 'LATIN1' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0")
    try:
        shown = desk.refuse(desk.server.make_address("latin"))
        assert "its encoding is LATIN1, and the journal needs UTF8" in shown and "createdb -E UTF8" in shown
    finally:
        desk.server.execute("DROP DATABASE latin WITH (FORCE)")
    monkeypatch.setattr(session, "OLDEST", 99)
    assert re.search(r"PostgreSQL \d+ is too old; use 99 or newer", desk.refuse())


def test_settings_of_the_site_do_not_change_the_journal(desk: Desk) -> None:
    for setting in ("timezone = 'Asia/Tokyo'", "search_path = 'public'", "statement_timeout = 1", "lock_timeout = 1"):
        # By a session of another database: in one of this, the timeouts would count for what follows.
        desk.server.execute(f"ALTER DATABASE {desk.database} SET {setting}")
    desk.server.execute(f"ALTER DATABASE {desk.database} SET synchronous_commit = off")
    journal = desk.open()
    assert journal.accept_job("a", "a", JOB, utc(1)) == ("a", True)
    rows = journal.database.select("SELECT current_setting('timezone'), current_setting('synchronous_commit')")
    assert rows == [("UTC", "local")]
    health = journal.read_health()
    assert health.server_commit == "off" and health.session_commit == "local" and health.mode == "one copy"
    assert [problem.text for problem in health.problems] == [
        "synchronous_commit is off for sessions that set nothing; the journal's own set it"
    ]


def test_the_health_names_what_loses_data(desk: Desk) -> None:
    journal = desk.open()
    health = journal.read_health()
    assert health.problems == () and health.fsync and not health.in_recovery and health.timeline == 1
    assert abs(health.clock_s) < 1 and desk.execute("SHOW server_version") == [(health.version,)]
    desk.server.execute("ALTER SYSTEM SET fsync = off")
    try:
        desk.server.execute("SELECT pg_reload_conf()")
        while journal.read_health().fsync:
            pass
        assert "fsync is off" in journal.read_health().problems[0].text
    finally:
        desk.server.execute("ALTER SYSTEM RESET fsync")
        desk.server.execute("SELECT pg_reload_conf()")


def raise_state(desk: Desk, state: str) -> None:
    """Have the server fail inserts of jobs with an error of this code."""
    desk.execute(
        "CREATE OR REPLACE FUNCTION fail() RETURNS trigger LANGUAGE plpgsql AS"
        f" $$ BEGIN RAISE EXCEPTION 'it fails' USING ERRCODE = '{state}'; END $$;"
        " CREATE OR REPLACE TRIGGER fail BEFORE INSERT ON tutti_lab.jobs FOR EACH ROW EXECUTE FUNCTION fail()"
    )


@pytest.mark.parametrize(
    ("state", "shown"),
    [
        ("53100", "the disk of the database is full (it fails"),
        ("58030", "the disk of the database fails"),
        ("XX001", "the database is damaged"),
        ("40001", "another session was in the way"),
        ("25006", "it takes no writes"),
        ("22023", "the server refuses a setting"),
        ("P0001", "the journal cannot be used"),
    ],
)
def test_what_the_server_refuses_is_named_and_undone(desk: Desk, state: str, shown: str) -> None:
    journal = desk.open()
    journal.accept_job("a", "a", JOB, utc(1))
    raise_state(desk, state)
    for _ in range(2):
        with pytest.raises(JournalError) as caught:
            journal.accept_job("b", "b", JOB, utc(1))
        assert shown in caught.value.text and caught.value.remedy and "\n" not in str(caught.value)
    assert [row.id for row in journal.list_unfinished()] == ["a"]
    desk.execute("DROP TRIGGER fail ON tutti_lab.jobs")
    assert journal.accept_job("b", "b", JOB, utc(1)) == ("b", True)


def test_texts_and_numbers_that_a_database_does_not_take(desk: Desk) -> None:
    journal = desk.open()
    journal.accept_job("a", "a", JOB, utc(1))
    for column, value in (("name", "\ud800"), ("name", "a\0b"), ("place", 2**70), ("place", "x")):
        with pytest.raises(JournalError, match="a value cannot be stored"):
            journal.database.write(f"UPDATE jobs SET {column} = ? WHERE id = ?", (value, "a"))
    assert journal.load_job("a") == JOB
