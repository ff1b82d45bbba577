"""`tutti journal` on a database: what comes out of one engine goes into the other."""

import json
import stat
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

pytest.importorskip("psycopg")
from unit.journal.servers import PostgresServer
from unit.runtime.test_state_backup import DIGEST, make_folder

from adapters.controller.state.store import AdapterMemory, FileStore
from orchestrator.cli.main import main
from orchestrator.coordinator.journal.postgres.journal import PostgresJournal
from orchestrator.coordinator.journal.postgres.opening import open_journal
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.runtime.state.folder import JOURNAL

pytestmark = pytest.mark.postgres


def run(*words: object) -> Result:
    return CliRunner().invoke(main, ["journal", *map(str, words)], prog_name="tutti")


def done(*words: object) -> str:
    result = run(*words)
    assert result.exit_code == 0, (words, result.output)
    return result.output


class Desk:
    """A state folder with a journal, and a database of its own beside it."""

    def __init__(self, server: PostgresServer, number: int, folder: Path, stack: ExitStack) -> None:
        self.server = server
        self.database = f"commands{number}"
        server.execute(f"CREATE DATABASE {self.database}")
        self.address = server.make_address(self.database)
        self.folder = folder / "state"
        make_folder(self.folder).close()
        self.place = ("--journal", self.address, "--fleet", "lab")
        self._stack = stack

    def fill(self) -> None:
        export = self.folder.parent / "lab.jsonl"
        done("export", "--state", self.folder, "-o", export)
        done("import", export, *self.place)

    def open(self, fleet: str = "lab") -> PostgresJournal:
        return self._stack.enter_context(closing(open_journal(self.address, fleet)))

    def execute(self, statement: str) -> list[tuple[object, ...]]:
        return self.server.execute(statement, self.database)


@pytest.fixture
def desk(server: PostgresServer, number: int, tmp_path: Path) -> Iterator[Desk]:
    with ExitStack() as stack:
        yield Desk(server, number, tmp_path, stack)


def read_records(path: Path) -> list[object]:
    """The records of an export, without what each import writes anew."""
    rows = [json.loads(line) for line in path.read_text().splitlines()[1:-1]]
    return [(row["table"], row["row"]) for row in rows if not row["table"].startswith("meta")]


@pytest.mark.parametrize("file", ["lab.tar", "lab.jsonl"])
def test_what_comes_out_of_a_file_goes_into_a_database_and_back(desk: Desk, tmp_path: Path, file: str) -> None:
    verb = "backup" if file == "lab.tar" else "export"
    done(verb, "--state", desk.folder, "-o", tmp_path / file)
    shown = json.loads(done("import", tmp_path / file, *desk.place, "--state", tmp_path / "other", "--json"))
    # A backup has the stores of adapters, which have seen 7; the export has none.
    assert shown["epoch"] == (8 if file == "lab.tar" else 4)
    assert shown["jobs"] == {"done": 1, "queued": 1, "running": 1} and not shown["damages"]
    assert (tmp_path / "other" / "adapters" / "gantry.json").exists() == (file == "lab.tar")
    assert not (tmp_path / "other" / JOURNAL).exists()
    checked = json.loads(done("check", "--journal", desk.address, "--json"))
    assert (checked["damages"], checked["epoch"], checked["schema"]) == ([], shown["epoch"], 1)

    done("export", "--state", desk.folder, "-o", tmp_path / "before.jsonl")
    done("export", *desk.place, "-o", tmp_path / "after.jsonl")
    assert read_records(tmp_path / "after.jsonl") == read_records(tmp_path / "before.jsonl")
    assert stat.S_IMODE((tmp_path / "after.jsonl").stat().st_mode) == 0o600

    done(verb, *desk.place, "-o", tmp_path / f"back-{file}")
    done("import", tmp_path / f"back-{file}", "--state", tmp_path / "back")
    done("export", "--state", tmp_path / "back", "-o", tmp_path / "back.jsonl")
    assert read_records(tmp_path / "back.jsonl") == read_records(tmp_path / "before.jsonl")
    with closing(SqliteJournal(tmp_path / "back" / JOURNAL)) as journal:
        assert journal.points.read_rows(DIGEST, 4, 2) == [(4.0,), (5.0,)]
        assert journal.take_epoch(0) == shown["epoch"] + 2  # each import takes one above


def test_a_journal_that_was_imported_leads_above_every_adapter(desk: Desk, tmp_path: Path) -> None:
    FileStore(tmp_path / "host" / "adapters" / "stage.json").save(AdapterMemory(epoch=30))
    done("export", "--state", desk.folder, "-o", tmp_path / "lab.jsonl")
    shown = json.loads(done("import", tmp_path / "lab.jsonl", *desk.place, "--state", tmp_path / "host", "--json"))
    assert shown["epoch"] == 31
    journal = desk.open()
    stop = journal.load_queue_stop()
    assert stop is not None and "imported from lab.jsonl" in stop.reason
    assert journal.take_epoch(30) == 32
    assert journal.accept_job("new", "new", journal.load_job("job0"), "2026-02-01T00:00:00.000000Z")[1]  # type: ignore[arg-type]
    record = journal.load_record("new")
    assert record is not None and record.place == 4
    assert journal.points.read_rows(DIGEST, 4, 2) == [(4.0,), (5.0,)]


def test_a_journal_that_is_there_is_kept_and_none_is_replaced_under_a_leader(desk: Desk, tmp_path: Path) -> None:
    desk.fill()
    export = tmp_path / "lab.jsonl"
    refused = run("import", export, *desk.place)
    assert refused.exit_code == 1 and "has a journal there already" in refused.output
    journal = desk.open()
    journal.take_epoch(0)
    refused = run("import", export, *desk.place, "--replace")
    assert refused.exit_code == 1 and "a coordinator leads on it (session 'tutti lab 5')" in refused.output
    journal.close()
    shown = json.loads(done("import", export, *desk.place, "--replace", "--json"))
    assert shown["epoch"] == 6  # above the leader's
    (kept,) = desk.execute("SELECT nspname FROM pg_namespace WHERE nspname LIKE 'tutti_lab_%'")
    assert kept == (shown["replaced"],)
    assert desk.execute(f'SELECT epoch FROM "{shown["replaced"]}".leader') == [(5,)]


def test_an_import_that_fails_changes_nothing(desk: Desk, tmp_path: Path) -> None:
    desk.fill()
    before = desk.execute("SELECT * FROM tutti_lab.leader")
    lines = (tmp_path / "lab.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "cut.jsonl").write_text("".join(lines[:-3]))
    refused = run("import", tmp_path / "cut.jsonl", *desk.place, "--replace")
    assert refused.exit_code == 2 and "without its last line" in refused.output
    assert "it is a folder" in run("import", tmp_path, *desk.place).output
    desk.execute("CREATE TABLE tutti_lab.in_the_way (a int); ALTER TABLE tutti_lab.in_the_way SET SCHEMA public")
    desk.execute("CREATE FUNCTION refuse() RETURNS event_trigger LANGUAGE plpgsql AS $$ BEGIN RAISE 'no space'; END $$")
    desk.execute(
        "CREATE EVENT TRIGGER refuse ON ddl_command_start WHEN TAG IN ('CREATE TABLE') EXECUTE FUNCTION refuse()"
    )
    refused = run("import", tmp_path / "lab.jsonl", *desk.place, "--replace")
    assert refused.exit_code == 1 and "no space" in refused.output
    assert desk.execute("SELECT * FROM tutti_lab.leader") == before


def test_the_check_finds_every_damage(desk: Desk) -> None:
    desk.fill()
    for change in (
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
        "UPDATE parts SET crc = 3",
        "UPDATE leader SET epoch = 99",
    ):
        desk.execute(f"SET search_path TO tutti_lab; {change}")
    result = run("check", *desk.place, "--json")
    assert result.exit_code == 1
    places = [each["place"].split()[0] for each in json.loads(result.output)["damages"]]
    names = ["alarm_history", "alarm_notices", "approvals", "jobs", "jobs", "leader", "meta", "point_rows", "points"]
    assert sorted(places) == [*names, "positions", "reports", "transitions"]
    shown = run("check", *desk.place).output
    assert f"{desk.address}, fleet lab: schema 1; epoch 4" in shown and "damaged: leader: " in shown


def test_which_fleet_is_meant_and_what_is_not_there(desk: Desk) -> None:
    empty = run("check", "--journal", desk.address)
    assert empty.exit_code == 2 and "there is no journal of a fleet" in empty.output
    missing = run("check", *desk.place)
    assert missing.exit_code == 1 and "the journal of fleet lab is missing" in missing.output
    desk.open("lab"), desk.open("hall")
    assert "fleet hall" in done("check", "--journal", desk.address, "--fleet", "hall")
    several = run("check", "--journal", desk.address)
    assert several.exit_code == 2 and "several fleets have a journal: hall, lab" in several.output
    assert "the fleet is missing" in run("import", __file__, "--journal", desk.address).output


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("postgresql://tutti:secret@127.0.0.1:1/x?nonsense=1", "it is no address of a PostgreSQL database"),
        ("postgresql://tutti:secret@127.0.0.1:x/x", "it is no address of a PostgreSQL database"),
        ("host=127.0.0.1 dbname=x password=secret", "its scheme or its database is missing"),
        ("postgresql://tutti:secret@127.0.0.1", "its scheme or its database is missing"),
        ("mysql://tutti:secret@127.0.0.1/x", "it is no address of a PostgreSQL database"),
    ],
)
def test_an_address_that_is_none_is_said_so_without_its_password(address: str, shown: str) -> None:
    result = run("check", "--journal", address, "--fleet", "lab")
    assert result.exit_code == 2 and shown in result.output and "secret" not in result.output
    assert "Traceback" not in result.output and "postgresql://USER@HOST" in result.output
