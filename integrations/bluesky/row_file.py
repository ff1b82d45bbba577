"""The rows of a flight as an HDF5 file that grows, and can be read meanwhile (SWMR): one dataset a column."""

from collections.abc import Callable, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from ophyd_async.core import StreamResourceInfo

from tutti import PointRecord

CHUNK = 1024
NAN = float("nan")


class RowFile:
    """A file of rows. axes: the scan's, in `controller.axis`. find_utc_s: UTC of fleet time.

    Of each axis: where it was at the middle of its window, and between which positions that was, by plan and evidence
    (`_lo`, `_hi`). `t_lo`, `t_hi`: the interval of that instant, UTC in s since 1970; `begin`, `end`: of the window,
    the middles of their intervals. good: 1 for a row whose line was flown as planned.
    """

    def __init__(self, path: Path, axes: Sequence[str], find_utc_s: Callable[[int], float]) -> None:
        self.path = path
        self.rows = 0
        self._axes = list(axes)
        self._find_utc_s = find_utc_s
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = h5py.File(path, "x", libver="latest")
        self._columns: dict[str, Any] = {
            name: self._file.create_dataset(
                name, (0,), maxshape=(None,), chunks=(CHUNK,), dtype="<i1" if name == "good" else "<f8"
            )
            for name in self._list_columns()
        }
        self._file.swmr_mode = True

    def list_resources(self, device: str) -> list[StreamResourceInfo]:
        """What a document says of each column. device: begins its data keys."""
        return [
            StreamResourceInfo(
                data_key=f"{device}-{name}",
                shape=(),
                chunk_shape=(CHUNK,),
                dtype_numpy=column.dtype.str,
                parameters={"dataset": f"/{name}"},
            )
            for name, column in self._columns.items()
        ]

    def add_rows(self, records: Sequence[PointRecord]) -> None:
        """Add rows and flush them. Raises `OSError` for a full disk."""
        values = np.array([self._make_row(record) for record in records], dtype=float).reshape(len(records), -1)
        count = self.rows + len(records)
        for column, data in zip(self._columns.values(), values.T, strict=True):
            column.resize((count,))
            column[self.rows :] = data
            column.flush()
        self.rows = count

    def close(self) -> None:
        """Close it. May be called twice."""
        if self._file:
            self._file.close()

    def _list_columns(self) -> list[str]:
        names = (axis.replace(".", "_") for axis in self._axes)
        return [
            *chain.from_iterable((name, f"{name}_lo", f"{name}_hi") for name in names),
            "t_lo",
            "t_hi",
            "begin",
            "end",
            "good",
        ]

    def _make_row(self, record: PointRecord) -> list[float]:
        window = record.window
        places = {} if window is None else window.positions
        row: list[float] = []
        for axis in self._axes:
            least, most = places.get(axis, (NAN, NAN))
            row += [(least + most) / 2, least, most]
        if window is None:
            return [*row, NAN, NAN, NAN, NAN, 0]
        begin, end = (
            self._find_utc_s((instant.earliest_ns + instant.latest_ns) // 2) for instant in (window.lower, window.upper)
        )
        middle = window.middle
        instants = [self._find_utc_s(middle.earliest_ns), self._find_utc_s(middle.latest_ns), begin, end]
        return [*row, *instants, float(record.good is True)]
