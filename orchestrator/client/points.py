"""Points of scans: files and specs are read and checked here, and sent before the job that names them."""

import asyncio
import base64
import hashlib
import json
from collections.abc import AsyncGenerator, Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

from orchestrator.client.connection import FleetConnection
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.service import FleetNames, PointsPut, PointsRead, PutPoints, ReadPoints
from orchestrator.model.messages import Request
from orchestrator.model.paths.files.steps import read_path_steps
from orchestrator.model.report import PointRecord
from orchestrator.model.steps.points import PART_BYTES, ROW_TYPE, PointAxis, PointTable, find_row_bytes, make_header
from orchestrator.model.steps.scan import Scan, find_moved_twice
from orchestrator.model.steps.tree import find_scans
from orchestrator.model.units import Unit

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SEND_S = 30.0  # for one part; with the last one all points are checked
RECORDS_AT_ONCE = 2000


class PointProgress(NamedTuple):
    """How many points of a table were read, or sent. total: None while it is not known."""

    doing: Literal["reading", "sending"]
    points: int
    total: int | None = None


OnPoints = Callable[[PointProgress], None]


class PointSource(Protocol):
    """Points, block by block. axes: the columns, once the first block was read."""

    axes: list[PointAxis]

    def read_blocks(self) -> Iterator["NDArray[np.float64]"]: ...


class PointRequests(FleetConnection):
    """Send points of scans, and read what was recorded at them."""

    async def send_points(self, job: Job, on_points: OnPoints | None = None) -> Job:
        """Read the points of all scans that are in files or specs, and send them; return the job that names what is
        stored. Points that are stored already are not sent again.

        Files of paths are read as well. on_points: called with the progress. Raises `FileError` with every wrong line,
        and `Refusal`: codes `point-store-full`, `no-scanspec`, `bad-scanspec`.
        """
        job = place_flown_specs(read_path_steps(job))
        unread = [scan for scan in find_scans(job.steps) if _is_unread(scan)]
        if not unread:
            return job
        names = await self.request_service("names", Request(**self.request_fields()), FleetNames)
        scans: dict[int, Scan] = {}
        for scan in unread:
            table = await self._send_table(make_point_source(scan, names.axes), on_points or _ignore_progress)
            scans[id(scan)] = place_points(scan, table)
        return job.model_copy(update={"steps": [step.replace_steps(scans) for step in job.steps]})

    async def _send_table(self, source: PointSource, on_points: OnPoints) -> PointTable:
        # Only on a disk, because a million points as Python numbers take some 100 MB.
        with TemporaryFile() as rows:
            digest, count = await _spool_points(source, rows, on_points)
            fields: dict[str, Any] = {"digest": digest, "axes": source.axes, "count": count}
            part_bytes = PART_BYTES - PART_BYTES % find_row_bytes(source.axes)
            data = b""
            begin = 0
            while True:
                text = base64.b64encode(data).decode()
                request = PutPoints(**self.request_fields(), **fields, begin=begin, data=text)
                state = await self.request_service("put-points", request, PointsPut, SEND_S)
                on_points(PointProgress("sending", state.received // find_row_bytes(source.axes), count))
                if state.points is not None:
                    return state.points
                begin = state.received
                rows.seek(begin)
                data = rows.read(part_bytes)
                if not data:
                    raise Refusal("bad-points", "the points cannot be stored: their size has changed", "submit again")

    async def iterate_points(self, job_id: str, step: int | None = None) -> AsyncGenerator[PointRecord]:
        """What was recorded at the points of the scans of a job so far, in their order. Raises `Refusal`.

        step: only of the scan that begins with this step.
        """
        async for points in self.iterate_point_batches(job_id, step):
            for point in points:
                yield point

    async def iterate_point_batches(self, job_id: str, step: int | None = None) -> AsyncGenerator[list[PointRecord]]:
        """`iterate_points`, many at a time: for what is written to a file."""
        async for points in self.read_point_parts(job_id, (-1, 0) if step is None else (step, 0)):
            wanted_points = [point for point in points if step in (None, point.step)]
            yield wanted_points
            if len(wanted_points) < len(points):
                return

    async def read_point_parts(self, job_id: str, after: tuple[int, int]) -> AsyncGenerator[list[PointRecord]]:
        """What was recorded so far behind a point, in parts of up to `RECORDS_AT_ONCE`. after: the step with which its
        scan begins, and its number. Raises `Refusal`."""
        while True:
            request = ReadPoints(
                **self.request_fields(), job_id=job_id, limit=RECORDS_AT_ONCE, after_step=after[0], after_point=after[1]
            )
            points = (await self.request_service("points", request, PointsRead)).points
            if points:
                yield points
            if len(points) < RECORDS_AT_ONCE:
                return
            after = points[-1].step, points[-1].point

    async def load_points(self, job_id: str) -> list[PointRecord]:
        """What was recorded at the points of the scans of a job. Of a long scan take `iterate_points`. Raises
        `Refusal`."""
        return [point async for point in self.iterate_points(job_id)]


class PointSummaries:
    """The points of files and specs, read once each; nothing is sent. units: of all axes of the fleet."""

    def __init__(self, units: Mapping[str, Unit]) -> None:
        self._units = units
        self._tables: dict[str, PointTable] = {}

    def place_summaries(self, job: Job) -> Job:
        """The job with the extremes of the points of its files and specs, as the coordinator would find them. Raises
        `FileError`, `Refusal`."""
        job = place_flown_specs(job)
        points = {
            id(scan): place_points(scan, self._find_table(scan)) for scan in find_scans(job.steps) if _is_unread(scan)
        }
        return job.model_copy(update={"steps": [step.replace_steps(points) for step in job.steps]}) if points else job

    def _find_table(self, scan: Scan) -> PointTable:
        source = json.dumps([scan.scanspec, None if scan.points is None else scan.points.file])
        if source not in self._tables:
            self._tables[source] = _summarize_points(make_point_source(scan, self._units))
        return self._tables[source]


def _summarize_points(source: PointSource) -> PointTable:
    from orchestrator.model.scans.point_summary import ColumnSummary

    encoded_points = _EncodedPoints(source)
    summary: ColumnSummary | None = None
    for block, _ in encoded_points.read_blocks():
        summary = summary or ColumnSummary(source.axes)
        summary.add_rows(block)
    assert summary is not None  # a source without points is refused
    return PointTable(digest=encoded_points.digest, count=summary.count, columns=summary.make_columns())


def make_point_source(scan: Scan, units: Mapping[str, Unit]) -> PointSource:
    """The points of a scan that is in a file, or a spec. units: of all axes of the fleet. Raises `Refusal`."""
    # Imported here, because most jobs need neither.
    from orchestrator.model.scans.point_file import PointFile
    from orchestrator.model.scans.spec_points import SpecPoints

    if scan.scanspec is not None:
        return SpecPoints(scan.scanspec, units)
    assert scan.points is not None and scan.points.file is not None
    return PointFile(Path(scan.points.file), units)


def place_flown_specs(job: Job) -> Job:
    """The job with axes in its scans whose spec flies. Raises `Refusal`, code `bad-scanspec` for one that cannot."""
    from orchestrator.model.scans.spec_lines import place_flown_spec

    specs = [scan for scan in find_scans(job.steps) if scan.scanspec is not None]
    if not specs:
        return job
    scans = {id(scan): place_flown_spec(scan) for scan in specs}
    return job.model_copy(update={"steps": [step.replace_steps(scans) for step in job.steps]})


def place_points(scan: Scan, table: PointTable) -> Scan:
    """The scan with the points of `table`. Raises `Refusal` if a step at its points moves one of their axes."""
    for number, repetitions in find_moved_twice(table.axis_names, scan.at_each):
        text = f"at_each[{number}] moves {', '.join(repetitions)}, which the scan positions"
        raise Refusal("bad-points", text, "move other axes there")
    return scan.model_copy(update={"points": table, "scanspec": None})


async def _spool_points(source: PointSource, rows: IO[bytes], on_points: OnPoints) -> tuple[str, int]:
    """Write all points to a file; return their digest and number."""
    encoded_points, count = _EncodedPoints(source), 0
    for block, data in encoded_points.read_blocks():
        rows.write(data)
        count += len(block)
        on_points(PointProgress("reading", count))
        # What else runs in this program, such as the signs of life of a session, gets its turn.
        await asyncio.sleep(0)
    return encoded_points.digest, count


class _EncodedPoints:
    """Points as they are sent, and their digest once all were read."""

    def __init__(self, source: PointSource) -> None:
        self._source = source
        self._hash = hashlib.sha256()

    @property
    def digest(self) -> str:
        return f"sha256:{self._hash.hexdigest()}"

    def read_blocks(self) -> Iterator[tuple["NDArray[np.float64]", bytes]]:
        """The points block by block, each also as bytes."""
        for number, block in enumerate(self._source.read_blocks()):
            if not number:
                self._hash.update(make_header(self._source.axes))
            data = block.astype(ROW_TYPE).tobytes()
            self._hash.update(data)
            yield block, data


def _is_unread(scan: Scan) -> bool:
    return scan.scanspec is not None or (scan.points is not None and scan.points.file is not None)


def _ignore_progress(_: PointProgress) -> None:
    return
