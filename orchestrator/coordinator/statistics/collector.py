"""The statistics of the operation: counted in memory, and added to the journal when a job has ended, and every ten
seconds while one moves.

What was counted since then is lost if the coordinator is killed. Nothing is asked of a controller.
"""

from collections.abc import Sequence
from contextlib import suppress
from itertools import combinations

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.listening import keep_apart
from orchestrator.coordinator.fleet.positions import JournalCalls
from orchestrator.coordinator.journal.facts import WORST, StatisticsRow
from orchestrator.coordinator.journal.records import EpochOvertaken, JournalError
from orchestrator.coordinator.journal.store import StatisticsStore
from orchestrator.coordinator.motion.budget import measure_skew
from orchestrator.coordinator.statistics.availability import AvailabilityClock
from orchestrator.coordinator.statistics.periods import make_periods
from orchestrator.coordinator.statistics.skew_histogram import find_bin
from orchestrator.model.errors import Refusal
from orchestrator.model.operation.statistics import ReadStatistics, StatisticsRead
from orchestrator.model.report import AxisRecording, JobReport, StepRecording, StepReport
from orchestrator.model.state import ControllerEvent

TICK_NS = NS_PER_S
MOTION_NS = 10 * NS_PER_S  # from a step to the write; a write may delay the decision of a step that is being armed
AVAILABILITY_NS = 60 * NS_PER_S  # between two writes of nothing but times
MAX_FIGURES = 20_000  # that wait for the journal; then new ones are lost
MAX_ROWS = 200_000  # of one request
MAX_CAUSE = 60
MOST_PAIRED = 16  # controllers of a step; the pairs of more would be tens of thousands

FigureKey = tuple[str, str, str, str]
"""Day, kind, subject and figure."""


class StatisticsCollector:
    """Counts what the fleet does."""

    def __init__(self, access: FleetAccess, table: StatisticsStore, execute: JournalCalls) -> None:
        self._access = access
        self._table = table
        self._execute = execute
        self._counted: dict[FigureKey, float] = {}
        self._directions: dict[str, int] = {}
        self._clock = AvailabilityClock(access.view, access.clock, self._count)
        self._due_ns = 0
        self.take_motion = keep_apart(access.tasks, self._take_motion)
        self.take_job = keep_apart(access.tasks, self._take_job)

    async def start(self) -> None:
        """Listen, and write what was counted."""
        self._due_ns = self._access.clock.now_ns() + AVAILABILITY_NS
        view, tasks = self._access.view, self._access.tasks
        view.add_state_listener(keep_apart(tasks, self._clock.take_state))
        view.add_event_listener(keep_apart(tasks, self._take_event))
        tasks.spawn(self._run(), vital=False)

    async def close(self) -> None:
        """Write what is counted."""
        self._clock.tick()
        with suppress(JournalError):
            await self._write()

    # What is counted

    def _take_motion(self, recording: StepRecording, report: StepReport | None) -> None:
        """Count a motion step that is over. report: None for one that was interrupted."""
        is_done = report is not None and report.state == "done"
        for name, axis in recording.axes.items():
            self._count_move(name, axis, recording.t0_fleet_ns, done=is_done)
        if report is not None and is_done:
            self._count_skews(report)

    def _take_job(self, report: JobReport) -> None:
        """Count the end of a job, and why its steps were not done."""
        self._count("jobs", "", report.state, 1)
        for step in report.steps:
            if step.state not in ("done", "skipped") and step.scan is None:
                cause = step.refused.code if step.refused is not None else f"{step.do}-{step.state}"
                self._count("failures", "", cause[:MAX_CAUSE], 1)
        if report.state == "failed" and all(step.state == "done" for step in report.steps):
            self._count("failures", "", "not-begun", 1)
        self._write_within(0)

    def _count_move(self, name: str, axis: AxisRecording, t0_fleet_ns: int, *, done: bool) -> None:
        profile = axis.profile
        moved_counts, moving_s = profile.end_counts - profile.start_counts, profile.duration_s
        if not done:
            # It was stopped: the last reading is the best that is known.
            last_ns, last_counts = axis.sampled[-1] if axis.sampled else (t0_fleet_ns, profile.start_counts)
            moved_counts = last_counts - profile.start_counts
            moving_s = min(moving_s, max(0.0, (last_ns - t0_fleet_ns) / NS_PER_S))
        direction = (moved_counts > 0) - (moved_counts < 0)
        if direction:
            self._count("axis", name, "moves", 1)
            if self._directions.get(name, direction) != direction:
                self._count("axis", name, "reversals", 1)
            self._directions[name] = direction
            self._count("axis", name, f"distance {axis.unit}", abs(moved_counts / axis.counts_per_unit))
        self._count("axis", name, "moving_s", moving_s)
        self._write_within(MOTION_NS)

    def _count_skews(self, report: StepReport) -> None:
        starts = {
            member: [evidence.start_for_verdict for evidence in part.evidence.values()]
            for member, part in sorted(report.members.items())
            if part.evidence
        }
        groups = (
            {"+".join(pair): pair for pair in combinations(starts, 2)}
            if len(starts) <= MOST_PAIRED
            else {f"{len(starts)} controllers": tuple(starts)}
        )
        for subject, members in groups.items():
            skew = measure_skew([start for member in members for start in starts[member]], report.budget)
            if skew is not None:
                skew_ns = skew.at_most_ns
                self._count("pair", subject, "moves", 1)
                self._count("pair", subject, "sum_ns", skew_ns)
                self._count("pair", subject, f"bin {find_bin(skew_ns)}", 1)
                self._count("pair", subject, f"{WORST}_ns", skew_ns)

    def _take_event(self, event: ControllerEvent) -> None:
        if event.kind in ("fault", "offline") and event.controller in self._access.view.fleet.controllers:
            code = event.fault.code if event.fault is not None else event.kind
            self._count("controller", event.controller, f"fault {code[:MAX_CAUSE]}", 1)
            self._write_within(MOTION_NS)

    def _count(self, kind: str, subject: str, figure: str, value: float) -> None:
        self._add((self._access.clock.utc()[:10], kind, subject, figure), value)

    def _add(self, key: FigureKey, value: float) -> None:
        figure = key[3]
        count = self._counted.get(key)
        if count is None and len(self._counted) >= MAX_FIGURES:
            return
        self._counted[key] = max(count or 0.0, value) if figure.startswith(WORST) else (count or 0.0) + value

    # Journal

    def _write_within(self, time_ns: int) -> None:
        self._due_ns = min(self._due_ns, self._access.clock.now_ns() + time_ns)

    async def _run(self) -> None:
        tick = keep_apart(self._access.tasks, self._clock.tick)
        while True:
            await sleep_ns(self._access.clock, TICK_NS)
            tick()
            if self._access.clock.now_ns() >= self._due_ns:
                try:
                    await self._write()
                except EpochOvertaken:
                    return
                except JournalError:
                    continue  # and again a minute later

    async def _write(self) -> None:
        counts, self._counted = self._counted, {}
        self._due_ns = self._access.clock.now_ns() + AVAILABILITY_NS
        rows = [StatisticsRow(*key, value) for key, value in counts.items()]
        if not rows:
            return
        try:
            await self._execute(self._table.add_rows, rows)
        except BaseException:
            later_counts, self._counted = self._counted, counts
            for key, value in later_counts.items():
                self._add(key, value)
            raise

    async def read_statistics(self, request: ReadStatistics) -> StatisticsRead:
        """The statistics, with what is not written yet. Raises `Refusal`, `JournalError`."""
        self._clock.tick()
        with suppress(JournalError):
            await self._write()
        rows: Sequence[StatisticsRow] = await self._execute(self._table.read_rows, request.since)
        if len(rows) > MAX_ROWS:
            raise Refusal("too-much", f"there are {len(rows)} figures since {request.since}", "choose a later day")
        units = {name: self._access.view.fleet.axis(name).unit for name in self._access.view.fleet.axis_names}
        total, days = make_periods(rows, units)
        return StatisticsRead(since=request.since, total=total, days=days if request.by_day else [])
