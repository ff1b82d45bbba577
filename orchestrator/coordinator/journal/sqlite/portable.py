"""A journal as text, one record a line: written while its coordinator runs, and read into a new journal.

The first line states the schema, the last one how many records there are: text that was cut off is noticed. Bytes,
which only points of scans have, are base64.
"""

import json
import sqlite3
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, BinaryIO, Literal, cast

from pydantic import Field, ValidationError

from orchestrator.coordinator.journal.records import BadBackup
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.point_store import PointStore
from orchestrator.coordinator.journal.sqlite.schema import SCHEMA_WITH_COPIES, VERSION, list_statements, read_version
from orchestrator.coordinator.journal.sqlite.transaction import (
    Transaction,
    create_private_file,
    make_unusable_error,
    open_read_only,
)
from orchestrator.coordinator.journal.sqlite.values import StoredValues
from orchestrator.model.base import Model
from orchestrator.model.messages import MAX_EPOCH

POINTS = "points."  # in front of the tables of the points of scans
MAX_LINE = 16_000_000  # bytes; a part of points has a million


class ExportHeader(Model):
    """The first line of an export. journal_schema: of the journal; tutti: the version that wrote it."""

    schema_: Literal["tutti.journal-export/1"] = Field(default="tutti.journal-export/1", alias="schema")
    journal_schema: int = Field(ge=1)
    tutti: str
    utc: str


def export_journal(path: Path, tutti: str, utc: str, write: Callable[[str], object]) -> int:
    """Write a journal, and the points beside it, line by line; return how many records. Raises `JournalError`."""
    try:
        with closing(open_read_only(path)) as db:
            db.execute("BEGIN")  # all records as they are at one instant
            version = read_version(db, str(path))
            header = ExportHeader(journal_schema=version, tutti=tutti, utc=utc)
            write(header.model_dump_json() + "\n")
            count = _export_tables(db, "", write)
        points = path.with_name(f"{path.name}-points")
        if points.exists():
            with closing(open_read_only(points)) as db:
                db.execute("BEGIN")
                count += _export_tables(db, POINTS, write)
    except sqlite3.Error as error:
        raise make_unusable_error(str(path), error) from None
    write(json.dumps({"end": count}) + "\n")
    return count


def _export_tables(db: sqlite3.Connection, prefix: str, write: Callable[[str], object]) -> int:
    count = 0
    for table, columns in _find_columns(db).items():
        for row in db.execute(f"SELECT {', '.join(columns)} FROM {table}"):
            values = dict(zip(columns, map(_encode, row), strict=True))
            write(json.dumps({"table": prefix + table, "row": values}, ensure_ascii=False) + "\n")
            count += 1
    return count


def _find_columns(db: sqlite3.Connection) -> dict[str, list[str]]:
    """The columns of each table, in the order in which the tables were made: a record comes after those it names."""
    query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%' ORDER BY rowid"
    names = [name for (name,) in db.execute(query)]
    return {name: [row[1] for row in db.execute(f"PRAGMA table_info({name})")] for name in names}


def _encode(value: object) -> object:
    return {"base64": b64encode(value).decode()} if isinstance(value, bytes) else value


def import_journal(source: BinaryIO, name: str, path: Path) -> None:
    """Make a journal, and the points beside it, of an export; both have the schema of the export then.

    name: of the export, for messages. Raises `BadBackup` with the line that is wrong; what was made is of no use then.
    """
    lines = _read_lines(source, name)
    version = _read_header(lines, name)
    points = path.with_name(f"{path.name}-points")
    create_private_file(path)
    PointStore(str(points)).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as db, closing(sqlite3.connect(points)) as point_db:
        db.executescript(f"BEGIN; {list_statements(0, version)} PRAGMA user_version={version}; COMMIT;")
        db.execute("BEGIN")
        writers = _find_writers(db, ""), _find_writers(point_db, POINTS)
        _insert_records(lines, name, {**writers[0], **writers[1]})
        for connection in (db, point_db):
            connection.commit()


class _RowWriter:
    """Puts rows into one table."""

    def __init__(self, db: sqlite3.Connection, table: str, columns: list[str]) -> None:
        self._db = db
        self._columns = columns
        marks = ", ".join("?" * len(columns))
        self._insert = f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({marks})"

    def write_row(self, row: Mapping[str, Any]) -> None:
        """Raises `ValueError`, `sqlite3.Error`, `OverflowError`."""
        odd = sorted(row.keys() ^ set(self._columns))
        if odd:
            raise ValueError(f"the column {odd[0]!r} is {'not known' if odd[0] in row else 'missing'}")
        self._db.execute(self._insert, [_decode(row[column]) for column in self._columns])


def _find_writers(db: sqlite3.Connection, prefix: str) -> dict[str, _RowWriter]:
    return {prefix + table: _RowWriter(db, table, columns) for table, columns in _find_columns(db).items()}


def _decode(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return b64decode(cast("dict[str, str]", value)["base64"], validate=True)


def _insert_records(lines: Iterator[tuple[int, dict[str, Any]]], name: str, writers: dict[str, _RowWriter]) -> None:
    count = 0
    for number, record in lines:
        if record.keys() == {"end"}:
            if record["end"] != count or next(lines, None) is not None:
                raise _bad_line(name, number, f"it states {record['end']} records, and there are {count} before it")
            return
        writer = writers.get(str(record.get("table")))
        row = record.get("row")
        if writer is None or not isinstance(row, dict):
            raise _bad_line(name, number, f"it is no record of a table that is known: {record.get('table')!r}")
        try:
            writer.write_row(row)  # pyright: ignore[reportUnknownArgumentType]
        except (ValueError, TypeError, KeyError, OverflowError, sqlite3.Error) as error:
            raise _bad_line(name, number, f"table {record['table']}: {error}") from None
        count += 1
    raise BadBackup(f"{name}: it ends after {count} records, without its last line", "copy or export it again")


def _read_lines(source: BinaryIO, name: str) -> Iterator[tuple[int, dict[str, Any]]]:
    number = 0
    while line := source.readline(MAX_LINE + 1):
        number += 1
        try:
            plain = json.loads(line) if len(line) <= MAX_LINE else None
        except (ValueError, RecursionError):
            plain = None
        if not isinstance(plain, dict):
            raise _bad_line(name, number, "it is no JSON object")
        yield number, plain


def _read_header(lines: Iterator[tuple[int, dict[str, Any]]], name: str) -> int:
    first = next((line for _, line in lines), None)
    try:
        version = ExportHeader.model_validate(first).journal_schema
    except ValidationError:
        raise BadBackup(
            f"{name}:1: it is no export of a journal", "give a file of `tutti journal export` or `backup`"
        ) from None
    if version > VERSION:
        raise BadBackup(f"{name}:1: schema {version} is newer than this Tutti's {VERSION}", "use a newer Tutti")
    return version


def _bad_line(name: str, number: int, problem: str) -> BadBackup:
    return BadBackup(f"{name}:{number}: {problem}", "export the journal again, or correct the line")


def read_stored_epoch(path: Path) -> int:
    """The epoch of a journal of any schema; 0 if it is damaged, or has none. Raises `JournalError`."""
    try:
        with closing(open_read_only(path)) as db:
            if read_version(db, str(path)) >= SCHEMA_WITH_COPIES:
                text = StoredValues(db).read("epoch", "0")
            else:
                row = db.execute("SELECT value FROM meta WHERE key = 'epoch'").fetchone()
                text = row[0] if row else "0"
    except sqlite3.Error as error:
        raise make_unusable_error(str(path), error) from None
    return int(text) if text.isdecimal() and int(text) <= MAX_EPOCH else 0


def set_epoch(journal: SqliteJournal, epoch: int) -> None:
    """Put an epoch into a journal that no coordinator uses. Raises `JournalError`."""
    with Transaction(journal.database, "the journal"):
        StoredValues(journal.database).write("epoch", str(epoch))
