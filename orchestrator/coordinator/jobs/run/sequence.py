"""The steps of a running job, made one by one when their turn comes: memory does not grow with passes and points."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from orchestrator.clock.executor import Executor
from orchestrator.coordinator.jobs.run.scan_flights import ScanFlights
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.store import PointUploads
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import StepReport
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.order import StepOrder, StepPlace
from orchestrator.model.steps.points import GridPoints
from orchestrator.model.steps.scan import Scan
from orchestrator.model.units import Unit, parse_quantity
from orchestrator.plan.flying.lines import FlownLines

ROWS_AT_ONCE = 4096  # that are read of stored points; 32 kB an axis
READERS_KEPT = 2  # of the present scan, and the one before or behind it


class PointReader(Protocol):
    """The positions of a scan's axes at its points, in their units."""

    async def load_point(self, point: int) -> None:
        """Have a point, and the next one, in memory. Raises `JournalError`."""
        ...

    def find_positions(self, point: int) -> Sequence[float]:
        """Raises `KeyError` for a point that is not in memory."""
        ...


class StepSequence:
    """The steps of a job by their numbers. A point of a scan is a move, then the steps at it."""

    def __init__(
        self, order: StepOrder, fleet: Fleet, store: PointUploads, execute: Executor, flights: ScanFlights | None = None
    ) -> None:
        """flights: of its scans; a job that flies none needs none."""
        self.order = order
        self._fleet = fleet
        self._store = store
        self._execute = execute
        self._readers: dict[int, tuple[Scan, PointReader]] = {}
        self._flights = flights

    def replace_order(self, order: StepOrder) -> None:
        """Other steps, with the named positions of this moment."""
        self.order = order
        self._readers = {}

    def list_steps(self, first: int) -> list[Step]:
        """The written steps from number `first` on."""
        return [step.step for step in self.order.list_remaining(first)]

    def __len__(self) -> int:
        return len(self.order)

    def __getitem__(self, index: int) -> Step:
        """Step number `index`, without reading anything: those of the present point, of the next one, and all that are
        in the job itself. Raises `IndexError`, `KeyError` for a stored point that is not in memory, and `Refusal` for
        a scan that cannot be flown."""
        location = self.locate(index)
        return location.choose_step(lambda scan: self._make_motion(scan, location))

    def locate(self, index: int) -> StepPlace:
        """Where step number `index` stands. Raises `IndexError`."""
        return self.order.locate(index)

    def has_step(self, index: int) -> bool:
        """Whether step `index` is known."""
        return index < len(self)

    def end(self) -> None:
        """No further step begins."""

    async def find_next(self, index: int) -> int | None:
        """The number of the next step to run, `index` or behind it, once there is one; None: there is none any more."""
        index = index if self._flights is None else self._flights.take_next(index)
        return index if index < len(self) else None

    def note_report(self, index: int, report: StepReport) -> bool:
        """Step `index` has ended; return whether another one may begin."""
        del index
        return report.state == "done" or (self._flights is not None and self._flights.goes_on)

    def drop_waiting(self, reason: str) -> None:
        """The job has ended: steps that were asked for and have not begun do not begin."""
        del reason

    async def read_step(self, index: int) -> Step:
        """Step number `index`; at most a block of points is read. Raises `JournalError`."""
        location = self.locate(index)
        if location.scan is not None and location.point is not None:
            await self._find_reader(location.scan).load_point(location.point)
        if self._flights is not None:
            await self._flights.prepare(location)
        return self[index]

    def find_target(self, place: StepPlace) -> Mapping[str, float]:
        """The positions of the point that a step belongs to, in the units of its axes; none outside a scan. Raises
        `KeyError` for a stored point that is not in memory."""
        if place.scan is None or place.point is None:
            return {}
        positions = self._find_reader(place.scan).find_positions(place.point)
        return dict(zip(place.scan.axis_names, positions, strict=True))

    def has_begun(self, place: StepPlace) -> bool:
        """Whether a part of a line that is flown was flown already."""
        return self._flights is not None and place.is_flown_path and self._flights.find_begin(place) != place.point

    @property
    def flights(self) -> ScanFlights:
        """What of its scans flies."""
        assert self._flights is not None
        return self._flights

    def find_lines(self, place: StepPlace) -> FlownLines | None:
        """The lines of the scan that a step belongs to, if it flies. Raises `Refusal` if it cannot be flown."""
        return None if self._flights is None else self._flights.find_lines(place)

    def _make_motion(self, scan: Scan, place: StepPlace) -> Step:
        """The motion of a scan that a place is: to a point, or of a line that is flown its move or path."""
        if self.find_lines(place) is not None:
            return self.flights.find_motion(place)
        return scan.make_move(self.find_target(place))

    def _find_reader(self, scan: Scan) -> PointReader:
        if id(scan) not in self._readers:
            if len(self._readers) == READERS_KEPT:
                del self._readers[next(iter(self._readers))]
            self._readers[id(scan)] = scan, self._make_reader(scan)
        return self._readers[id(scan)][1]

    def _make_reader(self, scan: Scan) -> PointReader:
        units = [self._fleet.unit_of(name) for name in scan.axis_names]
        table = scan.points
        if table is None:
            return _GridReader(scan.grid, units)
        if table.rows is not None:
            return _ListedReader(table.rows, units)
        if table.digest is None:
            raise JournalError("the points of the scan were not sent", "submit the job again")
        return _StoredReader(self._store, self._execute, table.digest, table.count)


class _GridReader:
    def __init__(self, grid: GridPoints, units: Sequence[Unit]) -> None:
        self._grid = grid
        self._units = units

    async def load_point(self, point: int) -> None:
        return

    def find_positions(self, point: int) -> Sequence[float]:
        # The shortest decimal of the nearest double: exact again for every position that a file can state.
        return [float(value) for value in self._grid.find_position(point, self._units)]


class _ListedReader:
    def __init__(self, rows: Sequence[Sequence[float | str]], units: Sequence[Unit]) -> None:
        self._rows = rows
        self._units = units

    async def load_point(self, point: int) -> None:
        return

    def find_positions(self, point: int) -> Sequence[float]:
        return [float(parse_quantity(text, unit)) for text, unit in zip(self._rows[point], self._units, strict=True)]


class _StoredReader:
    """Reads stored points in blocks, and keeps two of them."""

    def __init__(self, store: PointUploads, execute: Executor, digest: str, count: int) -> None:
        self._store = store
        self._execute = execute
        self._digest = digest
        self._count = count
        self._blocks: dict[int, list[tuple[float, ...]]] = {}

    async def load_point(self, point: int) -> None:
        wanted_rows = {number // ROWS_AT_ONCE for number in (point, min(point + 1, self._count - 1))}
        for number in sorted(wanted_rows - self._blocks.keys()):
            rows = await self._execute(self._store.read_rows, self._digest, number * ROWS_AT_ONCE, ROWS_AT_ONCE)
            self._blocks[number] = rows
        if not wanted_rows >= self._blocks.keys():
            self._blocks = {number: self._blocks[number] for number in sorted(wanted_rows)}

    def find_positions(self, point: int) -> Sequence[float]:
        return self._blocks[point // ROWS_AT_ONCE][point % ROWS_AT_ONCE]
