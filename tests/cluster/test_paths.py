"""Paths through the running system, on one and on several makes, judged by the simulators' truth."""

import asyncio
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from cluster.test_contour import two_gantries
from cluster.worlds import PREPARE, demo_fleet, job, outcome, refusal, run_fleet

from adapters.controller.slots.path_chunks import PathChunks
from adapters.yaskawa.common.course_refill import ContourRefill
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import ChunkReply, LoadChunkRequest
from orchestrator.model.report import JobReport, PathReport
from orchestrator.plan.path_profiles import FIT_SHARE
from orchestrator.runtime.simulated_fleets import make_smc2000, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

RADIUS, CENTRE = 50.0, 100.0  # mm
SAMPLE_NS = 17 * NS_PER_MS  # beside the periods of records, polls and SYNCs
ALONE, TWO = ("gantry.x", "gantry.y"), ("gantry.x", "portal.y")
Point = tuple[float, float]


def circle(axes: tuple[str, str], turns: int, tolerance: str = "1 mm", **fields: str) -> Job:
    """A job of one circle of 50 mm at 100 mm/s, from its rightmost point on."""
    fields = {"speed": "100 mm/s", "tolerance": tolerance} | fields
    more = ", ".join(f"{name}: {value}" for name, value in fields.items())
    piece = f"{{piece: helix, to: [150, 100], centre: [100, 100], turns: {turns - 1}}}"
    return job(f"[{{do: path, axes: [{', '.join(axes)}], start: [150, 100], pieces: [{piece}], {more}}}]")


def prepare(fleet: Fleet, axes: tuple[str, ...]) -> Job:
    """Enable and home, and go to where the circle begins."""
    names = ", ".join(fleet.controllers)
    to = ", ".join(f"{axis}: {value}" for axis, value in zip(axes, (150, 100), strict=False))
    return job(f"[{{do: enable, axes: [{names}]}}, {{do: home}}, {{do: move, to: {{{to}}}}}]")


def gantries() -> Fleet:
    """Two SMC-4000 whose crystals run 101 ppm apart."""
    return two_gantries()


def gantry_and_drive() -> Fleet:
    """An SMC-4000, and a CiA 402 drive that follows positions at 100 Hz."""
    limits = {"velocity": 200, "acceleration": 1000, "jerk": 20_000}
    gantry = make_smc4000(0)
    drive = {
        "adapter": "cia402",
        "link": {"kind": "can", "interface": "socketcan", "channel": "can0", "address": 1},
        "options": {"cycle_us": 100, "start_us": 50, "start_spread_us": 50},
        "axes": {"y": {"motors": ["1"], "unit": "mm", "scale": 1000, "limits": limits}},
        "simulate": {"drift_ppm": 40, "options": {"objects": {"6065": 500, "6066": 0}}},
    }
    x: dict[str, Any] = {**gantry["axes"]["x"], "limits": limits}
    controllers = {"gantry": {**gantry, "axes": {"x": x}}, "drive": drive}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "paths", "controllers": controllers})


def gantry_and_slow() -> Fleet:
    """An SMC-4000, and an SMC-2000, which has a path loaded as a whole."""
    limits = {"velocity": 200, "acceleration": 1000, "jerk": 20_000}
    gantry, slow = make_smc4000(0), make_smc2000(1)
    controllers = {
        "gantry": {**gantry, "axes": {"x": {**gantry["axes"]["x"], "limits": limits}}},
        "slow": {**slow, "axes": {"y": {**slow["axes"]["x"], "limits": limits}}},
    }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "paths", "controllers": controllers})


def positions(fleet: VirtualFleet, axes: tuple[str, ...]) -> list[float]:
    """The true positions of axes now, mm."""
    return [
        fleet.controllers[axis.partition(".")[0]].position(fleet.fleet.axis(axis).motors[0]) / 1000 for axis in axes
    ]


def is_moving(fleet: VirtualFleet, axes: tuple[str, ...]) -> bool:
    return any(fleet.controllers[axis.partition(".")[0]].is_moving(fleet.fleet.axis(axis).motors[0]) for axis in axes)


async def watch_truth(fleet: VirtualFleet, axes: tuple[str, ...]) -> list[list[float]]:
    """The true positions from the start of a motion to its end."""
    async with asyncio.timeout(30):
        while not is_moving(fleet, axes):
            await sleep_ns(fleet.clock, NS_PER_MS)
    seen: list[list[float]] = []
    while is_moving(fleet, axes):
        seen.append(positions(fleet, axes))
        await sleep_ns(fleet.clock, SAMPLE_NS)
    return seen


async def follow(fleet: VirtualFleet, axes: tuple[str, ...], path: Job) -> tuple[JobReport, np.ndarray]:
    """Run a path; its report, and the true positions on the way."""
    watched = asyncio.get_running_loop().create_task(watch_truth(fleet, axes))
    report = await outcome(fleet, path)
    if report.state != "done":
        watched.cancel()
        raise AssertionError(report.reason)
    return report, np.array(await watched)


def circle_errors(seen: np.ndarray) -> np.ndarray:
    return np.abs(np.hypot(seen[:, 0] - CENTRE, seen[:, 1] - CENTRE) - RADIUS)


def require_sound(path: PathReport | None) -> float:
    """The bound of a report, which is the sum of its terms."""
    assert path is not None and path.bound is not None
    bound = path.bound
    assert (
        bound.predicted == pytest.approx(sum(term.size for term in bound.terms)) and bound.predicted <= bound.tolerance
    )
    (fit,) = [term for term in bound.terms if term.name == "profile-fit"]
    assert fit.size <= FIT_SHARE * bound.tolerance * 1.001
    assert path.stretches and path.stretches[0].from_s == 0.0
    return bound.predicted


def test_a_long_circle_on_one_controller() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, ALONE))
        report, seen = await follow(fleet, ALONE, circle(ALONE, 4, "100 um"))
        step = report.steps[0]
        assert step.do == "path" and step.verdict == "green" and not step.deviations
        assert step.planned_s is not None and step.planned_s > 12
        bound, errors = require_sound(step.path), circle_errors(seen)
        assert len(seen) > 700 and errors.max() < bound < 0.017 and errors.max() < 0.003
        assert positions(fleet, ALONE) == [150.0, 100.0]

    run_fleet(main, gantries())


def test_a_circle_on_two_controllers_stays_within_the_bound_ahead() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        await sleep_ns(fleet.clock, 20 * NS_PER_S)  # of clock readings
        report, seen = await follow(fleet, TWO, circle(TWO, 3))
        step = report.steps[0]
        bound, errors = require_sound(step.path), circle_errors(seen)
        assert errors.max() < bound
        assert np.percentile(errors, 99) < 0.06
        assert step.path is not None and step.path.bound is not None
        names = {(term.name, term.member) for term in step.path.bound.terms}
        assert names == {("profile-fit", "")} | {
            (name, member) for name in ("execution", "start", "clock") for member in ("gantry", "portal")
        }
        shown = await fleet.make_client().show_job(report.job_id)
        assert shown.report is not None and shown.report.steps[0].path == step.path

    run_fleet(main, gantries())


def test_a_contour_and_a_stream_make_one_path() -> None:
    async def main(fleet: VirtualFleet) -> None:
        axes = ("gantry.x", "drive.y")
        prepared = await outcome(fleet, prepare(fleet.fleet, axes))
        assert prepared.state == "done", prepared.reason
        await sleep_ns(fleet.clock, 10 * NS_PER_S)
        report, seen = await follow(fleet, axes, circle(axes, 2))
        assert circle_errors(seen).max() < require_sound(report.steps[0].path)
        assert {member: each.start_class for member, each in report.steps[0].members.items()} == {
            "gantry": "clock",
            "drive": "sync",
        }

    run_fleet(main, gantry_and_drive())


# Refused before anything moves


def lines(axes: tuple[str, str], *points: Point) -> Job:
    """A path of lines from 0, 0."""
    pieces = ", ".join(f"{{piece: line, to: [{x}, {y}]}}" for x, y in points)
    return job(f"[{{do: path, axes: [{', '.join(axes)}], start: [0, 0], pieces: [{pieces}], tolerance: 1 mm}}]")


def count_motions(fleet: VirtualFleet) -> int:
    return sum(len(each.commanded_motions) for each in fleet.controllers.values())


def test_a_path_that_leaves_the_soft_limits_in_its_middle_only() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, ALONE))
        before = count_motions(fleet)
        # Both ends and the corner points of the arc are inside 300 mm; its top is not.
        pieces = "[{piece: line, to: [150, 280]}, {piece: arc, to: [50, 280], centre: [100, 280]}]"
        path = f"{{do: path, axes: [gantry.x, gantry.y], start: [150, 100], pieces: {pieces}, tolerance: 1 mm}}"
        found = await refusal(fleet, job(f"[{path}]"))
        assert found.code == "soft-limit" and "gantry.y reaches" in found.text, found.text
        assert count_motions(fleet) == before

    run_fleet(main, gantries())


def test_a_member_that_can_only_move_from_rest_to_rest_is_named() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job("[{do: enable, axes: [gantry, stage]}, {do: home}]"))
        before = count_motions(fleet)
        arc = "{piece: arc, to: [20, 10], through: [12, 4]}"
        path = f"{{do: path, axes: [gantry.x, stage.u], start: [0, 0], pieces: [{arc}], tolerance: 1 mm}}"
        found = await refusal(fleet, job(f"[{path}]"))
        assert found.code == "path-class" and "stage.u" in found.text and "leave it out" in found.remedy
        assert count_motions(fleet) == before

    run_fleet(main, demo_fleet())


def test_a_tolerance_that_the_fleet_cannot_keep() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        before = count_motions(fleet)
        path = circle(TWO, 2, "20 um")
        forecast = await fleet.make_client().dry_run(path)
        assert [each.code for each in forecast.problems] == ["path-error"]
        found = await refusal(fleet, path)
        assert found.code == "path-error" and "Largest is" in found.text and "by its start" in found.text
        assert "the tolerance is 0.02 mm" in found.text and "allow `tolerance: 0." in found.remedy
        assert count_motions(fleet) == before
        fits = found.remedy.partition("tolerance: ")[2].rstrip("`")
        report = await outcome(fleet, circle(TWO, 2, fits))
        assert report.state == "done", report.reason

    run_fleet(main, gantries())


def test_a_dry_run_states_duration_binding_limits_and_bound() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, ALONE))
        forecast = await fleet.make_client().dry_run(circle(ALONE, 1))
        (step,) = forecast.steps
        assert not forecast.problems and step.path is not None
        require_sound(step.path)
        assert step.least_s == step.most_s == pytest.approx(step.path.duration_s, abs=1e-3)
        assert any("contour" in command for command in step.commands["gantry"])

    run_fleet(main, gantries())


# Inside a path


async def begin(fleet: VirtualFleet, path: Job, axes: tuple[str, ...], after_s: float = 1.5) -> str:
    """Submit a path, and wait until it has moved for some time."""
    job_id = await fleet.make_client().submit(path)
    async with asyncio.timeout(60):
        while not is_moving(fleet, axes):
            await sleep_ns(fleet.clock, NS_PER_MS)
    await sleep_ns(fleet.clock, round(after_s * NS_PER_S))
    return job_id


@pytest.mark.nightly
def test_the_error_of_a_long_path_does_not_grow() -> None:
    """The crystals of both controllers run 101 ppm apart, which is corrected in each of its chunks."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        await sleep_ns(fleet.clock, 30 * NS_PER_S)
        report, seen = await follow(fleet, TWO, circle(TWO, 9))
        bound, errors = require_sound(report.steps[0].path), circle_errors(seen)
        assert len(seen) > 1600 and errors.max() < bound < 0.3
        assert np.percentile(errors, 99) < 0.06
        assert report.steps[0].verdict == "green" and not report.steps[0].deviations

    run_fleet(main, gantries())


def test_a_feed_hold_brakes_along_the_path_and_the_path_goes_on_from_there() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        await sleep_ns(fleet.clock, 20 * NS_PER_S)
        client, seen = fleet.make_client(), list[list[float]]()
        job_id = await begin(fleet, circle(TWO, 3), TWO, 4.0)
        asked_ns = fleet.clock.now_ns()
        await client.pause_job(job_id, now=True)
        while is_moving(fleet, TWO):
            seen.append(positions(fleet, TWO))
            await sleep_ns(fleet.clock, SAMPLE_NS)
        assert (fleet.clock.now_ns() - asked_ns) / NS_PER_S < 2.0
        assert circle_errors(np.array(seen)).max() < 0.3
        while (await client.show_job(job_id)).transitions[-1].state != "paused":
            await sleep_ns(fleet.clock, 50 * NS_PER_MS)
        await client.resume_job(job_id)
        on = await watch_truth(fleet, TWO)
        report = await client.wait_for_job(job_id)
        assert report.state == "done" and len(report.steps[0].feed_holds) == 1
        assert circle_errors(np.array(on)).max() < require_sound(report.steps[0].path)
        assert positions(fleet, TWO) == [150.0, 100.0]

    run_fleet(main, gantries())


def test_a_pause_waits_for_the_end_of_a_path() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        client = fleet.make_client()
        path = circle(TWO, 1)
        both = path.model_copy(update={"steps": [*path.steps, *job("[{do: move, by: {gantry.x: -5}}]").steps]})
        job_id = await begin(fleet, both, TWO)
        await client.pause_job(job_id)
        while (await client.show_job(job_id)).transitions[-1].state != "paused":
            await sleep_ns(fleet.clock, 50 * NS_PER_MS)
        assert positions(fleet, TWO) == [150.0, 100.0]
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "done" and positions(fleet, TWO) == [145.0, 100.0]
        assert report.steps[1].chain is not None and report.steps[1].chain.broken == "a path begins and ends at rest"

    run_fleet(main, gantries())


def cut_link(fleet: VirtualFleet) -> None:
    fleet.wires["portal"].cut = True


@pytest.mark.parametrize("how", ["stop", "e-stop", "lost"])
def test_whatever_ends_a_path_brings_all_members_to_rest(how: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        client = fleet.make_client()
        job_id = await begin(fleet, circle(TWO, 3), TWO)
        act: Callable[[], Any] = {"stop": client.stop, "e-stop": client.estop}.get(how, lambda: cut_link(fleet))
        done = act()
        if done is not None:
            await done
        report = await client.wait_for_job(job_id)
        assert report.state in ("aborted", "failed"), report
        assert how != "lost" or ("portal" in report.reason and report.steps[0].path is not None)
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        assert not is_moving(fleet, TWO)
        assert circle_errors(np.array([positions(fleet, TWO)])).max() < 12.0

    run_fleet(main, gantries())


def delay_chunks(monkeypatch: pytest.MonkeyPatch, refused: str, times: int) -> None:
    """Have a member refuse to load chunks, as if its link were too slow."""
    load, left = PathChunks.load, [times]

    async def load_late(self: PathChunks, request: LoadChunkRequest) -> ChunkReply:
        mine = any(axis == refused for axis in request.profiles)
        if mine and left[0]:
            left[0] -= 1
            await asyncio.sleep(10.0)
        return await load(self, request)

    monkeypatch.setattr(PathChunks, "load", load_late)


def test_a_late_chunk_brakes_all_members_along_the_path_and_it_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        await sleep_ns(fleet.clock, 20 * NS_PER_S)
        job_id = await begin(fleet, circle(TWO, 3), TWO, 0.0)
        seen = [*await watch_truth(fleet, TWO), *await watch_truth(fleet, TWO)]
        report = await fleet.make_client().wait_for_job(job_id)
        assert report.state == "done", report.reason
        path = report.steps[0].path
        assert path is not None and circle_errors(np.array(seen)).max() < require_sound(path)
        assert [each.member for each in path.stops] == ["portal"] and path.stops[0].at_s > 6.0
        assert positions(fleet, TWO) == [150.0, 100.0]

    delay_chunks(monkeypatch, "y", 1)
    run_fleet(main, gantries())


def test_a_late_chunk_stops_a_member_that_has_the_whole_path(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main(fleet: VirtualFleet) -> None:
        axes = ("gantry.x", "slow.y")
        await outcome(fleet, prepare(fleet.fleet, axes))
        await sleep_ns(fleet.clock, 20 * NS_PER_S)
        job_id = await begin(fleet, circle(axes, 4), axes, 0.0)
        seen = np.array(await watch_truth(fleet, axes))
        report = await fleet.make_client().wait_for_job(job_id)
        assert report.state == "failed" and "not all members can brake along it" in report.reason, report
        assert len(seen) * SAMPLE_NS < 9 * NS_PER_S, "the whole path takes 13 s"
        assert circle_errors(seen).max() < 12.0 and not is_moving(fleet, axes)

    delay_chunks(monkeypatch, "x", 1)
    run_fleet(main, gantry_and_slow())


@pytest.mark.parametrize(
    ("percent", "turns"), [(50, 2), *(pytest.param(*each, marks=pytest.mark.nightly) for each in ((40, 3), (120, 5)))]
)
def test_an_override_changes_the_speed_along_the_path(percent: int, turns: int) -> None:
    """Two turns are one chunk, the last one."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        await sleep_ns(fleet.clock, 20 * NS_PER_S)
        client = fleet.make_client()
        planned = circle(TWO, turns)
        watched = asyncio.get_running_loop().create_task(watch_truth(fleet, TWO))
        job_id = await begin(fleet, planned, TWO, 2.0)
        await client.override_job(job_id, percent)
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        run = fleet.coordinators["first"][1].scheduler.register.running[job_id]
        stated, at_ns = run.make_progress().remaining_s, fleet.clock.now_ns()
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        took_s = (fleet.clock.now_ns() - at_ns) / NS_PER_S
        assert percent > 100 or stated == pytest.approx(took_s, abs=0.7)
        seen = np.array(await watched)
        path = report.steps[0].path
        assert circle_errors(seen).max() < require_sound(path) and path is not None and not path.stops
        speeds = np.hypot(*np.diff(seen, axis=0).T) / (SAMPLE_NS / NS_PER_S)
        assert np.percentile(speeds[:60], 80) == pytest.approx(100.0, rel=0.02)
        assert np.percentile(speeds[len(speeds) // 2 :], 50) == pytest.approx(percent, rel=0.02)
        assert positions(fleet, TWO) == [150.0, 100.0]

    run_fleet(main, gantries())


def test_a_resumed_path_goes_on_at_its_override() -> None:
    """A slow one would be a fast one otherwise, as soon as the path is resumed."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        await sleep_ns(fleet.clock, 20 * NS_PER_S)
        client = fleet.make_client()
        job_id = await begin(fleet, circle(TWO, 2), TWO, 1.0)
        await client.override_job(job_id, 70)
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        await client.pause_job(job_id, now=True)
        while (await client.show_job(job_id)).transitions[-1].state != "paused":
            await sleep_ns(fleet.clock, 50 * NS_PER_MS)
        await client.resume_job(job_id)
        seen = np.array(await watch_truth(fleet, TWO))
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        assert circle_errors(seen).max() < require_sound(report.steps[0].path)
        speeds = np.hypot(*np.diff(seen, axis=0).T) / (SAMPLE_NS / NS_PER_S)
        assert speeds.max() < 73.0 and np.median(speeds) == pytest.approx(70.0, rel=0.02)

    run_fleet(main, gantries())


@pytest.mark.parametrize(
    ("percent", "words"), [(0, "between 10 and 120"), (500, "between 10 and 120"), (120, "axes allow")]
)
def test_an_override_that_is_not_possible_says_what_is(percent: int, words: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        client = fleet.make_client()
        job_id = await begin(fleet, circle(TWO, 1, speed="200 mm/s", acceleration="900 mm/s²"), TWO)
        with pytest.raises(Refusal, match=words) as caught:
            await client.override_job(job_id, percent)
        assert caught.value.code == "override" and caught.value.remedy
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason

    run_fleet(main, gantries())


def test_a_path_that_cannot_be_continued_ends_on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(*_: object) -> None:
        raise Refusal("no-room", "the chunk does not fit", "load it later")

    monkeypatch.setattr(ContourRefill, "load", refuse)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        report = await outcome(fleet, circle(TWO, 12))
        path = report.steps[0].path
        assert report.state == "aborted" and "braked on the path at" in report.reason
        assert path is not None and len(path.stops) > 1
        assert not is_moving(fleet, TWO) and circle_errors(np.array([positions(fleet, TWO)])).max() < 0.3

    run_fleet(main, gantries())


def test_a_path_at_a_speed_in_percent_uses_that_part_of_what_its_axes_allow() -> None:
    steps = "{{do: path, axes: [gantry.x, gantry.y], start: [0, 0], pieces: [{{piece: line, to: [{}, 0]}}], tolerance: 1 mm{}}}"

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        planned_s: list[float] = []
        for target, speed in ((300, ""), (0, ", speed: 50 %")):
            start = "[0, 0]" if target else "[300, 0]"
            report = await outcome(fleet, job(f"[{steps.format(target, speed).replace('[0, 0]', start, 1)}]"))
            assert report.state == "done", report.reason
            planned_s.append(report.steps[0].planned_s or 0.0)
        # 200 mm/s, then 100 mm/s, with ramps.
        assert planned_s[0] == pytest.approx(1.7, abs=0.3)
        assert planned_s[1] == pytest.approx(3.1, abs=0.3)
        with pytest.raises(Refusal, match="120 %, of what its axes allow"):
            await outcome(fleet, job(f"[{steps.format(300, ', speed: 120 %')}]"))

    run_fleet(main)
