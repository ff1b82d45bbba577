"""Points of scans, sent by clients before the jobs that name them.

Points are rows of doubles (little-endian, one an axis, in the axis's unit) behind a line that names axes and units; the
digest is that of both. A double keeps every decimal of 15 digits, so that `0.1` in a table of points is exactly the 0.1
of a job file: the shortest decimal of the double is what is converted to counts.

Each part has a checksum: a bit that has changed on the disk moves nothing.
"""

import hashlib
from collections.abc import Collection, Iterator, Sequence
from datetime import timedelta
from zlib import crc32

import numpy as np
from pydantic import TypeAdapter

from orchestrator.coordinator.journal.facts import UploadState
from orchestrator.coordinator.journal.records import DamagedRecord, JournalError
from orchestrator.coordinator.journal.sql.database import Database, JournalPart, make_insert
from orchestrator.model.errors import Refusal
from orchestrator.model.queue import format_utc, parse_utc
from orchestrator.model.scans.point_summary import ColumnSummary
from orchestrator.model.steps.points import ROW_TYPE, PointAxis, PointColumn, find_row_bytes, make_header

QUOTA_BYTES = 512_000_000  # of all stored points
UNUSED_AFTER = timedelta(hours=1)  # then points that no job names are deleted, also parts of an upload that broke off

_COLUMNS = TypeAdapter(list[PointColumn])
_AXES = TypeAdapter(list[PointAxis])

_INSERT_UPLOAD = make_insert("uploads", ("digest", "header", "size", "received", "columns", "used_utc"))
_INSERT_PART = make_insert("parts", ("digest", "begin", "data", "crc"))


class PointStore(JournalPart):
    """`PointUploads` in a database."""

    def __init__(self, db: Database, quota_bytes: int = QUOTA_BYTES) -> None:
        super().__init__(db)
        self.quota_bytes = quota_bytes

    # Uploads

    def begin_upload(
        self, digest: str, axes: Sequence[PointAxis], count: int, utc: str, named: Collection[str]
    ) -> UploadState:
        known_state = self.find_upload(digest, utc)
        if known_state is not None:
            return known_state
        self.delete_unused(named, utc)
        size = count * find_row_bytes(axes)
        used_bytes = self.used_bytes
        if used_bytes + size > self.quota_bytes:
            raise Refusal(
                "point-store-full",
                f"the points need {_format_size(size)}; {_format_size(used_bytes)} of "
                f"{_format_size(self.quota_bytes)} for points are in use",
                "delete finished jobs, and their points with them: `tutti job prune --older 7d --keep 0`; points that "
                "no job names are deleted after an hour",
            )
        with self._db.transaction(copied=True):
            values = (digest, make_header(axes).decode(), size, 0, None, utc)
            self._db.write(_INSERT_UPLOAD, values)
        return UploadState(0, size, None)

    def find_upload(self, digest: str, utc: str) -> UploadState | None:
        with self._db.transaction():
            self._db.write("UPDATE uploads SET used_utc = ? WHERE digest = ?", (utc, digest))
        return self._read_state(digest)

    def _read_state(self, digest: str) -> UploadState | None:
        rows = self._db.select("SELECT received, size, columns FROM uploads WHERE digest = ?", (digest,))
        if not rows:
            return None
        size_received, size, columns = rows[0]
        return UploadState(size_received, size, None if columns is None else _COLUMNS.validate_json(columns))

    def add_part(self, digest: str, begin: int, data: bytes, utc: str) -> UploadState:
        state = self._read_state(digest)
        if state is None:
            raise Refusal("no-upload", "the upload of these points is not known any more", "begin it again")
        if begin != state.received or not data or state.columns is not None:
            return state
        end = begin + len(data)
        if end > state.size:
            raise Refusal("bad-points", f"{end} bytes of points are more than the {state.size} announced", "")
        with self._db.transaction(copied=True):
            self._db.write(_INSERT_PART, (digest, begin, data, crc32(data)))
            values = (end, utc, digest)
            self._db.write("UPDATE uploads SET received = ?, used_utc = ? WHERE digest = ?", values)
        if end < state.size:
            return UploadState(end, state.size, None)
        return UploadState(end, state.size, self._finish_upload(digest))

    def _finish_upload(self, digest: str) -> list[PointColumn]:
        """Check the digest, and find the extremes. Raises `Refusal`; the points are deleted then."""
        ((header,),) = self._db.select("SELECT header FROM uploads WHERE digest = ?", (digest,))
        axes = _AXES.validate_json(header)
        content_hash, summary = hashlib.sha256(header.encode()), ColumnSummary(axes)
        try:
            for data in self._read_parts(digest, 0, None):
                content_hash.update(data)
                summary.add_rows(np.frombuffer(data, ROW_TYPE).reshape(-1, len(axes)))
            if f"sha256:{content_hash.hexdigest()}" != digest:
                raise Refusal(
                    "bad-digest", "the points that arrived are not those that were announced", "send them again"
                )
        except (Refusal, ValueError) as error:
            self.delete_upload(digest)
            if isinstance(error, Refusal):
                raise
            raise Refusal("bad-points", "a part of the points does not end with a row", "send whole rows") from None
        columns = summary.make_columns()
        with self._db.transaction(copied=True):
            self._db.write(
                "UPDATE uploads SET columns = ? WHERE digest = ?", (_COLUMNS.dump_json(columns).decode(), digest)
            )
        return columns

    # Reading

    def read_rows(self, digest: str, first: int, count: int) -> list[tuple[float, ...]]:
        rows = self._db.select("SELECT header, columns FROM uploads WHERE digest = ?", (digest,))
        if not rows or rows[0][1] is None:
            raise JournalError(f"the points {digest[:15]}… are not stored any more", "submit the job again")
        axes = _AXES.validate_json(rows[0][0])
        begin, end = (number * find_row_bytes(axes) for number in (first, first + count))
        data = b"".join(self._read_parts(digest, begin, end))
        return [tuple(row) for row in np.frombuffer(data, ROW_TYPE).reshape(-1, len(axes)).tolist()]

    def _read_parts(self, digest: str, begin: int, end: int | None) -> Iterator[bytes]:
        """The stored bytes from `begin` to `end`, part by part. Raises `DamagedRecord`."""
        parts = self._db.select("SELECT begin, length(data) FROM parts WHERE digest = ? ORDER BY begin", (digest,))
        for start, length in parts:
            if start + length <= begin or (end is not None and start >= end):
                continue
            query = "SELECT data, crc FROM parts WHERE digest = ? AND begin = ?"
            ((data, crc),) = self._db.select(query, (digest, start))
            if crc32(data) != crc:
                text = f"{self._db.name}: points of {digest[:15]}… have changed on the disk"
                raise DamagedRecord(text, "submit the job again, with its points; check the disk")
            yield data[max(0, begin - start) : None if end is None else end - start]

    # Space

    @property
    def used_bytes(self) -> int:
        return self._db.select("SELECT CAST(coalesce(sum(size), 0) AS bigint) FROM uploads")[0][0]

    def delete_upload(self, digest: str) -> None:
        with self._db.transaction():
            self._db.write("DELETE FROM uploads WHERE digest = ?", (digest,))

    def delete_unused(self, named: Collection[str], utc: str) -> None:
        utc_before = format_utc(parse_utc(utc) - UNUSED_AFTER)
        old = self._db.select("SELECT digest FROM uploads WHERE used_utc <= ?", (utc_before,))
        for digest in {digest for (digest,) in old} - set(named):
            self.delete_upload(digest)


def _format_size(size: int) -> str:
    return f"{size} B" if size < 1_000_000 else f"{size / 1e6:.1f} MB"
