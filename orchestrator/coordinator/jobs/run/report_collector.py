"""The reports of a running job: one for each step, and one for each scan, or live step, whose points it sums up.

The points themselves are rows, which are handed on as soon as they are final. Memory does not grow with the points.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from orchestrator.clock.base import NS_PER_S, Clock, ClockTimer
from orchestrator.coordinator.jobs.run.flown_rows import make_line_rows
from orchestrator.coordinator.jobs.run.point_feed import PointFeed
from orchestrator.coordinator.motion.budget import worse_verdict
from orchestrator.coordinator.statistics.skew_histogram import SkewHistogram
from orchestrator.model.report import ArmedReport, PointFinding, PointRecord, ScanSummary, StepReport, Verdict
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.order import StepPlace
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.flying.lines import FlownLines

MAX_FINDINGS = 10  # points that are not green and stand in the report
LAST_READING_NS = NS_PER_S  # a row is final at the latest this time after its point: its axes may stand there for long


class PositionReader(Protocol):
    """Reads the positions of axes at a point, from its move's end on."""

    def begin_point(self, target: Mapping[str, float]) -> None: ...

    def read_positions(self) -> dict[str, float | None]: ...


@dataclass(slots=True)
class _ScanProgress:
    """What the points of a scan have done so far; of a live step, what it was asked for. place: of the present point.
    begun_ns: of the scan; point_ns: of the present point."""

    place: StepPlace
    scan: Scan | Live
    begun_ns: int
    point_ns: int
    points: int = 0
    steps_done: int = 0
    verdicts: dict[Verdict, int] = field(default_factory=dict[Verdict, int])
    worst: Verdict = "none"
    skews: SkewHistogram = field(default_factory=SkewHistogram)
    worst_report: StepReport | None = None
    findings: list[PointFinding] = field(default_factory=list[PointFinding])
    least_ns: int | None = None
    most_ns: int = 0
    moved: StepReport | None = None
    waited: ArmedReport | None = None
    ended: tuple[StepPlace, StepReport] | None = None


class ReportCollector:
    """Takes the report of every step. feed: takes the rows of points."""

    def __init__(self, clock: Clock, feed: PointFeed, readings: PositionReader) -> None:
        self._clock = clock
        self._feed = feed
        self._readings = readings
        self._reports: list[StepReport] = []
        self._scan: _ScanProgress | None = None
        self._rows: list[PointRecord] = []
        self._last_motion: StepReport | None = None
        self._last_row: PointRecord | None = None
        """Of the last point, for which readings still come."""
        self._close_timer: ClockTimer | None = None

    @property
    def reports(self) -> list[StepReport]:
        """The reports so far, in the order of the steps."""
        return [*self._reports, *self._make_scan_reports()]

    @property
    def last_motion(self) -> StepReport | None:
        """The report of the motion step that ended last."""
        return self._last_motion

    def begin_step(self, place: StepPlace) -> None:
        """A step begins."""
        if self._scan is not None and (place.point is None or place.first != self._scan.place.first):
            self._reports += self._make_scan_reports()
            self._scan = None
        if place.series is not None and self._scan is None:
            now_ns = self._clock.now_ns()
            self._scan = _ScanProgress(place, place.series, now_ns, now_ns)
        if self._scan is not None:
            self._scan.place, self._scan.ended = place, None  # what a live job goes on behind is not its end

    async def add_report(self, place: StepPlace, report: StepReport, target: Mapping[str, float]) -> None:
        """Take the report of a step that has begun. target: of the point it belongs to. Raises `JournalError`."""
        scan = self._scan
        if report.t0_fleet_ns is not None:
            self._last_motion = report
        if scan is None:
            self._reports.append(report)
            self._close_row()
            await self._write_rows_in_turn()
            return
        if place.part == 0:
            scan.moved = report
            self._hand_on_last_row()
            self._readings.begin_point(target)
        scan.steps_done += report.state == "done"
        if report.state != "done":
            scan.ended = place, report
        if report.state != "done" or place.part == scan.scan.points_steps - 1:
            self._end_point(scan, place, report, target)
            await self._write_rows_in_turn()

    async def add_line_report(self, place: StepPlace, report: StepReport, lines: FlownLines, begin: int) -> None:
        """Take the report of a step of a line that is flown. lines: of its scan. begin: the first point of the line
        without a row. Raises `JournalError`."""
        scan = self._scan
        assert scan is not None
        self._hand_on_last_row()
        if report.t0_fleet_ns is not None:
            self._last_motion = report
        scan.waited = scan.waited or report.waited_armed
        scan.steps_done += report.state == "done"
        if report.state != "done":
            scan.ended = place, report
        elif not place.is_flown_path:
            return
        self._end_line(scan, report, make_line_rows(place, report, lines, begin))
        await self._write_rows_in_turn()

    async def add_flown_rows(self, rows: Sequence[PointRecord], text: str = "") -> None:
        """Take rows of a flight, whose verdicts are alike, while it flies and behind it. Raises `JournalError`."""
        if self._scan is None or not rows:
            return
        self._take_rows(self._scan, rows, text)
        if rows[0].took_s is not None:
            _note_time(self._scan, round(rows[0].took_s * NS_PER_S))
        await self._write_rows_in_turn()

    async def end_flight(self, place: StepPlace, report: StepReport, steps: int) -> None:
        """Take the report of a flight, and write its rows. steps: of the scan, that it stands for. Raises
        `JournalError`."""
        scan = self._scan
        assert scan is not None
        scan.point_ns = self._clock.now_ns()
        scan.waited = scan.waited or report.waited_armed
        if report.t0_fleet_ns is not None:
            self._last_motion = report
            self._note_skew(scan, report)
        scan.steps_done += steps
        if report.state not in ("done", "stopped"):
            scan.ended = place, report
        await self._feed.finish()

    async def finish(self) -> None:
        """Hand on and write what was recorded until now. Raises `JournalError`."""
        self._close_row()
        self._hand_on_rows()
        await self._feed.finish()

    def _close_row(self) -> None:
        """The row of the last point is final: its axes have left, or have stood there for long enough."""
        if self._close_timer is not None:
            self._close_timer.cancel()
            self._close_timer = None
        if self._last_row is not None:
            self._rows.append(self._last_row.model_copy(update={"measured": self._readings.read_positions()}))
            self._last_row = None

    def _hand_on_rows(self) -> None:
        rows, self._rows = self._rows, []
        self._feed.add_rows(rows)

    async def _write_rows_in_turn(self) -> None:
        """Hand on the rows so far; they are written if they are many, or have waited."""
        self._hand_on_rows()
        await self._feed.write_in_turn()

    def _hand_on_last_row(self) -> None:
        self._close_row()
        self._hand_on_rows()

    def _end_point(self, now: _ScanProgress, place: StepPlace, report: StepReport, target: Mapping[str, float]) -> None:
        assert place.point is not None
        took_ns, moved_report = self._clock.now_ns() - now.point_ns, now.moved
        now.point_ns += took_ns
        is_judged = moved_report is not None and report.state == "done"
        verdict: Verdict = moved_report.verdict if moved_report is not None and is_judged else "none"
        now.worst = worse_verdict(now.worst, verdict)
        now.verdicts[verdict] = now.verdicts.get(verdict, 0) + 1
        skew = None
        if moved_report is not None:
            skew = moved_report.narrowest_skew
            self._note_skew(now, moved_report)
            if verdict in ("amber", "red") and len(now.findings) < MAX_FINDINGS:
                text = "; ".join(moved_report.deviations) or moved_report.reason
                now.findings.append(PointFinding(point=place.point + 1, verdict=verdict, text=text))
        if report.state == "done":
            now.points += 1
            _note_time(now, took_ns)
        self._last_row = PointRecord(
            step=place.first,
            point=place.point + 1,
            state=report.state,
            verdict=verdict,
            t0_fleet_ns=None if moved_report is None else moved_report.t0_fleet_ns,
            start_skew=skew,
            took_s=took_ns / NS_PER_S,
            target=dict(target),
            measured={},
        )
        self._close_timer = self._clock.call_at_ns(self._clock.now_ns() + LAST_READING_NS, self._hand_on_last_row)
        now.moved = None

    def _end_line(self, now: _ScanProgress, report: StepReport, rows: Sequence[PointRecord]) -> None:
        """Take the rows of a line that is over; of one that was not done, as far as it was flown, none is good."""
        took_ns = self._clock.now_ns() - now.point_ns
        now.point_ns += took_ns
        self._take_rows(now, rows, "; ".join(report.deviations) or report.reason)
        self._note_skew(now, report)
        if report.state == "done":
            _note_time(now, took_ns // len(rows))

    def _take_rows(self, now: _ScanProgress, rows: Sequence[PointRecord], text: str) -> None:
        """Take rows of points that were flown, whose verdicts are alike. text: what is wrong, if the verdict says
        so."""
        self._feed.add_rows(rows)
        verdict = rows[0].verdict
        now.worst = worse_verdict(now.worst, verdict)
        now.verdicts[verdict] = now.verdicts.get(verdict, 0) + len(rows)
        now.points += sum(row.state == "done" for row in rows)
        if verdict in ("amber", "red") and len(now.findings) < MAX_FINDINGS:
            now.findings.append(PointFinding(point=rows[0].point, verdict=verdict, text=text))

    def _note_skew(self, now: _ScanProgress, moved: StepReport) -> None:
        skew = moved.narrowest_skew
        if skew is None:
            return
        if skew.at_most_ns > now.skews.worst_ns or now.worst_report is None:
            now.worst_report = moved
        now.skews.add_skew(skew.at_most_ns)

    def _make_scan_reports(self) -> list[StepReport]:
        """The report of the scan that runs, or ended last, and of its point that was not done."""
        scan = self._scan
        if scan is None:
            return []
        summary = ScanSummary(
            points=scan.place.point_count or 0,
            done=scan.points,
            steps_done=scan.steps_done,
            verdicts=dict(scan.verdicts),
            start_skew_worst_ns=scan.skews.worst_ns if scan.skews.count else None,
            start_skew_p50_ns=scan.skews.find_quantile(0.5),
            start_skew_p99_ns=scan.skews.find_quantile(0.99),
            not_green=list(scan.findings),
            least_s=None if scan.least_ns is None else scan.least_ns / NS_PER_S,
            mean_s=None if not scan.points else (scan.point_ns - scan.begun_ns) / NS_PER_S / scan.points,
            most_s=None if scan.least_ns is None else scan.most_ns / NS_PER_S,
        )
        worst = scan.worst_report
        report = StepReport(
            index=scan.place.first,
            do=scan.scan.kind,
            name=scan.scan.name or "",
            state="done",
            actual_s=(scan.point_ns - scan.begun_ns) / NS_PER_S,
            budget=None if worst is None else worst.budget,
            start_skew=None if worst is None else worst.narrowest_skew,
            verdict=scan.worst,
            waited_armed=scan.waited,
            scan=summary,
        )
        if scan.ended is None:
            return [report]
        location, ended_report = scan.ended
        reason = f"{location.describe()}: {ended_report.reason}"
        changes = {"state": ended_report.state, "reason": reason, "verdict": "none"}
        return [report.model_copy(update=changes), ended_report]


def _note_time(now: _ScanProgress, took_ns: int) -> None:
    """A point took so long."""
    now.least_ns = took_ns if now.least_ns is None else min(now.least_ns, took_ns)
    now.most_ns = max(now.most_ns, took_ns)
