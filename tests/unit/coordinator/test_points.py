"""The rows of points, the report of a scan, and its memory."""

import asyncio
import tracemalloc
from collections.abc import Mapping, Sequence
from pathlib import Path
from random import Random

import pytest
from unit.journal.stored_points import AXES, NOON, store_points

from orchestrator.clock.executor import run_inline
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.jobs.run.point_feed import PointFeed
from orchestrator.coordinator.jobs.run.report_collector import ReportCollector
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.statistics.skew_histogram import SkewHistogram
from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import PointRecord, SkewInterval, StepReport
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.order import StepOrder
from orchestrator.model.steps.scan import Scan

FLEET = load_fleet(Path(__file__).parents[3] / "deploy" / "examples" / "demo.fleet.yaml")


def test_quantiles_are_within_their_resolution() -> None:
    draw, histogram = Random(4), SkewHistogram()
    values = sorted(round(draw.lognormvariate(14, 1)) for _ in range(10_000))
    for each in values:
        histogram.add_skew(each)
    assert histogram.worst_ns == values[-1]
    for part in (0.5, 0.99):
        exact, found = values[round(part * 10_000) - 1], histogram.find_quantile(part)
        assert found is not None and exact <= found <= exact * 1.021
    assert SkewHistogram().find_quantile(0.5) is None


def make_job(steps: str) -> Job:
    return parse_document(f"schema: tutti.job/1\nname: test\nsteps: {steps}\n", Job, "test")


class Readings:
    """Each axis is read where it is sent."""

    def begin_point(self, target: Mapping[str, float]) -> None:
        self.target = target

    def read_positions(self) -> dict[str, float | None]:
        return dict(self.target)


def run_scan(points: int, fail_at: int | None = None) -> tuple[list[StepReport], int, list[PointRecord]]:
    """Take the reports of a scan whose every seventh point is amber; return its reports, the peak of memory in bytes,
    and the first rows."""
    given = make_job(f"[{{do: scan, axes: {{gantry.x: {{from: 0, to: 100, points: {points}}}}}}}]")
    journal = SqliteJournal(":memory:")
    rows: list[PointRecord] = []
    written = 0

    async def store(records: Sequence[PointRecord]) -> None:
        nonlocal written
        written += len(records)
        rows.extend(records[: 30 - len(rows)])

    async def main(clock: VirtualClock) -> list[StepReport]:
        sequence = StepSequence(StepOrder(given.steps), FLEET, journal.points, run_inline)
        collector = ReportCollector(clock, PointFeed(clock, lambda _: None, store), Readings())
        for index in range(len(sequence)):
            place, step = sequence.locate(index), await sequence.read_step(index)
            assert isinstance(step, Move)
            collector.begin_step(place)
            await asyncio.sleep(0.01)
            skew = SkewInterval(at_least_ns=0, at_most_ns=1_000_000 + index)
            report = StepReport(
                index=index,
                do="move",
                name="",
                state="failed" if index == fail_at else "done",
                reason="stalled" if index == fail_at else "",
                start_skew=skew,
                verdict="amber" if index % 7 == 6 else "green",
            )
            await collector.add_report(place, report, sequence.find_target(place))
            if index == fail_at:
                break
        await collector.finish()
        return collector.reports

    tracemalloc.start()
    try:
        reports = run_virtual(main)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        journal.close()
    assert written == (points if fail_at is None else fail_at + 1)
    return reports, peak, rows


def test_the_report_of_a_scan_sums_up_its_points() -> None:
    (report,), _, rows = run_scan(1000)
    assert (report.do, report.state, report.verdict) == ("scan", "done", "amber")
    scan = report.scan
    assert scan is not None and (scan.points, scan.done, scan.verdicts) == (1000, 1000, {"green": 858, "amber": 142})
    assert scan.start_skew_worst_ns == 1_000_999 and report.start_skew is not None
    assert [each.point for each in scan.not_green] == [7 * k for k in range(1, 11)]
    assert scan.mean_s == pytest.approx(0.01) and scan.most_s == pytest.approx(0.01)
    assert rows[1].target == {"gantry.x": pytest.approx(100 / 999)} and rows[1].took_s == pytest.approx(0.01)


def test_a_point_that_fails_has_its_own_report_behind_that_of_the_scan() -> None:
    (summary, failed), _, _ = run_scan(50, fail_at=20)
    assert (summary.state, summary.reason) == ("failed", "step 1 (scan), point 21 of 50 (move): stalled")
    assert summary.scan is not None and (summary.scan.done, summary.steps_done) == (20, 20)
    assert (failed.index, failed.do, failed.state) == (20, "move", "failed")


def test_memory_does_not_grow_with_the_points() -> None:
    run_scan(200)  # what is made once
    small, large = run_scan(300)[1], run_scan(3000)[1]
    assert large < small + 50_000, (small, large)


def test_stored_points_are_read_in_blocks() -> None:
    journal = SqliteJournal(":memory:")
    store = journal.points
    digest = store_points(store, 10_000, part=80_000)
    state = store.begin_upload(digest, AXES, 10_000, NOON, [])
    assert state.columns is not None
    table = {"digest": digest, "count": 10_000, "columns": [each.to_plain() for each in state.columns]}
    scan = Scan.model_validate({"do": "scan", "points": table})
    reads: list[int] = []

    async def execute(function, *values):  # type: ignore[no-untyped-def]
        reads.append(values[1])
        return function(*values)

    async def main(_: VirtualClock) -> None:
        sequence = StepSequence(StepOrder([scan]), FLEET, store, execute)
        for index in (0, 1, 4095, 4096, 9999, 9998):
            step = await sequence.read_step(index)
            assert isinstance(step, Move) and step.to == {"gantry.x": index * 0.1, "stage.u": float(index % 7)}
        # The next point is in memory too, for what looks ahead.
        assert reads == [0, 4096, 8192]
        with pytest.raises(KeyError):
            sequence[0]
        await sequence.read_step(4095)
        ahead = sequence[4096]
        assert isinstance(ahead, Move) and ahead.to["gantry.x"] == 4096 * 0.1 and reads[3:] == [0, 4096]

    run_virtual(main)
    journal.close()
