"""The steps of a running job, made one by one when their turn comes: memory does not grow with passes and points."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from orchestrator.clock.executor import Executor
from orchestrator.coordinator.journal.point_store import PointStore
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Scan, Step
from orchestrator.model.scan import GridPoints
from orchestrator.model.scans.step_order import StepOrder, StepPlace
from orchestrator.model.units import Unit, parse_quantity

ROWS_AT_ONCE = 4096  # that are read of stored points; 32 kB an axis


class PointReader(Protocol):
    """Reads the positions of a scan's axes at a point, in their units."""

    async def read_point(self, point: int) -> Sequence[float]: ...


class StepSequence:
    """The steps of a job by their numbers. `read_step` reads at most a block of points."""

    def __init__(self, order: StepOrder, fleet: Fleet, store: PointStore, execute: Executor) -> None:
        self.order = order
        self._fleet = fleet
        self._store = store
        self._execute = execute
        self._scan: Scan | None = None
        self._reader: PointReader | None = None

    def __len__(self) -> int:
        return len(self.order)

    def locate(self, index: int) -> StepPlace:
        """Where step number `index` stands. Raises `IndexError`."""
        return self.order.locate(index)

    def describe_place(self, index: int) -> str:
        """The place of a step in words: `step 2 (scan), point 17 of 66 (move)`."""
        return self.locate(index).describe()

    async def read_step(self, index: int) -> Step:
        """Step number `index`; for a point, the move to it, or a step at it. Raises `JournalError` if stored
        points cannot be read."""
        place = self.locate(index)
        scan = place.step
        if not isinstance(scan, Scan) or place.point is None:
            return scan
        if place.part:
            return scan.at_each[place.part - 1]
        return scan.make_move(await self._read_positions(scan, place.point))

    async def find_target(self, place: StepPlace) -> Mapping[str, float]:
        """The positions of the point that a step belongs to; none outside a scan."""
        if not isinstance(place.step, Scan) or place.point is None:
            return {}
        return await self._read_positions(place.step, place.point)

    async def _read_positions(self, scan: Scan, point: int) -> Mapping[str, float]:
        """The positions of a scan's axes at a point, in their units."""
        if self._reader is None or self._scan is not scan:
            self._scan, self._reader = scan, self._make_reader(scan)
        return dict(zip(scan.axis_names, await self._reader.read_point(point), strict=True))

    def _make_reader(self, scan: Scan) -> PointReader:
        units = [self._fleet.axis(name).unit for name in scan.axis_names]
        table = scan.points
        if table is None:
            return _GridReader(GridPoints(scan.axes), units)
        if table.rows is not None:
            return _ListedReader(table.rows, units)
        if table.digest is None:
            raise JournalError("the points of the scan were not sent", "submit the job again")
        return _StoredReader(self._store, self._execute, table.digest, len(units))


class _GridReader:
    def __init__(self, grid: GridPoints, units: Sequence[Unit]) -> None:
        self._grid = grid
        self._units = units

    async def read_point(self, point: int) -> Sequence[float]:
        # The shortest decimal of the nearest double: exact again for every position that a file can state.
        return [float(each) for each in self._grid.find_position(point, self._units)]


class _ListedReader:
    def __init__(self, rows: Sequence[Sequence[float | str]], units: Sequence[Unit]) -> None:
        self._rows = rows
        self._units = units

    async def read_point(self, point: int) -> Sequence[float]:
        return [float(parse_quantity(each, unit)) for each, unit in zip(self._rows[point], self._units, strict=True)]


class _StoredReader:
    """Reads stored points in blocks."""

    def __init__(self, store: PointStore, execute: Executor, digest: str, columns: int) -> None:
        self._store = store
        self._execute = execute
        self._digest = digest
        self._columns = columns
        self._begin = 0
        self._rows: list[tuple[float, ...]] = []

    async def read_point(self, point: int) -> Sequence[float]:
        if not self._begin <= point < self._begin + len(self._rows):
            self._begin = point - point % ROWS_AT_ONCE
            self._rows = await self._execute(self._store.read_rows, self._digest, self._begin, ROWS_AT_ONCE)
        return self._rows[point - self._begin]
