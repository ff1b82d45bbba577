"""What commands do with a journal in a database: look at it, export it, fill it."""

import re
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager
from typing import NamedTuple

from orchestrator.coordinator.journal.postgres.address import JournalAddress
from orchestrator.coordinator.journal.postgres.database import PostgresDatabase
from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, open_session, require_schema
from orchestrator.coordinator.journal.postgres.names import TOOL, make_leader_pattern, name_schema
from orchestrator.coordinator.journal.postgres.schema import VERSION, list_columns, lock_schema, make_schema
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sql.database import Database
from orchestrator.coordinator.journal.sql.export import POINTS as POINTS_PREFIX
from orchestrator.coordinator.journal.sql.export import ExportHeader, ExportPart, export_parts
from orchestrator.coordinator.journal.sql.inspection import JournalCheck, JournalDamage, check_parts, check_records
from orchestrator.coordinator.journal.sql.tables import POINTS, RECORD_SCHEMA, RECORDS
from orchestrator.coordinator.journal.sql.transfer import copy_tables

LONG_S = 60.0  # of statements that go through all records
_FLEETS = (
    "SELECT nspname FROM pg_namespace WHERE starts_with(nspname, 'tutti_')"
    " AND to_regclass(quote_ident(nspname) || '.journal_schema') IS NOT NULL ORDER BY 1"
)
_LEADERS = "SELECT application_name FROM pg_stat_activity WHERE datname = current_database() AND application_name ~ ?"
_EPOCH_REMEDY = "end the fleet, and bring a backup back: its import gives both the same"


class Filling(NamedTuple):
    """What a journal in a database is filled with. records, points: as SQLite has them. epoch: as they have it. utc: of
    the import. replace: keep a journal that is there under another name."""

    records: Database
    points: Database
    epoch: int
    utc: str
    replace: bool


@contextmanager
def open_database(place: FleetDatabase) -> Generator[PostgresDatabase]:
    """The journal of a fleet, to be read as it was at one instant. Raises `JournalError`, also if there is none."""
    with _open(place) as db:
        require_schema(db, place.fleet)
        with db.snapshot():
            yield db


@contextmanager
def _open(place: FleetDatabase) -> Generator[PostgresDatabase]:
    with closing(PostgresDatabase(open_session(place._replace(deadline_s=LONG_S), TOOL))) as db:
        yield db


def find_fleets(address: JournalAddress) -> list[str]:
    """The fleets that have a journal in a database, a long name shortened. Raises `JournalError`."""
    with _open(FleetDatabase(address, TOOL)) as db:
        return [schema.removeprefix("tutti_") for (schema,) in db.select(_FLEETS)]


def check_database(place: FleetDatabase) -> JournalCheck:
    """Check a journal. Raises `JournalError` if there is none, or one of a newer Tutti."""
    with open_database(place) as db:
        damages = list(check_parts(db))
        check = check_records(db, VERSION, damages)
        ((epoch,),) = db.select("SELECT epoch FROM leader")
        if check.epoch != epoch:
            problem = f"the leader's row has the epoch {epoch}, and the journal {check.epoch}"
            check.damages.append(JournalDamage("leader", problem, _EPOCH_REMEDY))
    return check


def export_database(place: FleetDatabase, tutti: str, utc: str, write: Callable[[str], object]) -> int:
    """Write a journal line by line, as `export_journal` of SQLite does; return how many records. Raises
    `JournalError`."""
    header = ExportHeader(journal_schema=RECORD_SCHEMA, tutti=tutti, utc=utc)
    with open_database(place) as db:
        parts = [ExportPart("", db, RECORDS), ExportPart(POINTS_PREFIX, db, POINTS)]
        return export_parts(header, parts, write)


def read_epoch(place: FleetDatabase) -> int:
    """The epoch of the leader's row; 0 if the fleet has no journal there. Raises `JournalError`."""
    with _open(place) as db:
        if "leader" not in list_columns(db, name_schema(place.fleet)):
            return 0
        ((epoch,),) = db.select("SELECT max(epoch) FROM leader")
        return epoch


def fill_database(place: FleetDatabase, filling: Filling) -> str:
    """Make the journal of a fleet of records, in one transaction; return the schema that keeps the one of before, empty
    if there was none. Raises `JournalError`; nothing has changed then."""
    schema = name_schema(place.fleet)
    with _open(place) as db, db.unfenced():
        lock_schema(db, schema)
        _require_no_leader(db, place.fleet)
        kept_schema = _name_kept_schema(db, schema, filling)
        if kept_schema:
            db.write(f'ALTER SCHEMA "{schema}" RENAME TO "{kept_schema}"')
        make_schema(db, schema)
        copy_tables(filling.records, db, RECORDS)
        copy_tables(filling.points, db, POINTS)
        db.select("SELECT setval(pg_get_serial_sequence('jobs', 'number'), max(number)) FROM jobs")
        db.write("UPDATE leader SET epoch = ?", (filling.epoch,))
    return kept_schema


def _name_kept_schema(db: Database, schema: str, filling: Filling) -> str:
    if not list_columns(db, schema):
        return ""
    if not filling.replace:
        raise JournalError(
            f"{db.name}: this fleet has a journal there already",
            "give another database, or --replace: the present journal is then kept in a schema beside the new one",
        )
    return f"{schema}_{re.sub(r'[^0-9T]', '', filling.utc.partition('.')[0])}"


def _require_no_leader(db: Database, fleet: str) -> None:
    rows = db.select(_LEADERS, (make_leader_pattern(fleet),))
    if rows:
        text = f"{db.name}: a coordinator leads on it (session {rows[0][0]!r})"
        raise JournalError(text, "end the fleet first")
