"""Paths with members that move from rest to rest only, judged by the simulators' truth."""

import asyncio
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from cluster.test_contour import two_gantries
from cluster.test_paths import count_motions, positions
from cluster.worlds import demo_fleet, job, outcome, refusal, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport
from orchestrator.runtime.simulated_fleets import make_ppsmc, make_smc30
from orchestrator.runtime.virtual.fleet import VirtualFleet

AXES = ("gantry.x", "gantry.y", "stage.u")


def mixed() -> Fleet:
    """The SMC-4000 with a jerk limit, and the SHRC-203."""
    plain = demo_fleet().to_plain()
    gantry = two_gantries().to_plain()["controllers"]["gantry"]
    plain["controllers"]["gantry"]["axes"] = gantry["axes"]
    return Fleet.model_validate(plain)


def path(pieces: str, axes: tuple[str, ...] = AXES, tolerance: str = "200 um", **more: str) -> Job:
    fields = "".join(f", {name}: {value}" for name, value in more.items())
    start = ", ".join("0" for _ in axes)
    names = ", ".join(axes)
    return job(
        f"[{{do: path, axes: [{names}], start: [{start}], tolerance: {tolerance}, pieces: {pieces}{fields}}}]",
        max_start_skew="100 ms",
        max_end_skew="200 ms",
    )


# Curves of the gantry alone, and lines from rest to rest in which the stage takes part.
PIECES = (
    "[{piece: line, to: [10, 20, 5]},"
    " {piece: arc, to: [30, 20, 5], centre: [20, 20]},"
    " {piece: line, to: [30, 40, 5], corner: stop},"
    " {piece: line, to: [0, 40, 2]}]"
)


async def prepare(fleet: VirtualFleet, settle_s: int = 2) -> None:
    names = ", ".join(fleet.fleet.controllers)
    prepared = await outcome(fleet, job(f"[{{do: enable, axes: [{names}]}}, {{do: home}}]"))
    assert prepared.state == "done", prepared.reason
    await sleep_ns(fleet.clock, settle_s * NS_PER_S)


async def watch(fleet: VirtualFleet, axes: tuple[str, ...], seen: list[list[float]]) -> None:
    scales = [_find_scale(fleet, axis) for axis in axes]
    while True:
        motors = [(axis.partition(".")[0], fleet.fleet.axis(axis).motors[0]) for axis in axes]
        raw = [fleet.controllers[name].position(motor) for name, motor in motors]
        seen.append([each / scale for each, scale in zip(raw, scales, strict=True)])
        await sleep_ns(fleet.clock, 7 * NS_PER_MS)


def _find_scale(fleet: VirtualFleet, axis: str) -> float:
    """What the truth of a simulator counts in: that of a pp-electronic SMC in its own unit."""
    make = fleet.fleet.controllers[axis.partition(".")[0]].adapter
    return 1.0 if make == "ppsmc" else float(fleet.fleet.axis(axis).counts_per_unit)


def distance_from_line(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    way = b - a
    part = np.clip(((points - a) @ way) / (way @ way), 0.0, 1.0)
    return np.linalg.norm(points - a - part[:, None] * way, axis=1)


async def run_watched(fleet: VirtualFleet, wanted: Job, axes: tuple[str, ...]) -> tuple[JobReport, np.ndarray]:
    seen: list[list[float]] = []
    watching = asyncio.get_running_loop().create_task(watch(fleet, axes, seen))
    report = await outcome(fleet, wanted)
    watching.cancel()
    assert report.state == "done", report.reason
    return report, np.array(seen)


def test_pieces_with_such_a_member_are_steps_of_their_own() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet, 60)
        report, seen = await run_watched(fleet, path(PIECES), AXES)
        paths = [step.path for step in report.steps]
        assert len(paths) == 3 and [len(step.members) for step in report.steps] == [2, 1, 2]
        bounds = [each.bound.predicted for each in paths if each is not None and each.bound is not None]
        assert len(bounds) == 3 and max(bounds) <= 0.2
        assert [round(each.length, 3) for each in paths if each is not None] == [
            pytest.approx(22.913, abs=1e-3),
            pytest.approx(np.pi * 10 + 20, abs=1e-3),
            pytest.approx(30.150, abs=1e-3),
        ]
        corners = [np.array(each) for each in ((0, 0, 0), (10, 20, 5), (30, 20, 5), (30, 40, 5), (0, 40, 2))]
        lines = [distance_from_line(seen, a, b) for a, b in pairwise(corners)]
        off = seen - np.array([20.0, 20.0, 5.0])
        arc = np.where(off[:, 1] <= 1e-6, np.hypot(np.hypot(off[:, 0], off[:, 1]) - 10.0, off[:, 2]), np.inf)
        error = np.min([lines[0], arc, lines[2], lines[3]], axis=0)
        assert error.max() <= max(bounds), error.max()
        shown = await fleet.make_client().show_job(report.job_id)
        assert shown.report is not None and len(shown.report.steps) == 3

    run_fleet(main, mixed())


HINDERING = (
    ("[{piece: line, to: [10, 0, 0]}, {piece: arc, to: [20, 0, 2], through: [15, 5, 1]}]", "piece 2 moves axis"),
    ("[{piece: line, to: [9, 0, 1], corner: {within: 1}}, {piece: line, to: [9, 9, 1]}]", "ends in a rounded"),
    ("[{piece: line, to: [9, 0, 0], corner: {within: 1}}, {piece: line, to: [9, 9, 1]}]", "begins in the rounded"),
    ("[{piece: spline, through: [[1, 2, 0], [3, 4, 1]]}]", "is a spline"),
)


def test_the_piece_that_hinders_is_named_before_anything_moves() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        before = count_motions(fleet)
        for pieces, words in HINDERING:
            found = await refusal(fleet, path(pieces))
            assert found.code == "path-class" and words in found.text and "stage.u" in found.text, found.text
            assert await refusal_of_dry_run(fleet, path(pieces)) == "path-class"
        assert count_motions(fleet) == before

    run_fleet(main, mixed())


async def refusal_of_dry_run(fleet: VirtualFleet, wanted: Job) -> str:
    try:
        forecast = await fleet.make_client().dry_run(wanted)
    except Refusal as error:
        return error.code
    return forecast.problems[0].code


def test_an_axis_of_such_a_member_may_stand_on_a_curve() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        pieces = "[{piece: arc, to: [20, 0, 0], centre: [10, 0]}]"
        report = await outcome(fleet, path(pieces))
        assert report.state == "done", report.reason
        assert positions(fleet, ("gantry.x", "gantry.y")) == [20.0, 0.0]
        assert list(report.steps[0].members) == ["gantry"]

    run_fleet(main, mixed())


def test_a_tolerance_that_a_trapezoid_cannot_keep_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        before = count_motions(fleet)
        found = await refusal(fleet, path("[{piece: line, to: [50, 0, 20]}]", tolerance="2 um"))
        assert found.code == "path-error" and "off the path" in found.text and count_motions(fleet) == before

    run_fleet(main, mixed())


def test_a_speed_along_the_path_holds_for_its_trapezoids() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        forecast = await fleet.make_client().dry_run(path("[{piece: line, to: [30, 0, 4]}]", speed="5 mm/s"))
        (step,) = forecast.steps
        assert not forecast.problems and step.path is not None and step.path.bound is not None
        assert step.path.duration_s >= 30.26 / 5
        assert "a trapezoid, which stage.u needs" in {each.binds for each in step.path.stretches}

    run_fleet(main, mixed())


def steppers(make: Any) -> Fleet:
    gantry = two_gantries().to_plain()["controllers"]["gantry"]
    config = make
    axis = config["axes"]["x"]
    if axis["unit"] == "counts":
        axis = {**axis, "unit": "mm", "scale": 1000, "limits": {"velocity": 60, "acceleration": 300}}
        axis |= {"start_rate": {"min": 0.1, "max": 4}, "homing": {"speed": 10}}
    controllers = {"gantry": gantry, "lift": {**config, "axes": {"x": axis}}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "members", "controllers": controllers})


@pytest.mark.parametrize(
    ("make", "tolerance"), [(make_smc30(4, 1), "500 um"), (make_ppsmc(0), "2 mm")], ids=["smc30", "ppsmc"]
)
def test_other_makes_take_part_in_lines(make: dict[str, Any], tolerance: str) -> None:
    axes = ("gantry.x", "lift.x")

    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet, 20)
        wanted = path("[{piece: line, to: [40, 10]}, {piece: line, to: [0, 10]}]", axes, tolerance)
        report, seen = await run_watched(fleet, wanted, axes)
        bound = report.steps[0].path
        assert bound is not None and bound.bound is not None and len(report.steps) == 2
        a, b, c = (np.array(each, dtype=float) for each in ((0, 0), (40, 10), (0, 10)))
        error = np.minimum(distance_from_line(seen, a, b), distance_from_line(seen, b, c))
        assert error.max() <= bound.bound.predicted, (error.max(), bound.bound)

    run_fleet(main, steppers(make))
