"""A journal as text, one record a line: written while its coordinator runs, and read into a new journal.

The first line states the schema, the last one how many records there are, and the checksum of all lines before it.
Each record has the checksum of its place, table and row: a change anywhere is refused, with its line. The checksums
find accidents and careless edits; they are no signature. Bytes, which only points of scans have, are base64.
"""

import hashlib
import json
import sqlite3
from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, BinaryIO, Literal, cast

from pydantic import Field, ValidationError

from orchestrator.coordinator.journal.records import BadBackup
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.point_store import PointStore
from orchestrator.coordinator.journal.sqlite.schema import SCHEMA_WITH_COPIES, VERSION, list_statements, read_version
from orchestrator.coordinator.journal.sqlite.transaction import (
    DATABASE_ERRORS,
    Transaction,
    connect_database,
    create_private_file,
    make_unusable_error,
    open_read_only,
)
from orchestrator.coordinator.journal.sqlite.values import StoredValues
from orchestrator.model.base import Model
from orchestrator.model.messages import MAX_EPOCH

POINTS = "points."  # in front of the tables of the points of scans
MAX_LINE = 16_000_000  # bytes; a part of points has a million


UNSEALED = "tutti.journal-export/1"  # the form of earlier versions, without checksums


class ExportHeader(Model):
    """The first line of an export. journal_schema: of the journal; tutti: the version that wrote it."""

    schema_: Literal["tutti.journal-export/1", "tutti.journal-export/2"] = Field(
        default="tutti.journal-export/2", alias="schema"
    )
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
            seal = _Seal(write)
            seal.write_line(header.model_dump_json())
            count = _export_tables(db, "", seal)
        points = path.with_name(f"{path.name}-points")
        if points.exists():
            with closing(open_read_only(points)) as db:
                db.execute("BEGIN")
                count += _export_tables(db, POINTS, seal)
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(path), error) from None
    write(json.dumps({"end": count, "sum": seal.digest.hexdigest()}) + "\n")
    return count


class _Seal:
    """Writes lines, and keeps the checksum of all of them."""

    def __init__(self, write: Callable[[str], object]) -> None:
        self.digest = hashlib.sha256()
        self._write = write
        self._number = 0

    def write_line(self, line: str) -> None:
        self._number += 1
        self.digest.update(f"{line}\n".encode())
        self._write(f"{line}\n")

    def write_record(self, table: str, row: Mapping[str, object]) -> None:
        record = {"table": table, "row": row, "sum": _sum_record(self._number + 1, table, row)}
        self.write_line(json.dumps(record, ensure_ascii=False))


def _sum_record(number: int, table: str, row: object) -> str:
    """The checksum of a record at its line, so that a line that is missing or elsewhere is found where it happened."""
    return hashlib.sha256(json.dumps([number, table, row], sort_keys=True).encode()).hexdigest()[:16]


def _export_tables(db: sqlite3.Connection, prefix: str, seal: _Seal) -> int:
    count = 0
    for table, columns in _find_columns(db).items():
        for row in db.execute(f"SELECT {', '.join(columns)} FROM {table}"):
            values = dict(zip(columns, map(_encode, row), strict=True))
            seal.write_record(prefix + table, values)
            count += 1
    return count


def _find_columns(db: sqlite3.Connection) -> dict[str, list[str]]:
    """The columns of each table, in the order in which the tables were made: a record comes after those it names."""
    query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%' ORDER BY rowid"
    names = [name for (name,) in db.execute(query)]
    return {name: [row[1] for row in db.execute(f"PRAGMA table_info({name})")] for name in names}


def _encode(value: object) -> object:
    return {"base64": b64encode(value).decode()} if isinstance(value, bytes) else value


def import_journal(source: BinaryIO, name: str, path: Path, *, require_checksum: bool = False) -> bool:
    """Make a journal, and the points beside it, of an export; both have the schema of the export then.

    Returns whether it has checksums: an export of an earlier version has none, and a change in it cannot be seen.
    name: of the export, for messages. require_checksum: refuse one without. Raises `BadBackup` with the line that is
    wrong; what was made is of no use then.
    """
    lines = _ExportLines(source, name)
    header = _read_header(lines, name)
    if header.schema_ == UNSEALED and require_checksum:
        text = f"{name}: it is of Tutti {header.tutti}, which wrote no checksums: a change in it cannot be seen"
        raise BadBackup(text, "import it without --require-checksum, if you know where it was since")
    version = header.journal_schema
    points = path.with_name(f"{path.name}-points")
    create_private_file(path)
    PointStore(str(points)).close()
    with closing(connect_database(path)) as db, closing(sqlite3.connect(points)) as point_db:
        db.executescript(f"BEGIN; {list_statements(0, version)} PRAGMA user_version={version}; COMMIT;")
        db.execute("BEGIN")
        writers = _find_writers(db, ""), _find_writers(point_db, POINTS)
        _insert_records(lines, {**writers[0], **writers[1]}, sealed=header.schema_ != UNSEALED)
        for connection in (db, point_db):
            connection.commit()
    return header.schema_ != UNSEALED


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


class _ExportLines:
    """The lines of an export as JSON objects, with the checksum of all that were read before the last one."""

    def __init__(self, source: BinaryIO, name: str) -> None:
        self.name = name
        self.number = 0
        self.digest = ""
        self._source = source
        self._digest = hashlib.sha256()

    def read_next(self) -> dict[str, Any] | None:
        """The next line; None at the end. Raises `BadBackup`."""
        line = self._source.readline(MAX_LINE + 1)
        if not line:
            return None
        self.number += 1
        self.digest = self._digest.hexdigest()
        self._digest.update(line)
        try:
            plain = json.loads(line) if len(line) <= MAX_LINE else None
        except (ValueError, RecursionError):
            plain = None
        if not isinstance(plain, dict):
            raise self.refuse("it is no JSON object")
        return cast("dict[str, Any]", plain)

    def refuse(self, problem: str) -> BadBackup:
        return BadBackup(f"{self.name}:{self.number}: {problem}", "export the journal again, or use another copy")


def _insert_records(lines: _ExportLines, writers: Mapping[str, _RowWriter], *, sealed: bool) -> None:
    count = 0
    keys = {"table", "row", "sum"} if sealed else {"table", "row"}
    while (record := lines.read_next()) is not None:
        if "end" in record:
            _check_end(lines, record, count, sealed=sealed)
            return
        writer = writers.get(str(record.get("table")))
        row = cast("dict[str, Any] | None", record.get("row"))
        if writer is None or not isinstance(row, dict) or set(record) != keys:
            raise lines.refuse(f"it is no record of a table that is known: {record.get('table')!r}")
        if sealed and record["sum"] != _sum_record(lines.number, record["table"], row):
            raise lines.refuse("its checksum is wrong: it was changed, or a line before it is missing or was added")
        try:
            writer.write_row(row)
        except (ValueError, TypeError, KeyError, OverflowError, sqlite3.Error) as error:
            raise lines.refuse(f"table {record['table']}: {error}") from None
        count += 1
    raise BadBackup(f"{lines.name}: it ends after {count} records, without its last line", "copy or export it again")


def _check_end(lines: _ExportLines, record: Mapping[str, Any], count: int, *, sealed: bool) -> None:
    """Check the last line. Raises `BadBackup`."""
    digest = lines.digest
    if set(record) != ({"end", "sum"} if sealed else {"end"}):
        raise lines.refuse("it is no last line of an export")
    if record["end"] != count:
        raise lines.refuse(f"it states {record['end']} records, and there are {count} before it")
    if sealed and record["sum"] != digest:
        raise lines.refuse("the checksum of all lines is wrong: one of them was changed")
    if lines.read_next() is not None:
        raise lines.refuse("there are lines behind the last one")


def _read_header(lines: _ExportLines, name: str) -> ExportHeader:
    first = lines.read_next()
    try:
        header = ExportHeader.model_validate(first)
    except ValidationError:
        raise BadBackup(
            f"{name}:1: it is no export of a journal that this Tutti reads",
            "give a file of `tutti journal export` or `backup`; one of a newer Tutti needs that",
        ) from None
    if header.journal_schema > VERSION:
        text = f"{name}:1: schema {header.journal_schema} is newer than this Tutti's {VERSION}"
        raise BadBackup(text, "use a newer Tutti")
    return header


def read_stored_epoch(path: Path) -> int:
    """The epoch of a journal of any schema; 0 if it is damaged, or has none. Raises `JournalError`."""
    try:
        with closing(open_read_only(path)) as db:
            if read_version(db, str(path)) >= SCHEMA_WITH_COPIES:
                text = StoredValues(db).read("epoch", "0")
            else:
                row = db.execute("SELECT value FROM meta WHERE key = 'epoch'").fetchone()
                text = row[0] if row else "0"
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(path), error) from None
    return int(text) if text.isdecimal() and int(text) <= MAX_EPOCH else 0


def set_epoch(journal: SqliteJournal, epoch: int) -> None:
    """Put an epoch into a journal that no coordinator uses. Raises `JournalError`."""
    with Transaction(journal.database, "the journal"):
        StoredValues(journal.database).write("epoch", str(epoch))
