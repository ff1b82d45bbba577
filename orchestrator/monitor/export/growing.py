"""A table in an HDF5 file that others read while it grows (SWMR: single writer, multiple readers).

All its datasets are there before the first row. Each batch of rows is written to all columns, and only then to `rows`:
the first `rows` values of every column are complete, also if the program that writes is killed. Room on the disk is
taken before anything is written, because HDF5 does not get over a write that fails: a full disk ends the table cleanly.
"""

# h5py types its functions only in part.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportMissingTypeStubs=false
# pyright: reportUnknownArgumentType=false

import errno
import os
import struct
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from orchestrator.model.errors import TuttiError
from orchestrator.monitor.export.points import ColumnKind, PointColumn

CHUNK_ROWS = 512
TEXT_BYTES = 32
GROWS, COMPLETE, BROKEN_OFF = 0, 1, 2
STATUS_MEANING = "0: it grows; 1: the job has ended, and all its rows are here; 2: the writer has ended before the job"
SPARE_BYTES = 128 * 1024  # of what HDF5 keeps beside the values
FORMAT = ("v110", "v110")  # the first one with SWMR, so that older programs read it too
END_ADDRESS = slice(28, 36)  # of a superblock of that format (HDF5 File Format Specification 3.0, II.A)

_TYPES: Mapping[ColumnKind, tuple[Any, Any]] = {
    "whole": (np.int64, 0),
    "number": (np.float64, np.nan),
    "text": (np.dtype(f"S{TEXT_BYTES}"), b""),
    "flag": (np.int8, -1),
}
_MISSING: Mapping[ColumnKind, str] = {"number": "NaN", "text": "empty", "flag": "-1"}


class NoFileLocks(TuttiError):
    """Another program has the file open, or its file system has no locks. The text says which file."""


class GrowingTable:
    """A table in the group `points` of a new file.

    attributes: of the file. force: replaces a file that is there; its readers keep that one. Raises
    `FileExistsError` without it, other `OSError`, and `NoFileLocks`.
    """

    def __init__(
        self, path: Path, columns: Sequence[PointColumn], attributes: Mapping[str, str], *, force: bool = False
    ) -> None:
        self.row_count = 0
        self._path = path
        self._columns = columns
        self._values: list[h5py.Dataset] = []
        # Under its name it is there only once it can be read: readers wait for it. On Windows, where no open file gets
        # another name, they may find one that they cannot read yet.
        new_path = path if sys.platform == "win32" else path.with_name(f"{path.name}.new")
        _require_absence(path, force=force)
        self._descriptor = os.open(new_path, os.O_CREAT | os.O_RDWR | getattr(os, "O_BINARY", 0), 0o666)
        try:
            self._create(new_path, attributes, force=force)
        except BaseException:
            os.close(self._descriptor)
            new_path.unlink(missing_ok=True)
            raise

    def add_rows(self, rows: Sequence[Sequence[Any]]) -> None:
        """Add rows, each with a value, or None, for each column; readers see them at once. Raises `OSError`: nothing of
        them is in the table then."""
        if not rows:
            return
        count = self.row_count + len(rows)
        self._take_room(len(rows))
        try:
            for column, dataset, values in zip(self._columns, self._values, zip(*rows, strict=True), strict=True):
                dataset.resize((count,))
                dataset[self.row_count :] = _make_array(column.kind, values)
                dataset.flush()
            self._rows[0] = count
            self._rows.flush()
        except RuntimeError as error:
            raise OSError(errno.EIO, str(error)) from None
        self.row_count = count

    def close(self, *, complete: bool) -> None:
        """Close the file. complete: the job has ended, and all its rows are here. May be called twice."""
        if not self._file:
            return
        # After a write that has failed there is nothing to be done about a second one: the rows so far are written.
        with suppress(OSError, RuntimeError):
            self._status[0] = COMPLETE if complete else BROKEN_OFF
            self._status.flush()
            self._file.close()
            self._give_back_room()
        os.close(self._descriptor)

    def _create(self, new_path: Path, attributes: Mapping[str, str], *, force: bool) -> None:
        try:
            self._file = h5py.File(new_path, "w", libver=FORMAT)
        except BlockingIOError:
            raise NoFileLocks(f"{self._path} cannot be locked") from None
        try:
            self._take_room(0)
            self._file.attrs.update(attributes)
            group = self._file.create_group("points")
            for column in self._columns:
                self._values.append(_create_column(group, column))
            self._rows = _create_number(self._file, "rows", np.int64, "number of rows that are complete in all columns")
            self._status = _create_number(self._file, "status", np.int8, STATUS_MEANING)
            self._file.swmr_mode = True
            if new_path != self._path:
                _require_absence(self._path, force=force)
                new_path.replace(self._path)
        except BaseException:
            self._file.close()
            raise

    def _take_room(self, rows: int) -> None:
        """Have room for rows, and for the end of the file. Raises `OSError`."""
        chunk_bytes = CHUNK_ROWS * sum(np.dtype(_TYPES[column.kind][0]).itemsize for column in self._columns)
        needed_bytes = self._file.id.get_filesize() + chunk_bytes * (2 + rows // CHUNK_ROWS) + SPARE_BYTES
        if needed_bytes > os.fstat(self._descriptor).st_size:
            try:
                _allocate(self._descriptor, needed_bytes)
            except OSError as error:
                if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):  # a file system that cannot
                    raise

    def _give_back_room(self) -> None:
        """Cut the file where HDF5 says that it ends."""
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        (end,) = struct.unpack("<Q", os.read(self._descriptor, END_ADDRESS.stop)[END_ADDRESS])
        if end <= os.fstat(self._descriptor).st_size:
            os.ftruncate(self._descriptor, end)


def _allocate(descriptor: int, size: int) -> None:
    """Make a file at least so long, with room for all of it where the system can: macOS cannot."""
    if sys.platform == "linux":
        os.posix_fallocate(descriptor, 0, size)
    else:
        os.ftruncate(descriptor, size)


def _require_absence(path: Path, *, force: bool) -> None:
    if path.exists() and not force:
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


def _create_column(group: h5py.Group, column: PointColumn) -> h5py.Dataset:
    dtype, fill_value = _TYPES[column.kind]
    dataset = group.create_dataset(
        column.name, shape=(0,), maxshape=(None,), chunks=(CHUNK_ROWS,), dtype=dtype, fillvalue=fill_value
    )
    dataset.attrs["meaning"] = column.meaning
    if column.unit:
        dataset.attrs["units"] = column.unit
    if column.kind in _MISSING:
        dataset.attrs["missing"] = _MISSING[column.kind]
    return dataset


def _create_number(file: h5py.File, name: str, kind: Any, meaning: str) -> h5py.Dataset:
    # In a chunk, because readers see what changes in one.
    dataset = file.create_dataset(name, shape=(1,), maxshape=(1,), chunks=(1,), dtype=kind)
    dataset.attrs["meaning"] = meaning
    return dataset


def _make_array(kind: ColumnKind, values: Sequence[Any]) -> NDArray[Any]:
    dtype, fill_value = _TYPES[kind]
    if kind == "text":
        return np.array([(value or "").encode("ascii", "replace")[:TEXT_BYTES] for value in values], dtype=dtype)
    return np.array([fill_value if value is None else value for value in values], dtype=dtype)
