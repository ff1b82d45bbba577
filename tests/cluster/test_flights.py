"""Lines of a scan that are flown in one motion: time, windows by truth, pauses, overrides, and chunks that are late."""

import asyncio
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from _pytest.mark.structures import ParameterSet
from cluster.test_contour import two_gantries
from cluster.test_flying_scans import Truth, fly, fly_all, path_fleet, prepare, wait_for_state
from cluster.test_paths import delay_chunks
from cluster.test_triggers import TrueEdges
from cluster.worlds import job, origin_host_ns, outcome, run_fleet, wait_for_point

from orchestrator.bus.base import BusSample
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.jobs.run import scan_flights
from orchestrator.coordinator.jobs.run.trigger_watch import TriggerWatch
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.recording import JobPoints
from orchestrator.model.report import JobReport, PointRecord
from orchestrator.runtime.virtual.fleet import VirtualFleet

SPACING = 0.5


def raster(
    lines: int, points: int, duration: str, outer: str = "gantry.x", flown: str = "gantry.y", more: str = ""
) -> str:
    """A scan of lines that snake, with points 0.5 mm apart."""
    axes = (
        f"{{{outer}: {{from: 50, to: {50 + SPACING * (lines - 1):g}, points: {lines}}}, "
        f"{flown}: {{from: 20, to: {20 + SPACING * (points - 1):g}, points: {points}, snake: true}}}}"
    )
    return f"{{do: scan, axes: {axes}, fly: {{duration: {duration}{more}}}}}"


def check_position(row: PointRecord, truth: Truth, axis: str) -> tuple[float, float]:
    """A row contains where an axis was at the centre of the interval of its point; return between which positions."""
    assert row.window is not None
    centre_ns = (row.window.middle.earliest_ns + row.window.middle.latest_ns) / 2
    low, high = row.window.positions[axis]
    assert low <= np.interp(centre_ns / NS_PER_S, truth.times_s, truth.places) <= high, (row.point, low, high)
    return low, high


def check_windows(
    rows: Sequence[PointRecord], truth: Truth, axis: str, late_s: float = 0.0, spacing: float = SPACING
) -> None:
    """Each good row contains the truth, and its window was flown at its speed."""
    for row in rows:
        assert row.good and row.window is not None and row.took_s is not None, row
        crossings: list[float] = []
        intervals = (row.window.lower, row.window.middle, row.window.upper)
        begin_s, end_s = intervals[0].earliest_ns / NS_PER_S - 0.003, intervals[2].latest_ns / NS_PER_S + 0.003
        inside = (truth.times_s >= begin_s) & (truth.times_s <= end_s)
        ends = truth.places[inside][[0, -1]]
        direction = 1.0 if ends[1] > ends[0] else -1.0
        for part, interval in zip((-0.5, 0.0, 0.5), intervals, strict=True):
            at_s = truth.find_crossing(row.target[axis] + direction * part * spacing, begin_s, end_s)
            assert interval.earliest_ns <= at_s * NS_PER_S <= interval.latest_ns, (row.point, part)
            crossings.append(at_s)
        check_position(row, truth, axis)
        error = abs((crossings[2] - crossings[0]) / row.took_s - 1)
        assert error <= max(0.005, 1.2 * truth.count / spacing, late_s / row.took_s), (row.point, error)
        # And at one speed: each half took half of the time.
        halves = np.diff(crossings) / row.took_s * 2
        error = float(np.abs(halves - 1).max())
        assert error <= max(0.006, 2.4 * truth.count / spacing, 2 * late_s / row.took_s), (row.point, error)


def test_an_axis_that_stands_in_the_windows_is_where_the_rows_have_it() -> None:
    async def main(fleet: VirtualFleet) -> None:
        _, rows, truth = await fly(fleet, f"[{raster(4, 41, '10 ms', 'portal.x')}]", "portal.x")
        assert len(rows) == 4 * 41
        for row in rows:
            low, high = check_position(row, truth, "portal.x")
            assert high - low < 0.1, "a bound, and no wide one"

    run_fleet(main, two_gantries())


def count_motions(report: JobReport) -> int:
    (scan,) = (step for step in report.steps if step.scan is not None)
    assert scan.scan is not None
    return scan.scan.steps_done


def whole(make: Callable[[], Fleet], outer: str, flown: str, late_s: float) -> ParameterSet:
    """41 lines of 101 points, 10 ms each."""
    return pytest.param(make, outer, flown, late_s, 41, 101, 10, marks=pytest.mark.nightly)


@pytest.mark.parametrize(
    ("make", "outer", "flown", "late_s", "lines", "points", "window_ms"),
    [
        (two_gantries, "gantry.x", "gantry.y", 0.0, 15, 41, 20),
        (two_gantries, "portal.x", "gantry.y", 0.0, 15, 41, 20),
        (path_fleet, "slide.y", "gantry.x", 0.0, 15, 41, 20),
        (path_fleet, "gantry.x", "slide.y", 0.0004, 15, 41, 20),
        whole(two_gantries, "portal.x", "gantry.y", 0.0),
        whole(path_fleet, "slide.y", "gantry.x", 0.0),
        whole(path_fleet, "gantry.x", "slide.y", 0.0004),
    ],
)
def test_a_raster_is_one_motion_that_takes_its_windows_and_its_turns(
    make: Callable[[], Fleet], outer: str, flown: str, late_s: float, lines: int, points: int, window_ms: int
) -> None:
    async def main(fleet: VirtualFleet) -> None:
        report, rows, truth = await fly(fleet, f"[{raster(lines, points, f'{window_ms} ms', outer, flown)}]", flown)
        assert report.state == "done" and report.verdict == "green", report.reason
        assert [row.point for row in rows] == list(range(1, lines * points + 1))
        check_windows(rows, truth, flown, late_s)
        speed, limits = SPACING / window_ms * 1000, fleet.fleet.axis(flown).limits
        turn_s = 2 * speed / limits.acceleration + limits.acceleration / (limits.jerk or np.inf)
        spent_s = rows[-1].window.upper.latest_ns - rows[0].window.lower.earliest_ns  # pyright: ignore
        asked_s = lines * points * window_ms / 1000 + (lines - 1) * turn_s
        assert spent_s / NS_PER_S <= 1.1 * asked_s

    run_fleet(main, make())


@pytest.mark.parametrize(
    ("make", "outer", "flown", "late_s"),
    [
        (two_gantries, "portal.x", ("gantry.x", "gantry.y"), 0.0),
        (two_gantries, "portal.x", ("portal.y", "gantry.y"), 0.0),
        (path_fleet, "lift.z", ("slide.y", "gantry.x"), 0.0004),
    ],
)
def test_axes_fly_together_along_one_line(
    make: Callable[[], Fleet], outer: str, flown: tuple[str, str], late_s: float
) -> None:
    axes = f"{outer}: {{from: 2, to: 6, points: 3}}"
    spacings = (0.2, SPACING)
    for axis, spacing in zip(flown, spacings, strict=True):
        axes += f", {axis}: {{from: 30, to: {30 + 20 * spacing:g}, points: 21, snake: true}}"
    scan = f"{{do: scan, axes: {{{axes}}}, fly: {{axis: [{', '.join(flown)}], duration: 25 ms}}}}"

    async def main(fleet: VirtualFleet) -> None:
        report, rows, truths = await fly_all(fleet, f"[{scan}]", flown)
        assert report.state == "done" and report.verdict == "green", report.reason
        assert [row.point for row in rows] == list(range(1, 64))
        for axis, spacing, truth in zip(flown, spacings, truths, strict=True):
            check_windows(rows, truth, axis, late_s, spacing)

    run_fleet(main, make())


CURVE_POINTS = 20
ARC = np.pi * (0.25 + np.linspace(0.0, 1.0, 2 * CURVE_POINTS + 1) ** 1.2)
KNOTS = np.round(40 + 6 * np.stack([np.cos(ARC), np.sin(ARC)], axis=1), 4)
"""Of half a circle, whose windows become longer: at the beginning of each, in its middle, and at the end of the last."""


def curve(outer: str, flown: Sequence[str]) -> str:
    """The axes of a scan along `KNOTS`, to and fro."""
    axes = [outer] if outer else []
    for axis, knots in zip(flown, KNOTS.T.tolist(), strict=True):
        axes.append(f"{axis}: {{values: {knots[1::2]}, bounds: {knots[::2]}, snake: true}}")
    return f"{{{', '.join(axes)}}}"


def check_curve(
    rows: Sequence[PointRecord], truths: Sequence[Truth], flown: Sequence[str], late_s: float = 0.0
) -> None:
    """Each good row contains the truth of the axes that are not slow in its window, which took its time."""
    for row in rows:
        assert row.good and row.window is not None and row.took_s is not None, row
        line, number = divmod(row.point - 1, CURVE_POINTS)
        knots = (KNOTS[::-1] if line % 2 else KNOTS)[2 * number : 2 * number + 3]
        intervals = (row.window.lower, row.window.middle, row.window.upper)
        begin_s, end_s = intervals[0].earliest_ns / NS_PER_S - 0.003, intervals[2].latest_ns / NS_PER_S + 0.003
        for axis, truth, positions in zip(flown, truths, knots.T.tolist(), strict=True):
            check_position(row, truth, axis)
            ways = np.diff(positions)
            if ways[0] * ways[1] <= 0.0 or np.abs(ways).min() < 0.15:
                continue
            direction = np.sign(ways[0])
            moved = Truth(truth.times_s, truth.places * direction, truth.count)
            crossings = [moved.find_crossing(position * direction, begin_s, end_s) for position in positions]
            for at_s, interval in zip(crossings, intervals, strict=True):
                assert interval.earliest_ns <= at_s * NS_PER_S <= interval.latest_ns, row.point
            error = abs((crossings[2] - crossings[0]) / row.took_s - 1)
            assert error <= max(0.005, 2.4 * truth.count / abs(ways.sum()), late_s / row.took_s), (row.point, error)


@pytest.mark.parametrize(
    ("make", "outer", "flown", "late_s"),
    [
        (two_gantries, "", ("gantry.x", "gantry.y"), 0.0),
        (path_fleet, "lift.z: {values: [2, 4]}", ("slide.y", "gantry.x"), 0.0004),
    ],
)
def test_a_curve_is_flown_through_its_windows(
    make: Callable[[], Fleet], outer: str, flown: tuple[str, str], late_s: float
) -> None:
    scan = f"{{do: scan, axes: {curve(outer, flown)}, fly: {{axis: [{', '.join(flown)}], duration: 60 ms}}}}"

    async def main(fleet: VirtualFleet) -> None:
        report, rows, truths = await fly_all(fleet, f"[{scan}]", flown)
        assert report.state == "done" and report.verdict == "green", report.reason
        assert [row.point for row in rows] == list(range(1, len(rows) + 1)) and len(rows) in (20, 40)
        check_curve(rows, truths, flown, late_s)

    run_fleet(main, make())


def test_a_curve_is_paused_and_flown_again_from_the_window_that_was_broken() -> None:
    flown = ("gantry.x", "gantry.y")
    fly_field = "{axis: [gantry.x, gantry.y], duration: 60 ms, trigger: {output: gantry.camera}}"
    scan = f"{{do: scan, axes: {curve('portal.x: {values: [2, 4, 6, 8]}', flown)}, fly: {fly_field}}}"

    async def main(fleet: VirtualFleet) -> None:
        true = TrueEdges(fleet, "gantry", (("gantry.x", "gantry", "X"), ("gantry.y", "gantry", "Y")), 1)
        job_id = await begin_flight(fleet, scan, 30)
        client = fleet.make_client()
        await client.pause_job(job_id, now=True)
        await wait_for_state(fleet, job_id, "paused")
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        again = await client.retry_job(job_id, (0, 65))
        assert (await client.wait_for_job(again.job_id)).state == "done"
        rows = [row for flown_id in (job_id, again.job_id) for row in await client.load_points(flown_id) if row.good]
        assert [row.point for row in rows] == [*range(1, 81), *range(61, 81)]
        places = [place for place, (_, level) in zip(true.places, true.edges, strict=True) if level]
        for row in rows:
            # An edge comes within some ms of its instant, at 20 mm/s.
            offs = [np.hypot(*(place[axis] - row.target[axis] for axis in flown)) for place in places]
            assert min(offs) < 0.1, (row.point, min(offs))

    run_fleet(main, with_camera(two_gantries(), "gantry"))


async def begin_flight(fleet: VirtualFleet, steps: str, point: int) -> str:
    """Submit a flight, and return its job when it flies through a point."""
    await outcome(fleet, prepare(fleet))
    job_id = await fleet.make_client().submit(job(f"[{steps}]"))
    await wait_for_point(fleet, job_id, point)
    return job_id


def test_members_that_are_apart_in_time_take_no_axis_off_its_line() -> None:
    """At 50 mm/s the starts of two SMC-4000 would be 0.15 mm apart, and a quarter of a window is 0.125 mm."""

    async def main(fleet: VirtualFleet) -> None:
        report, rows, truth = await fly(fleet, f"[{raster(3, 41, '10 ms', 'portal.x')}]", "gantry.y")
        assert report.state == "done" and report.verdict == "green", report.reason
        check_windows(rows, truth, "gantry.y")

    run_fleet(main, two_gantries())


def test_rows_are_given_out_while_the_lines_behind_them_are_flown() -> None:
    async def main(fleet: VirtualFleet) -> None:
        job_id = await begin_flight(fleet, raster(12, 41, "20 ms"), 200)
        # A row is stored at the latest a second behind the line of its point.
        assert len(await fleet.make_client().load_points(job_id)) >= 82
        report = await fleet.make_client().wait_for_job(job_id)
        assert report.state == "done" and len(await fleet.make_client().load_points(job_id)) == 12 * 41

    run_fleet(main, two_gantries())


def test_an_override_slows_the_lines_down_whose_rows_are_not_good_then() -> None:
    async def main(fleet: VirtualFleet) -> None:
        job_id = await begin_flight(fleet, raster(16, 41, "20 ms"), 50)
        client = fleet.make_client()
        await client.override_job(job_id, 50)
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        await client.override_job(job_id, 100)
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        rows = await client.load_points(job_id)
        assert [row.point for row in rows] == list(range(1, 16 * 41 + 1))
        bad = [row.point for row in rows if not row.good]
        assert bad and bad == list(range(bad[0], bad[-1] + 1)) and bad[0] > 60 and bad[-1] < 500

    run_fleet(main, two_gantries())


def test_windows_of_a_change_of_speed_are_not_good() -> None:
    """Their mean speed may be the one that was asked for."""

    async def change_speed(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        while fleet.controllers["gantry"].position("Y") < 21_000:  # the first line
            await sleep_ns(fleet.clock, NS_PER_S // 10)
        (flown,) = (await client.list_jobs(state="running")).jobs
        for percent in (40, 100, 40, 100):
            await sleep_ns(fleet.clock, 2 * NS_PER_S)
            await client.override_job(flown.id, percent)

    async def main(fleet: VirtualFleet) -> None:
        changing = asyncio.get_running_loop().create_task(change_speed(fleet))
        report, rows, truth = await fly(fleet, f"[{raster(12, 21, '40 ms')}]", "gantry.y")
        await changing
        assert report.state == "done", report.reason
        good = [row for row in rows if row.good]
        assert 12 < len(good) < len(rows)
        check_windows(good, truth, "gantry.y")

    run_fleet(main, two_gantries())


@pytest.mark.parametrize("repeat", [0, 2])
def test_a_chunk_that_is_late_breaks_windows_that_are_flown_again_if_asked(
    monkeypatch: pytest.MonkeyPatch, repeat: int
) -> None:
    async def main(fleet: VirtualFleet) -> None:
        more = f", repeat_disturbed: {repeat}"
        report, rows, truth = await fly(fleet, f"[{raster(15, 41, '20 ms', more=more)}]", "gantry.y")
        assert report.state == "done", report.reason
        good = [row for row in rows if row.good]
        check_windows(good, truth, "gantry.y")
        assert sorted(row.point for row in rows) == list(range(1, 15 * 41 + 1))
        assert (len(good) == len(rows)) == bool(repeat)

    delay_chunks(monkeypatch, "y", 1)
    run_fleet(main, two_gantries())


def test_chunks_that_are_late_too_often_end_the_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main(fleet: VirtualFleet) -> None:
        report, rows, _ = await fly(fleet, f"[{raster(22, 41, '20 ms')}]", "gantry.y")
        assert report.state == "failed" and "stop 2 of the scan" in report.reason, report.reason
        assert any(row.good for row in rows)

    monkeypatch.setattr(scan_flights, "MOST_STOPS", 1)
    delay_chunks(monkeypatch, "y", 1000)
    run_fleet(main, two_gantries())


class RowFeed:
    """The rows of points on the bus. at_ns: when each came, fleet time."""

    def __init__(self, fleet: VirtualFleet) -> None:
        self.rows: list[PointRecord] = []
        self.at_ns: list[int] = []
        self._fleet = fleet

    @classmethod
    async def subscribe(cls, fleet: VirtualFleet) -> "RowFeed":
        """Take the rows of all jobs from now on."""
        client, feed = fleet.make_client(), cls(fleet)
        await client.bus.subscribe(client.keys.job_points(), feed.take)
        return feed

    def take(self, sample: BusSample) -> None:
        """Take a message of rows."""
        rows = JobPoints.model_validate_json(sample.payload).rows
        self.rows += rows
        self.at_ns += [self._fleet.clock.now_ns() - origin_host_ns(self._fleet)] * len(rows)


def with_camera(fleet: Fleet, controller: str) -> Fleet:
    """A fleet whose controller has an output."""
    plain = fleet.to_plain()
    plain["controllers"][controller]["outputs"] = {"camera": {"number": 1}}
    return Fleet.model_validate(plain)


@pytest.mark.parametrize(
    ("make", "outer", "flown", "camera", "window_ms"),
    [
        (two_gantries, "gantry.x", "gantry.y", "gantry", 20),
        (two_gantries, "portal.x", "gantry.y", "portal", 20),
        (path_fleet, "gantry.x", "slide.y", "slide", 30),
    ],
)
def test_a_pulse_comes_in_each_window_of_a_flight(
    make: Callable[[], Fleet], outer: str, flown: str, camera: str, window_ms: int
) -> None:
    fleet_file = with_camera(make(), camera)
    trigger = f", trigger: {{output: {camera}.camera, pulse: {1 if camera != 'slide' else 10} ms}}"

    async def main(fleet: VirtualFleet) -> None:
        motor = fleet.fleet.axis(flown).motors[0]
        true = TrueEdges(fleet, camera, ((flown, flown.partition(".")[0], motor),), 1)
        feed = await RowFeed.subscribe(fleet)
        steps = f"[{raster(15, 41, f'{window_ms} ms', outer, flown, trigger)}]"
        report, rows, _ = await fly(fleet, steps, flown)
        assert report.state == "done" and report.verdict == "green", (report.reason, report.steps[0].scan)
        rises = true.rises()
        assert len(rows) == len(rises) == 15 * 41
        for row, at_ns in zip(rows, rises, strict=True):
            assert row.good and row.window is not None
            assert row.window.lower.earliest_ns < at_ns < row.window.upper.latest_ns
        assert feed.rows == rows  # final when they were given out, within a second of their lines
        for end in range(41, 15 * 41, 41):
            window = rows[end - 1].window
            assert window is not None and max(feed.at_ns[:end]) <= window.upper.latest_ns + NS_PER_S, end

    run_fleet(main, fleet_file)


def test_rows_wait_for_the_end_where_nothing_is_seen_of_triggers_before(monkeypatch: pytest.MonkeyPatch) -> None:
    async def see_nothing(_: TriggerWatch) -> None:
        return

    monkeypatch.setattr(TriggerWatch, "look", see_nothing)

    async def main(fleet: VirtualFleet) -> None:
        feed = await RowFeed.subscribe(fleet)
        steps = f"[{raster(3, 41, '20 ms', more=', trigger: {output: gantry.camera}')}]"
        report, rows, _ = await fly(fleet, steps, "gantry.y")
        window = rows[-1].window
        assert report.state == "done" and len(rows) == 3 * 41 and all(row.good for row in rows)
        assert window is not None and min(feed.at_ns) > window.upper.latest_ns

    run_fleet(main, with_camera(two_gantries(), "gantry"))


def test_a_pause_in_a_flight_with_triggers_loses_no_window() -> None:
    async def main(fleet: VirtualFleet) -> None:
        true = TrueEdges(fleet, "gantry", (("gantry.y", "gantry", "Y"),), 1)
        trigger = ", trigger: {output: gantry.camera}"
        job_id = await begin_flight(fleet, raster(12, 41, "20 ms", more=trigger), 60)
        client = fleet.make_client()
        await client.pause_job(job_id, now=True)
        await wait_for_state(fleet, job_id, "paused")
        stored = [row.point for row in await client.load_points(job_id)]
        assert stored == list(range(1, len(stored) + 1)) and 41 <= len(stored) < 12 * 41
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        rows = await client.load_points(job_id)
        assert [row.point for row in rows if row.good] == list(range(1, 12 * 41 + 1))
        # What was switched in a window that was broken is switched again.
        assert len(rows) <= len(true.rises()) <= len(rows) + 41

    run_fleet(main, with_camera(two_gantries(), "gantry"))


def test_axes_that_fly_together_are_paused_and_flown_again_from_a_point() -> None:
    axes = "portal.x: {from: 2, to: 6, points: 5}"
    for axis, spacing in (("gantry.x", 0.25), ("gantry.y", 0.5)):
        axes += f", {axis}: {{from: 30, to: {30 + 20 * spacing:g}, points: 21, snake: true}}"
    fly_field = "{axis: [gantry.x, gantry.y], duration: 30 ms, trigger: {output: gantry.camera}}"

    async def main(fleet: VirtualFleet) -> None:
        motors = (("gantry.x", "gantry", "X"), ("gantry.y", "gantry", "Y"))
        true = TrueEdges(fleet, "gantry", motors, 1)
        job_id = await begin_flight(fleet, f"{{do: scan, axes: {{{axes}}}, fly: {fly_field}}}", 30)
        client = fleet.make_client()
        await client.pause_job(job_id, now=True)
        await wait_for_state(fleet, job_id, "paused")
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        again = await client.retry_job(job_id, (0, 65))
        assert report.state == (await client.wait_for_job(again.job_id)).state == "done", report.reason
        rows = [row for flown in (job_id, again.job_id) for row in await client.load_points(flown) if row.good]
        assert [row.point for row in rows] == [*range(1, 106), *range(64, 106)]
        places = [place for place, (_, level) in zip(true.places, true.edges, strict=True) if level]
        rises = true.rises()
        for row in rows:
            assert row.window is not None
            lower_ns, upper_ns = row.window.lower.earliest_ns, row.window.upper.latest_ns
            (place,) = (
                place
                for at_ns, place in zip(rises, places, strict=True)
                if lower_ns < at_ns < upper_ns and abs(place["gantry.y"] - row.target["gantry.y"]) < 0.2
            )
            # On the line of both axes, whatever the instant of the edge.
            assert abs(place["gantry.x"] - 30 - (place["gantry.y"] - 30) / 2) <= 0.002

    run_fleet(main, with_camera(two_gantries(), "gantry"))


def test_rows_of_an_interrupted_line_stay_when_what_is_left_of_it_cannot_begin() -> None:
    async def main(fleet: VirtualFleet) -> None:
        job_id = await begin_flight(fleet, raster(12, 41, "20 ms"), 60)
        client = fleet.make_client()
        await client.pause_job(job_id, now=True)
        await wait_for_state(fleet, job_id, "paused")
        before = await client.load_points(job_id)
        assert len(before) % 41, "it was braked between two lines"
        fleet.act_on_controller("gantry", lambda controller: controller.set_power(on=False))
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "failed", report.reason
        rows = await client.load_points(job_id)
        assert rows[: len(before)] == before
        assert [row.point for row in rows[len(before) :]] == [len(before) + 1] and not rows[-1].good

    run_fleet(main, two_gantries())
