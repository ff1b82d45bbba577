"""The export of a journal in a file, and the import of an export into a new one."""

import hashlib
import json
import sqlite3
from base64 import b64decode
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, BinaryIO, cast

from pydantic import ValidationError

from orchestrator.coordinator.journal.records import BadBackup
from orchestrator.coordinator.journal.sql.database import make_insert
from orchestrator.coordinator.journal.sql.export import POINTS, ExportHeader, ExportPart, export_parts, sum_record
from orchestrator.coordinator.journal.sql.values import StoredValues
from orchestrator.coordinator.journal.sqlite.database import (
    DATABASE_ERRORS,
    SqliteDatabase,
    connect_database,
    create_private_file,
    make_unusable_error,
    open_read_only,
)
from orchestrator.coordinator.journal.sqlite.points import find_points, open_points
from orchestrator.coordinator.journal.sqlite.schema import SCHEMA_WITH_COPIES, VERSION, list_statements, read_version
from orchestrator.model.messages import MAX_EPOCH

MAX_LINE = 16_000_000  # bytes; a part of points has a million
UNSEALED = "tutti.journal-export/1"  # the form of earlier versions, without checksums


def export_journal(path: Path, tutti: str, utc: str, write: Callable[[str], object]) -> int:
    """Write a journal, and the points beside it, line by line; return how many records. Raises `JournalError`."""
    try:
        with ExitStack() as stack:
            db = stack.enter_context(open_read_only(path))
            db.connection.execute("BEGIN")  # all records as they are at one instant
            header = ExportHeader(journal_schema=read_version(db.connection, str(path)), tutti=tutti, utc=utc)
            parts = [ExportPart("", db, db.list_columns())]
            points = find_points(path)
            if points.exists():
                point_db = stack.enter_context(open_read_only(points))
                # Read later: a job comes after the points that it names.
                point_db.connection.execute("BEGIN")
                parts.append(ExportPart(POINTS, point_db, point_db.list_columns()))
            return export_parts(header, parts, write)
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(path), error) from None


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
    points = find_points(path)
    create_private_file(path)
    open_points(str(points)).close()
    with closing(_open(path)) as db, closing(_open(points)) as point_db:
        db.connection.executescript(f"BEGIN; {list_statements(0, version)} PRAGMA user_version={version}; COMMIT;")
        for database in (db, point_db):
            database.connection.execute("BEGIN")
        writers = _find_writers(db, ""), _find_writers(point_db, POINTS)
        _insert_records(lines, {**writers[0], **writers[1]}, sealed=header.schema_ != UNSEALED)
        for database in (db, point_db):
            database.connection.execute("COMMIT")
    return header.schema_ != UNSEALED


class _RowWriter:
    """Puts rows into one table."""

    def __init__(self, db: sqlite3.Connection, table: str, columns: list[str]) -> None:
        self._db = db
        self._columns = columns
        self._insert = make_insert(table, columns)

    def write_row(self, row: Mapping[str, Any]) -> None:
        """Raises `ValueError`, `sqlite3.Error`, `OverflowError`."""
        odd = sorted(row.keys() ^ set(self._columns))
        if odd:
            raise ValueError(f"the column {odd[0]!r} is {'not known' if odd[0] in row else 'missing'}")
        self._db.execute(self._insert, [_decode(row[column]) for column in self._columns])


def _find_writers(db: SqliteDatabase, prefix: str) -> dict[str, _RowWriter]:
    return {prefix + table: _RowWriter(db.connection, table, columns) for table, columns in db.list_columns().items()}


def _open(path: Path) -> SqliteDatabase:
    return SqliteDatabase(connect_database(path), str(path))


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
        if sealed and record["sum"] != sum_record(lines.number, record["table"], row):
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
        with open_read_only(path) as db:
            if read_version(db.connection, str(path)) >= SCHEMA_WITH_COPIES:
                text = StoredValues(db).read("epoch", "0")
            else:
                rows = db.select("SELECT value FROM meta WHERE key = 'epoch'")
                text = rows[0][0] if rows else "0"
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(path), error) from None
    return int(text) if text.isdecimal() and int(text) <= MAX_EPOCH else 0
