"""A journal as text, one record a line: written while its coordinator runs, and read into a new journal.

The first line states the schema, the last one how many records there are, and the checksum of all lines before it.
Each record has the checksum of its place, table and row: a change anywhere is refused, with its line. The checksums
find accidents and careless edits; they are no signature. Bytes, which only points of scans have, are base64.
"""

import hashlib
import json
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from pydantic import Field

from orchestrator.coordinator.journal.sql.database import Database
from orchestrator.coordinator.journal.sql.tables import IN_ORDER
from orchestrator.model.base import Model

POINTS = "points."  # in front of the tables of the points of scans


class ExportHeader(Model):
    """The first line of an export. journal_schema: of the journal; tutti: the version that wrote it."""

    schema_: Literal["tutti.journal-export/1", "tutti.journal-export/2"] = Field(
        default="tutti.journal-export/2", alias="schema"
    )
    journal_schema: int = Field(ge=1)
    tutti: str
    utc: str


class ExportPart(NamedTuple):
    """Tables of a database. prefix: in front of their names. columns: of each, in the order of `tables.RECORDS`."""

    prefix: str
    db: Database
    columns: Mapping[str, Sequence[str]]


def export_parts(header: ExportHeader, parts: Sequence[ExportPart], write: Callable[[str], object]) -> int:
    """Write tables line by line; return how many records. The caller keeps them as they are at one instant. Raises
    `JournalError`."""
    seal = _Seal(write)
    seal.write_line(header.model_dump_json())
    count = sum(_export_tables(part, seal) for part in parts)
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
        record = {"table": table, "row": row, "sum": sum_record(self._number + 1, table, row)}
        self.write_line(json.dumps(record, ensure_ascii=False))


def sum_record(number: int, table: str, row: object) -> str:
    """The checksum of a record at its line, so that a line that is missing or elsewhere is found where it happened."""
    return hashlib.sha256(json.dumps([number, table, row], sort_keys=True).encode()).hexdigest()[:16]


def _export_tables(part: ExportPart, seal: _Seal) -> int:
    count = 0
    for table, columns in part.columns.items():
        for row in stream_table(part.db, table, columns):
            values = dict(zip(columns, map(_encode, row), strict=True))
            seal.write_record(part.prefix + table, values)
            count += 1
    return count


def stream_table(db: Database, table: str, columns: Sequence[str]) -> Iterator[Any]:
    """The rows of a table, in their order if they have one. Raises `JournalError`."""
    order = " ORDER BY rowid" if table in IN_ORDER else ""
    return db.stream(f"SELECT {', '.join(columns)} FROM {table}{order}")


def _encode(value: object) -> object:
    return {"base64": b64encode(value).decode()} if isinstance(value, bytes) else value
