"""Flights in the fault campaign: the true motion in each window that is called good, and the edges in it."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orchestrator.campaign.fleets import SYNC_MAKE
from orchestrator.campaign.recording.row_recorder import PublishedRows, RowRecorder
from orchestrator.campaign.records import CampaignPhase, PhaseRecords
from orchestrator.campaign.stages.flown_scans import SPACING, find_flown_scan
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.model.fleet import Axis
from orchestrator.model.names import controller_of
from orchestrator.model.report import FINISHED_STATES, PointRecord
from orchestrator.model.steps.fly import WindowPlace
from orchestrator.model.steps.scan import Scan
from orchestrator.runtime.virtual.fleet import VirtualFleet

SAMPLE_NS = 2 * NS_PER_MS  # of a moving axis: its speed is constant in a window
REST_NS = 20 * NS_PER_MS  # between two looks at one at rest, whose run-up takes longer
REST_SAMPLES = 15  # of one that is at rest; a drive may wait for the next SYNC of its stream
OTHER_TIME = 0.005  # of a window
SYNC_LATE_S = 0.0012  # a drive follows the SYNCs of its host: so late one comes within the model of a CAN bus, rarely
EDGE_NS = 10 * NS_PER_MS  # of an edge beside its place: its instant is rounded, and commands take time
MOST_ROWS = 5000

PLACES: tuple[WindowPlace, ...] = ("start", "middle", "end")

Array = NDArray[np.float64]
AddViolation = Callable[[str, str], None]


@dataclass(frozen=True, slots=True)
class _Flight:
    """What the axis that flies in one job does. instants_ns: of the host; places: where it truly was, in its unit."""

    axis: Axis
    scan: Scan
    instants_ns: list[int] = field(default_factory=list[int])
    places: list[float] = field(default_factory=list[float])

    @property
    def window_s(self) -> float:
        """The time in each window, as planned."""
        assert self.scan.fly is not None and self.scan.fly.duration is not None
        return self.scan.fly.duration / NS_PER_S


class _TrueMotion:
    """The true motion of the axis that flies, in fleet time."""

    def __init__(self, flight: _Flight, origin_ns: int) -> None:
        self._times_ns = np.array(flight.instants_ns, dtype=np.float64) - origin_ns
        self._places = np.array(flight.places, dtype=np.float64)

    def find_crossing(self, position: float, near_ns: float, *, rising: bool) -> float | None:
        """When it passed a position in one direction, ns: nearest to an instant; None: never."""
        places = self._places if rising else -self._places
        position = position if rising else -position
        steps = np.flatnonzero((places[:-1] < position) & (places[1:] >= position))
        if not len(steps):
            return None
        shares = (position - places[steps]) / (places[steps + 1] - places[steps])
        crossings = self._times_ns[steps] + shares * (self._times_ns[steps + 1] - self._times_ns[steps])
        return float(crossings[np.abs(crossings - near_ns).argmin()])


class FlightChecker:
    """Watches the axes that fly, and checks rows against that. add_violation: called with the invariant and a text."""

    def __init__(
        self, fleet: VirtualFleet, rows: RowRecorder, records: PhaseRecords, add_violation: AddViolation
    ) -> None:
        self._fleet = fleet
        self._rows = rows
        self._records = records
        self._add_violation = add_violation
        self._flights: dict[str, _Flight] = {}
        self._tasks = TaskOwner()

    # During a run

    def watch(self, phase: CampaignPhase) -> None:
        """Watch the flights of a phase from now on, each until its job has ended."""
        for job_id, order in phase.jobs.items():
            scan = find_flown_scan(order.job)
            if scan is not None and job_id not in self._flights:
                self._flights[job_id] = flight = _Flight(self._fleet.fleet.axis(scan.flown_axis), scan)
                self._tasks.spawn(self._sample(job_id, flight))

    def end(self) -> None:
        """Watch no more."""
        self._tasks.cancel_all()

    async def _sample(self, job_id: str, flight: _Flight) -> None:
        unit, motor = self._fleet.controllers[controller_of(flight.scan.flown_axis)], flight.axis.motors[0]
        resting = REST_SAMPLES
        while (row := self._fleet.journal.load_record(job_id)) is not None and row.state not in FINISHED_STATES:
            await sleep_ns(self._fleet.clock, REST_NS)
            resting = 0 if unit.is_moving(motor) else resting
            while resting < REST_SAMPLES:
                flight.instants_ns.append(self._fleet.clock.now_ns())
                flight.places.append(flight.axis.to_unit(unit.position(motor)))
                await sleep_ns(self._fleet.clock, SAMPLE_NS)
                resting = 0 if unit.is_moving(motor) else resting + 1

    # After a phase

    def check_phase(self, phase: CampaignPhase, rises: Mapping[str, Sequence[int]], untrusted: Collection[str]) -> None:
        """Check invariant 18 for all flights of a phase. rises: when outputs with triggers became active, host ns, by
        controller. untrusted: controllers whose measurements are outside the model."""
        for job_id in phase.jobs:
            flight = self._flights.pop(job_id, None)
            if flight is None:
                continue
            rows, flown_axis = self._rows.find_rows(job_id), flight.scan.flown_axis
            self._check_order(job_id, flown_axis, rows)
            if controller_of(flown_axis) in untrusted:
                continue
            motion = _TrueMotion(flight, self._records.origin_ns())
            crossings = {
                row.point: self._check_window(flight, motion, row) for row in rows.points if row.good and row.window
            }
            trigger = None if flight.scan.fly is None else flight.scan.fly.trigger
            if trigger is not None and (owner := controller_of(trigger.output)) not in untrusted:
                edges = np.array(rises.get(owner, ()), dtype=np.float64) - self._records.origin_ns()
                number = PLACES.index(trigger.at)
                self._check_evidence(trigger.output, rows, edges)
                self._check_pulses(
                    trigger.output, {point: times[number] for point, times in crossings.items() if times}, edges
                )

    def _check_order(self, job_id: str, flown_axis: str, rows: PublishedRows) -> None:
        """Rows come in the order of their points, each once, and those that are good have a window."""
        points = [row.point for row in rows.points]
        if points != sorted(set(points)):
            self._add_violation("18", f"the rows of {flown_axis} are not in the order of their points: {points}")
        good_points = {row.point for row in rows.points if row.good}
        kept_rows = self._fleet.journal.point_rows.load_points(job_id, (-1, 0), MOST_ROWS)
        unpublished_points = {row.point for row in kept_rows if row.good} - good_points
        if unpublished_points:
            text = f"points {sorted(unpublished_points)} of {flown_axis} are good in the journal only"
            self._add_violation("18", text)
        blank_points = [row.point for row in rows.points if row.good and (row.window is None or row.took_s is None)]
        if blank_points:
            self._add_violation("18", f"points {blank_points} of {flown_axis} are good without evidence")

    def _check_window(self, flight: _Flight, motion: _TrueMotion, row: PointRecord) -> list[float]:
        """Check that the window of a good row was flown within its speed, and that its intervals contain the truth.
        Return when it was at its beginning, middle and end, ns; nothing for a window in which it was not."""
        assert row.window is not None
        scan, flown_axis = flight.scan, flight.scan.flown_axis
        rising = not (row.point - 1) // scan.line_points % 2
        times_ns: list[float] = []
        for part, interval in ((-0.5, row.window.lower), (0.0, row.window.middle), (0.5, row.window.upper)):
            position = row.target[flown_axis] + (part if rising else -part) * SPACING
            near_ns = (interval.earliest_ns + interval.latest_ns) / 2
            time_ns = motion.find_crossing(position, near_ns, rising=rising)
            if time_ns is None or not interval.earliest_ns <= time_ns <= interval.latest_ns:
                self._add_violation(
                    "18", f"{flown_axis} was at {position:g} of point {row.point} at {time_ns}, claimed {interval}"
                )
                return []
            times_ns.append(time_ns)
        taken_s, planned_s = (times_ns[2] - times_ns[0]) / NS_PER_S, flight.window_s
        count = 1 / abs(float(flight.axis.counts_per_unit))
        is_sync = self._fleet.fleet.controllers[controller_of(flown_axis)].adapter == SYNC_MAKE
        if abs(taken_s - planned_s) > planned_s * max(OTHER_TIME, count / SPACING) + is_sync * SYNC_LATE_S:
            text = f"{flown_axis} took {taken_s:.5f} s through good window {row.point}; planned {planned_s:g} s"
            self._add_violation("18", text)
        return times_ns

    def _check_evidence(self, output: str, rows: PublishedRows, edges: Array) -> None:
        """Check that every edge that is called seen has happened, inside its interval."""
        for row in rows.triggers.get(output, ()):
            interval = row.seen
            if interval is not None and not ((edges >= interval.earliest_ns) & (edges <= interval.latest_ns)).any():
                self._add_violation("18", f"{output}: edge {row.number} was not at {interval}, as is claimed")

    def _check_pulses(self, output: str, times_ns: Mapping[int, float], edges: Array) -> None:
        """Check that an output became active at each place. times_ns: when that was reached, by point."""
        for point, time_ns in times_ns.items():
            if (np.abs(edges - time_ns) <= EDGE_NS).sum() != 1:
                self._add_violation(
                    "18", f"{output} was not switched once in the window of point {point}, which is good"
                )
