"""Files of points of scans, written at once or while the job runs: CSV, and HDF5 that others read meanwhile."""

import asyncio
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import aclosing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, INTERRUPTED
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.extras import require_extra
from orchestrator.cli.base.jobs import name_jobs
from orchestrator.model.steps.numbers import name_step
from orchestrator.monitor.export.csv_table import CsvStyle, CsvTable

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.report import PointRecord, QueueEntry
    from orchestrator.monitor.export.growing import GrowingTable
    from orchestrator.monitor.export.points import PointColumn


class PointFile(Protocol):
    """A file that points are written to, batch by batch."""

    path: Path

    @property
    def count(self) -> int:
        """How many points are in it."""
        ...

    def add_points(self, points: "Sequence[PointRecord]") -> None:
        """Write points, so that others can read them. Raises `OSError`."""
        ...

    def close(self, *, complete: bool) -> None:
        """Close the file. complete: the job has ended, and all its points are here. Raises `OSError`."""
        ...


class CsvPoints:
    """A CSV file; one that is there is replaced. units: of the axes of a live job, which may move others from point to
    point; none: the axes of the first point are those of all."""

    def __init__(self, path: Path, style: CsvStyle, units: Mapping[str, str]) -> None:
        self.path = path
        self.count = 0
        self._units = units
        self._columns: list[PointColumn] = []
        try:
            self._file = path.open("w", encoding="utf-8", newline="")
        except OSError as error:
            exit_with_error(f"{path} cannot be written: {error.strerror}", FAILED)
        self._table = CsvTable(self._file, style)

    def add_points(self, points: "Sequence[PointRecord]") -> None:
        """Write points. Ends the command if one has other axes than those before."""
        from orchestrator.monitor.export.points import make_point_columns, read_values

        for point in points:
            if not self.count:
                self._units = self._units or dict.fromkeys(point.target, "")
                self._columns = make_point_columns(self._units)
                self._table.write_row(column.name for column in self._columns)
            _require_axes(point, self._units)
            self._table.write_row(read_values(self._columns, point))
            self.count += 1
        self._file.flush()

    def close(self, *, complete: bool) -> None:
        """Close the file."""
        self._file.close()


class Hdf5Points:
    """An HDF5 file that can be read while it grows."""

    def __init__(self, path: Path, table: "GrowingTable", units: Mapping[str, str]) -> None:
        from orchestrator.monitor.export.points import make_point_columns

        self.path = path
        self._table = table
        self._units = units
        self._columns = make_point_columns(units)

    @property
    def count(self) -> int:
        """How many points are in it."""
        return self._table.row_count

    def add_points(self, points: "Sequence[PointRecord]") -> None:
        """Write points. Raises `OSError`: none of them is in the file then."""
        from orchestrator.monitor.export.points import read_values

        for point in points:
            _require_axes(point, self._units)
        self._table.add_rows([read_values(self._columns, point) for point in points])

    def close(self, *, complete: bool) -> None:
        """Close the file."""
        self._table.close(complete=complete)


async def open_csv(tutti: "Tutti", entry: "QueueEntry", path: Path, style: CsvStyle) -> CsvPoints:
    """A CSV file for the points of a job. Ends the command if it cannot be written."""
    from orchestrator.model.steps.tree import as_live

    job = (await tutti.show_job(entry.id)).job
    live = None if job is None else as_live(job.steps[0])
    return CsvPoints(path, style, {} if live is None else await _find_units(tutti, live.axes))


async def open_hdf5(tutti: "Tutti", entry: "QueueEntry", path: Path, step: int | None, *, force: bool) -> Hdf5Points:
    """An HDF5 file for the points of a job, or of its scan at a step. Ends the command if it cannot be made."""
    require_extra("export")
    from orchestrator.monitor.export.files import SCHEMA
    from orchestrator.monitor.export.growing import GrowingTable, NoFileLocks
    from orchestrator.monitor.export.points import make_point_columns

    units = await _find_scan_units(tutti, entry, step)
    attributes = {
        "schema": SCHEMA,
        "table": "points",
        "job_id": entry.id,
        "job": entry.name,
        "actor": entry.actor,
        "submitted_utc": entry.submitted_utc,
        "fleet": tutti.keys.fleet,
    }
    try:
        return Hdf5Points(path, GrowingTable(path, make_point_columns(units), attributes, force=force), units)
    except FileExistsError:
        exit_with_error(f"{path} exists", BAD_INPUT, "give another name, or replace it with --force")
    except NoFileLocks as error:
        remedy = "close it in the other program, or set HDF5_USE_FILE_LOCKING=FALSE where the file system has no locks"
        exit_with_error(str(error), BAD_INPUT, remedy)
    except OSError as error:
        exit_with_error(f"{path} cannot be written: {error.strerror or error}", BAD_INPUT, "choose another place")


async def write_points(batches: "AsyncGenerator[list[PointRecord]]", file: PointFile, *, is_followed: bool) -> None:
    """Write all points that come. An interrupt, and a disk that is full, end the command, and leave what is written.

    is_followed: they end with the job.
    """
    from orchestrator.cli.jobs.foreground import count_interrupts, follow_unless_interrupted

    complete = False
    try:
        with count_interrupts() as interrupts:
            complete = await follow_unless_interrupted(_write_all(batches, file), interrupts) is not None
    except OSError as error:
        text = f"{file.path} cannot be written: {error.strerror or error}; {_count_points(file)} are in it"
        exit_with_error(
            text, FAILED, "make room, and write to another file: the points are in the journal of the fleet"
        )
    finally:
        with suppress(OSError):  # of CSV: what it is about was said above
            file.close(complete=complete and is_followed)
    if not complete:
        exit_with_error(f"interrupted; {_count_points(file)} are in {file.path}", INTERRUPTED)


async def _write_all(batches: "AsyncGenerator[list[PointRecord]]", file: PointFile) -> int:
    async with aclosing(batches):
        async for points in batches:
            file.add_points(points)
            # An interrupt is noticed also while points come faster than they are written.
            await asyncio.sleep(0)
    return file.count


def _count_points(file: PointFile) -> str:
    return f"the first {file.count} points"


def _require_axes(point: "PointRecord", units: Mapping[str, Any]) -> None:
    """End the command if a point has other axes than the columns."""
    if not point.target.keys() <= units.keys():
        text = f"the scan at {name_step(point.step)} has other axes than the one before"
        exit_with_error(text, BAD_INPUT, "choose one scan: --step")


async def _find_scan_units(tutti: "Tutti", entry: "QueueEntry", step: int | None) -> dict[str, str]:
    """The units of the axes of a job's scans, or of its scan at a step; of a live job all of its axes. Ends the command
    if there are none."""
    from orchestrator.model.steps.order import StepOrder
    from orchestrator.model.steps.tree import as_live, find_scans

    job = (await tutti.show_job(entry.id)).job
    steps = [] if job is None else job.steps
    if job is not None and step is not None:
        order = StepOrder(job.steps, entry.terms.repeat)
        steps = [order.locate(step).step] if step < len(order) else []
    live = as_live(steps[0]) if steps else None
    names = live.axes if live is not None else [axis for scan in find_scans(steps) for axis in scan.axis_names]
    if not names:
        title = name_jobs(entry) if step is None else f"{name_step(step)} of {name_jobs(entry)}"
        exit_with_error(f"{title} has no scan", BAD_INPUT, "its points are recorded at scans: see `tutti job show`")
    return await _find_units(tutti, names)


async def _find_units(tutti: "Tutti", named: Sequence[str]) -> dict[str, str]:
    """The axes that names stand for, each with its unit; a virtual axis stands for itself."""
    names = await tutti.list_names()
    units = names.axes | names.virtual
    axes = (axis for name in named for axis in ([name] if name in names.virtual else names.expand_name(name)))
    return {axis: units[axis].value for axis in axes}
