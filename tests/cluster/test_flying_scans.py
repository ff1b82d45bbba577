"""Scans that fly: windows by truth, rows by evidence, on SMC-4000 and CiA 402 in virtual time."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from cluster.test_contour import two_gantries
from cluster.test_triggers import TrueEdges
from cluster.worlds import (
    EXAMPLES,
    demo_fleet,
    job,
    line_fleet,
    origin_host_ns,
    outcome,
    refusal,
    run_fleet,
    wait_for_point,
)
from numpy.typing import NDArray

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport, PointRecord
from orchestrator.runtime.virtual.fleet import VirtualFleet

SAMPLE_NS = 700_000  # beside the periods of records, polls and SYNCs
SPACING = 0.5  # mm
COUNT = 0.001  # mm
WINDOW_S = 0.05
LINE_POINTS = 21


def raster(axis: str, fly_field: str = "{duration: 20 ms}") -> str:
    """A scan of three lines that snake."""
    axes = f"{{gantry.x: {{from: 50, to: 51, points: 3}}, {axis}: {{from: 20, to: 30, points: 21, snake: true}}}}"
    return f"{{do: scan, axes: {axes}, fly: {fly_field}}}"


def prepare(fleet: VirtualFleet) -> Job:
    """Enable and home all axes."""
    return job(f"[{{do: enable, axes: [{', '.join(fleet.fleet.controllers)}]}}, {{do: home}}]")


def path_fleet() -> Fleet:
    """The example fleet for paths: an SMC-4000 and two CiA 402 drives."""
    return load_fleet(EXAMPLES / "path.fleet.yaml")


@dataclass
class Truth:
    """The true motion of one axis: instants of fleet time, s, and positions; a count, in their unit."""

    times_s: NDArray[np.float64]
    places: NDArray[np.float64]
    count: float

    def find_crossing(self, position: float, begin_s: float, end_s: float) -> float:
        """When it was at a position between two instants in which it goes one way, s."""
        inside = (self.times_s >= begin_s) & (self.times_s <= end_s)
        times, places = self.times_s[inside], self.places[inside]
        if places[-1] < places[0]:
            places, position = -places, -position
        after = int(np.argmax(places >= position))
        assert after > 0, (position, places[0], places[-1])
        part = (position - places[after - 1]) / (places[after] - places[after - 1])
        return float(times[after - 1] + part * (times[after] - times[after - 1]))


async def fly(
    fleet: VirtualFleet, steps: str, axis: str, count: float = COUNT
) -> tuple[JobReport, list[PointRecord], Truth]:
    """Run steps, with the true positions of an axis meanwhile. count: of the axis, in its unit."""
    report, rows, (truth,) = await fly_all(fleet, steps, [axis], count)
    return report, rows, truth


async def fly_all(
    fleet: VirtualFleet, steps: str, axes: Sequence[str], count: float = COUNT
) -> tuple[JobReport, list[PointRecord], list[Truth]]:
    """The same for several axes."""
    await outcome(fleet, prepare(fleet))
    motors = [(fleet.controllers[axis.partition(".")[0]], fleet.fleet.axis(axis).motors[0]) for axis in axes]
    seen: list[tuple[float, ...]] = []

    async def watch() -> None:
        while True:
            seen.append((fleet.clock.now_ns(), *(controller.position(motor) for controller, motor in motors)))
            await sleep_ns(fleet.clock, SAMPLE_NS)

    watching = asyncio.get_running_loop().create_task(watch())
    report = await outcome(fleet, job(steps))
    watching.cancel()
    rows = await fleet.make_client().load_points(report.job_id)
    instants, *all_places = np.array(seen).T
    times_s = (instants - origin_host_ns(fleet)) / NS_PER_S
    return report, rows, [Truth(times_s, places * count, count) for places in all_places]


def check_line(
    rows: Sequence[PointRecord], truth: Truth, axis: str, spacing: float = SPACING, late_s: float = 0.0
) -> None:
    """Each window of a line was flown at its speed, and all three instants of its row contain the truth. late_s: by
    which a sample of its motion may come late."""
    direction = 1 if rows[-1].target[axis] > rows[0].target[axis] else -1
    ends = rows[0].window, rows[-1].window
    assert ends[0] is not None and ends[1] is not None
    begin_s, end_s = ends[0].lower.earliest_ns / NS_PER_S - 0.02, ends[1].upper.latest_ns / NS_PER_S + 0.02
    for row in rows:
        assert row.good and row.window is not None and row.took_s is not None
        crossings_s: list[float] = []
        for part, interval in ((-0.5, row.window.lower), (0.0, row.window.middle), (0.5, row.window.upper)):
            at_s = truth.find_crossing(row.target[axis] + direction * part * spacing, begin_s, end_s)
            assert interval.earliest_ns <= at_s * NS_PER_S <= interval.latest_ns, (row.point, part)
            assert interval.latest_ns - interval.earliest_ns <= 15 * NS_PER_MS
            crossings_s.append(at_s)
        error = abs((crossings_s[2] - crossings_s[0]) / row.took_s - 1)
        # The truth of some makes is whole counts.
        assert error <= max(0.005, 1.2 * truth.count / spacing, late_s / row.took_s), (row.point, error)


MAKES = pytest.mark.parametrize(("make", "axis"), [(two_gantries, "gantry.y"), (path_fleet, "slide.y")])


@pytest.mark.parametrize(
    ("make", "axis", "window_ms", "late_s"),
    # A drive follows the SYNCs of its host, of which a few are 0.3 ms late.
    [(two_gantries, "gantry.y", 20, 0.0), (path_fleet, "slide.y", 40, 0.0004)],
)
def test_a_raster_is_flown_at_its_speed_and_its_rows_contain_the_truth(
    make: Callable[[], Fleet], axis: str, window_ms: int, late_s: float
) -> None:
    async def main(fleet: VirtualFleet) -> None:
        report, rows, truth = await fly(fleet, f"[{raster(axis, f'{{duration: {window_ms} ms}}')}]", axis)
        assert report.state == "done" and report.verdict == "green", report.reason
        (scan,) = report.steps
        assert scan.scan is not None and (scan.scan.points, scan.scan.done, scan.scan.steps_done) == (63, 63, 6)
        assert scan.scan.verdicts == {"green": 63}
        assert [row.point for row in rows] == list(range(1, 64))
        wanted = [
            (x, y) for k, x in enumerate((50, 50.5, 51)) for y in [20 + n / 2 for n in range(21)][:: 1 - 2 * (k % 2)]
        ]
        assert [tuple(row.target.values()) for row in rows] == wanted
        for first in range(0, 63, LINE_POINTS):
            line = rows[first : first + LINE_POINTS]
            assert all(row.took_s == pytest.approx(window_ms / 1000) for row in line)
            check_line(line, truth, axis, late_s=late_s)

    run_fleet(main, make())


@MAKES
def test_a_pulse_comes_at_the_middle_of_each_window(make: Callable[[], Fleet], axis: str) -> None:
    controller = axis.partition(".")[0]
    plain = make().to_plain()
    plain["controllers"][controller]["outputs"] = {"camera": {"number": 1}}
    fly_field = f"{{duration: 40 ms, trigger: {{output: {controller}.camera, at: middle, pulse: 10 ms}}}}"

    async def main(fleet: VirtualFleet) -> None:
        motor = fleet.fleet.axis(axis).motors[0]
        true = TrueEdges(fleet, controller, ((axis, controller, motor),), 1)
        report, rows, _ = await fly(fleet, f"[{raster(axis, fly_field)}]", axis)
        assert report.state == "done" and report.verdict == "green", (report.reason, report.steps[0].scan)
        places = [place[axis] for place, (_, level) in zip(true.places, true.edges, strict=True) if level]
        assert len(places) == len(rows) == 63
        speed = SPACING / 0.04
        for row, at_ns, place in zip(rows, true.rises(), places, strict=True):
            # An edge comes within 7 ms of its instant with both makes.
            assert abs(place - row.target[axis]) <= speed * 0.007
            assert row.good and row.window is not None
            assert row.window.lower.earliest_ns < at_ns < row.window.upper.latest_ns

    run_fleet(main, Fleet.model_validate(plain))


def test_a_trigger_that_is_faster_than_the_make_plays_is_refused_before_anything_moves() -> None:
    plain = two_gantries().to_plain()
    plain["controllers"]["gantry"]["outputs"] = {"camera": {"number": 1}}
    steps = raster("gantry.y", "{duration: 5 ms, trigger: {output: gantry.camera}}")

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        forecast = (await fleet.make_client().dry_run(job(f"[{steps}]"))).problems
        assert [problem.code for problem in forecast] == ["trigger-rate"] and "camera" in forecast[0].text, forecast

    run_fleet(main, Fleet.model_validate(plain))


def test_a_flown_scan_is_paused_between_lines_and_run_again_from_the_line_of_a_point() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, prepare(fleet))
        job_id = await client.submit(job(f"[{raster('gantry.y')}]"))
        await wait_for_point(fleet, job_id, 22)
        await client.pause_job(job_id)
        await wait_for_state(fleet, job_id, "paused")
        at_pause = fleet.controllers["gantry"].position("Y")
        await sleep_ns(fleet.clock, NS_PER_S)
        assert fleet.controllers["gantry"].position("Y") == at_pause
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        rows = await client.load_points(job_id)
        assert len(rows) == 63 and all(row.good for row in rows)
        again = await client.retry_job(job_id, (0, 30))
        repeated = await client.wait_for_job(again.job_id)
        assert repeated.state == "done" and repeated.from_step == 2
        assert [row.point for row in await client.load_points(again.job_id)] == list(range(22, 64))
        with pytest.raises(Refusal, match="has the points 1 to 63"):
            await client.retry_job(job_id, (0, 64))

    run_fleet(main, two_gantries())


@pytest.mark.parametrize("what", ["stop", "estop"])
def test_a_line_that_is_stopped_ends_the_scan_and_the_rows_before_it_are_kept(what: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, prepare(fleet))
        job_id = await client.submit(job(f"[{raster('gantry.y')}]"))
        await wait_for_point(fleet, job_id, 22)
        while not 22_000 < fleet.controllers["gantry"].position("Y") < 28_000:
            await sleep_ns(fleet.clock, NS_PER_MS)
        await (client.stop() if what == "stop" else client.estop("a test"))
        report = await client.wait_for_job(job_id)
        assert report.state in ("aborted", "failed"), report.state
        rows = await client.load_points(job_id)
        assert [row.point for row in rows if row.good] == list(range(1, 22))
        assert all(row.window is None and row.state != "done" for row in rows[21:])

    run_fleet(main, two_gantries())


def test_a_line_that_is_braked_is_flown_again_from_the_window_that_was_broken() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, prepare(fleet))
        job_id = await client.submit(job(f"[{raster('gantry.y', '{duration: 50 ms}')}]"))
        await wait_for_point(fleet, job_id, 22)
        while not 22_000 < fleet.controllers["gantry"].position("Y") < 28_000:
            await sleep_ns(fleet.clock, NS_PER_MS)
        await client.pause_job(job_id, now=True)
        await wait_for_state(fleet, job_id, "paused")
        assert 20_000 < fleet.controllers["gantry"].position("Y") < 30_000
        flown = [row.point for row in await client.load_points(job_id)]
        assert 22 < len(flown) < 42 and flown == list(range(1, len(flown) + 1))
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        rows = await client.load_points(job_id)
        assert [row.point for row in rows if row.good] == list(range(1, 64))
        first, again = rows[len(flown) - 1], rows[len(flown)]
        assert first.window is not None and again.window is not None
        assert again.window.lower.earliest_ns > first.window.upper.latest_ns + NS_PER_S // 10

    run_fleet(main, two_gantries())


@pytest.mark.parametrize("name", ["feeder", "stage", "lift"])
def test_other_makes_fly_a_line_as_a_trapezoid(name: str) -> None:
    """An SMC-2000, an SHRC-203 and an SMC30."""
    fleet_file = line_fleet(name)
    axis_name = f"{name}.{next(iter(fleet_file.controllers[name].axes))}"
    axis = fleet_file.axis(axis_name)
    speed = axis.limits.velocity / 5
    window, first = speed * WINDOW_S, speed * speed / axis.limits.acceleration + speed * 2 * WINDOW_S
    scan = f"{{do: scan, axes: {{{axis_name}: {{from: {first:.6g}, to: {first + 10 * window:.6g}, points: 11}}}}"

    async def main(fleet: VirtualFleet) -> None:
        steps = f"[{scan}, fly: {{speed: {speed:.9g}}}, start: agreed}}]"
        report, rows, truth = await fly(fleet, steps, axis_name, 1 / float(axis.counts_per_unit))
        assert report.state == "done" and report.verdict == "green", report.reason
        check_line(rows, truth, axis_name, window)

    run_fleet(main, fleet_file)


async def wait_for_state(fleet: VirtualFleet, job_id: str, state: str) -> None:
    client = fleet.make_client()
    async with asyncio.timeout(60):
        while (entry := (await client.show_job(job_id)).entry) is None or entry.state != state:
            await asyncio.sleep(0.02)


def test_a_raster_takes_a_fraction_of_the_time_from_point_to_point() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        axes = "axes: {gantry.x: {from: 50, to: 51, points: 3}, gantry.y: {from: 20, to: 60, points: 81, snake: true}}"
        took_s: list[float] = []
        for how in ("fly: {duration: 10 ms}", "at_each: [{do: dwell, duration: 10 ms}]"):
            report = await outcome(
                fleet, job(f"[{{do: move, to: {{gantry.x: 40, gantry.y: 10}}}}, {{do: scan, {axes}, {how}}}]")
            )
            assert report.state == "done", report.reason
            took_s.append(report.steps[1].actual_s or 0.0)
        assert took_s[0] < took_s[1] / 5

    run_fleet(main, two_gantries())


def test_positions_that_have_changed_until_it_begins_are_refused_and_not_stepped() -> None:
    """A line is checked with its positions when they are known: one that cannot be flown then does not begin."""
    steps = "{do: scan, axes: {gantry.y: {from: edge, to: 30, points: 21}}, fly: {duration: 20 ms}}"
    plain = two_gantries().to_plain()
    plain["positions"] = {"edge": {"gantry.y": -10}}

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        before = len(fleet.controllers["gantry"].commanded_motions)
        refused = await refusal(fleet, job(f"[{{do: move, to: {{gantry.x: 0}}}}, {steps}]"))
        assert "soft limit" in refused.text, refused.text
        assert len(fleet.controllers["gantry"].commanded_motions) == before

    run_fleet(main, Fleet.model_validate(plain))


def test_each_line_waits_for_an_input_and_is_a_motion_of_its_own() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, prepare(fleet))
        wait = "{duration: 20 ms, wait: {input: gantry.door, value: false, timeout: 20 s}}"
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=False))
        await fleet.wait_until(lambda states: states["gantry"].inputs["door"])
        scan = job(f"[{raster('gantry.y', wait)}]")
        (step,) = (await client.dry_run(scan)).steps
        assert step.lines.endswith("line by line: it waits for gantry.door before each"), step.lines
        assert step.most_s is not None and step.most_s > 60
        job_id = await client.submit(scan)
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        assert not await client.load_points(job_id)
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=True))
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        (found,) = report.steps
        assert found.scan is not None and (found.scan.points, found.scan.steps_done) == (63, 9)
        assert all(row.good for row in await client.load_points(job_id))

    run_fleet(main, two_gantries())


def test_an_input_that_does_not_change_ends_the_scan_at_its_line() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        wait = "{duration: 20 ms, wait: {input: gantry.door, value: false, timeout: 1 s}}"
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=False))
        await fleet.wait_until(lambda states: states["gantry"].inputs["door"])
        report = await outcome(fleet, job(f"[{raster('gantry.y', wait)}]"))
        assert report.state == "failed" and "points 1 to 21 of 63 (wait)" in report.steps[-1].reason + report.reason
        (row,) = await fleet.make_client().load_points(report.job_id)
        assert (row.point, row.good, row.state) == (1, False, "failed")

    run_fleet(main, two_gantries())


@pytest.mark.parametrize(
    ("flown", "counts"), [(("stage.u", "stage.v"), (1e-4, 1e-4)), (("stage.u", "gantry.x"), (1e-4, 1e-3))]
)
def test_axes_fly_together_line_by_line(flown: tuple[str, str], counts: tuple[float, float]) -> None:
    """Of makes that move from rest to rest: a straight line, one trapezoid that all axes share."""
    spacings = (0.05, 0.1)
    axes = "gantry.y: {from: 20, to: 21, points: 2}"
    for axis, spacing in zip(flown, spacings, strict=True):
        axes += f", {axis}: {{from: 10, to: {10 + 10 * spacing:g}, points: 11, snake: true}}"
    scan = f"{{do: scan, axes: {{{axes}}}, fly: {{axis: [{', '.join(flown)}], duration: 50 ms, tolerance: 0.1}}}}"

    async def main(fleet: VirtualFleet) -> None:
        report, rows, truths = await fly_all(fleet, f"[{scan}]", flown, 1.0)
        assert report.state == "done" and report.verdict == "green", report.reason
        assert [row.point for row in rows] == list(range(1, 23))
        for axis, spacing, count, truth in zip(flown, spacings, counts, truths, strict=True):
            true = Truth(truth.times_s, truth.places * count, count)
            for first in (0, 11):
                check_line(rows[first : first + 11], true, axis, spacing)

    run_fleet(main, demo_fleet())
