"""The store of points, the rows of points, and the report of a scan: quotas, damage, parts that broke off, memory."""

import asyncio
import hashlib
import sqlite3
import tracemalloc
from collections.abc import Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from random import Random
from struct import pack

import numpy as np
import pytest

from orchestrator.clock.executor import run_inline
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.jobs.run.point_feed import PointFeed
from orchestrator.coordinator.jobs.run.report_collector import ReportCollector
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.journal.records import DamagedRecord, JournalError
from orchestrator.coordinator.journal.sql.point_store import PointStore
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.points import open_points
from orchestrator.coordinator.statistics.skew_histogram import SkewHistogram
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import format_utc, parse_utc
from orchestrator.model.report import PointRecord, SkewInterval, StepReport
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.order import StepOrder
from orchestrator.model.steps.points import PointAxis, make_header
from orchestrator.model.steps.scan import Scan
from orchestrator.model.units import Unit

AXES = [PointAxis(axis="gantry.x", unit=Unit.MM), PointAxis(axis="stage.u", unit=Unit.MM)]
FLEET = load_fleet(Path(__file__).parents[3] / "deploy" / "examples" / "demo.fleet.yaml")
NOON = "2026-11-26T12:00:00.000000Z"


def later(minutes: float) -> str:
    return format_utc(parse_utc(NOON) + timedelta(minutes=minutes))


def make_points(count: int, scale: float = 0.1) -> tuple[str, bytes]:
    rows = np.column_stack([np.arange(count) * scale, np.arange(count) % 7]).astype("<f8").tobytes()
    return f"sha256:{hashlib.sha256(make_header(AXES) + rows).hexdigest()}", rows


def store_points(store: PointStore, count: int, scale: float = 0.1, part: int = 1600) -> str:
    digest, rows = make_points(count, scale)
    state = store.begin_upload(digest, AXES, count, NOON, [])
    while state.columns is None:
        state = store.add_part(digest, state.received, rows[state.received : state.received + part], NOON)
    return digest


def test_points_come_back_from_any_part() -> None:
    store = PointStore(open_points(":memory:"))
    digest = store_points(store, 1000)
    assert store.read_rows(digest, 0, 2) == [(0.0, 0.0), (0.1, 1.0)]
    assert store.read_rows(digest, 95, 10) == [(k * 0.1, k % 7) for k in range(95, 105)]
    assert len(store.read_rows(digest, 990, 4096)) == 10
    columns = store.begin_upload(digest, AXES, 1000, NOON, []).columns
    assert columns is not None and (columns[0].most, columns[0].most_at) == (99.9, 1000)


def test_an_upload_that_broke_off_is_continued_or_deleted_after_an_hour() -> None:
    store = PointStore(open_points(":memory:"))
    digest, rows = make_points(300)
    store.begin_upload(digest, AXES, 300, NOON, [])
    assert store.add_part(digest, 0, rows[:1600], NOON).received == 1600
    # A repeated part, and one after a gap, change nothing.
    assert store.add_part(digest, 0, rows[:1600], NOON).received == 1600
    assert store.add_part(digest, 3200, rows[3200:], NOON).received == 1600
    assert store.begin_upload(digest, AXES, 300, later(30), []).received == 1600
    store_points(store, 10)
    store.delete_unused([], later(89))
    assert store.used_bytes == 4800
    store.delete_unused([], later(91))
    assert store.used_bytes == 0
    with pytest.raises(Refusal, match="begin it again"):
        store.add_part(digest, 1600, rows[1600:], later(91))


def test_points_that_jobs_name_stay_and_count_against_the_quota() -> None:
    store = PointStore(open_points(":memory:"), quota_bytes=10_000)
    kept = store_points(store, 600)
    digest, _ = make_points(100, 0.2)
    with pytest.raises(Refusal, match="the points need 1600 B; 9600 B of 10000 B for points are in use") as full:
        store.begin_upload(digest, AXES, 100, later(90), [kept])
    assert full.value.code == "point-store-full"
    # Without a job that names them they make room.
    assert store.begin_upload(digest, AXES, 100, later(90), []).received == 0


def test_points_that_are_not_those_announced_are_refused_and_deleted() -> None:
    store = PointStore(open_points(":memory:"))
    digest, rows = make_points(10)
    store.begin_upload(digest, AXES, 10, NOON, [])
    with pytest.raises(Refusal, match="are not those that were announced"):
        store.add_part(digest, 0, rows[::-1], NOON)
    endless = pack("<4d", 1.0, 2.0, 3.0, float("nan"))
    name = f"sha256:{hashlib.sha256(make_header(AXES) + endless).hexdigest()}"
    store.begin_upload(name, AXES, 2, NOON, [])
    with pytest.raises(Refusal, match=r"point 2: the position of stage\.u is nan"):
        store.add_part(name, 0, endless, NOON)
    assert store.used_bytes == 0


def test_a_bit_that_changed_on_the_disk_moves_nothing(tmp_path: Path) -> None:
    database = open_points(str(tmp_path / "points"))
    digest = store_points(PointStore(database), 300)
    database.close()
    with sqlite3.connect(tmp_path / "points") as db:
        (data,) = db.execute("SELECT data FROM parts WHERE begin = 1600").fetchone()
        db.execute("UPDATE parts SET data = ? WHERE begin = 1600", (data[:99] + bytes([data[99] ^ 1]) + data[100:],))
    db.close()
    database = open_points(str(tmp_path / "points"))
    store = PointStore(database)
    assert len(store.read_rows(digest, 0, 100)) == 100
    with pytest.raises(DamagedRecord, match="have changed on the disk"):
        store.read_rows(digest, 100, 10)
    with pytest.raises(JournalError, match="are not stored any more"):
        store.read_rows(f"sha256:{'0' * 64}", 0, 1)
    database.close()


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
