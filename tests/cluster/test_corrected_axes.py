"""Axes with errors by the position of another one, straightness and squareness: where they truly are, with and without
their tables."""

import asyncio
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from cluster.worlds import EXAMPLES, job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.report import JobReport
from orchestrator.runtime.simulated_fleets import make_cia402, make_shrc203, make_smc30, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.mechanics import Mechanics

COUNT_MM = 1e-3
STRAIGHTNESS = [[0, 0], [5, 0.012], [10, 0.02], [15, 0.008], [20, -0.01], [25, -0.016], [30, 0]]


def stage_fleet(**group: Any) -> Fleet:
    """The example, with other fields of its group."""
    plain = load_fleet(EXAMPLES / "stage.fleet.yaml").to_plain()
    plain["virtual"]["stage"] |= group
    return Fleet.model_validate(plain)


def bare_fleet() -> Fleet:
    """The example without its group; the errors of its mechanics stay."""
    return Fleet.model_validate({**stage_fleet().to_plain(), "virtual": {}})


def two_controllers(second: dict[str, Any]) -> Fleet:
    """x on an SMC-4000, y on another controller: x is not straight, and y leans towards it."""
    first = make_smc4000(1)
    limits = {"min": 0, "max": 30}
    first["axes"] = {"x": {**first["axes"]["x"], "soft_limits": limits}}
    (motor,) = second["axes"].values()
    second["axes"] = {"y": {**motor, "soft_limits": {"min": -1, "max": 30}}}
    first["simulate"] |= {"mechanics": {"x": {"errors_of": {"second.y": [[-30, -0.03], [30, 0.03]]}}}}
    second["simulate"] |= {"mechanics": {"y": {"errors_of": {"first.x": STRAIGHTNESS}}}}
    group = {
        "kind": "corrected",
        "of": ["first.x", "second.y"],
        "axes": {"x": {"unit": "mm"}, "y": {"unit": "mm"}},
        "tables": {"straightness": {"axis": "y", "by": "x", "points": STRAIGHTNESS}},
        "squareness": "1 mrad",
    }
    controllers = {"first": first, "second": second}
    return Fleet.model_validate(
        {"schema": "tutti.fleet/1", "fleet": "stage", "controllers": controllers, "virtual": {"stage": group}}
    )


def make_truth(fleet: VirtualFleet) -> Callable[[], tuple[float, float]]:
    """Reads where the point of the stage truly is, mm."""
    config = fleet.fleet.controllers
    mechanics: dict[str, Mechanics] = {}
    for name, controller in fleet.controllers.items():
        mechanics[name] = Mechanics(controller, config[name], mechanics)
    owners = {axis: name for name in config for axis in config[name].axes}
    return lambda: (mechanics[owners["x"]].position("x"), mechanics[owners["y"]].position("y"))


def read_truth(fleet: VirtualFleet) -> tuple[float, float]:
    """Where the point of the stage truly is now, mm."""
    return make_truth(fleet)()


async def prepare(fleet: VirtualFleet, x: float = 20, y: float = 10) -> None:
    """Enable, home, and move to a place."""
    x_name, y_name = ("stage.x", "stage.y") if fleet.fleet.virtual else ("bench.x", "bench.y")
    axes = ", ".join(fleet.fleet.axis_names)
    steps = f"{{do: enable, axes: [{axes}]}}, {{do: home, axes: [{axes}]}}, {{do: move, to: {{{x_name}: {x}, {y_name}: {y}}}}}"
    report = await outcome(fleet, job(f"[{steps}]"))
    assert report.state == "done", report.reason


async def run_seen(fleet: VirtualFleet, step: str) -> tuple[JobReport, list[tuple[float, float]]]:
    """The report of a step, and where the point truly was every 2 ms."""
    seen: list[tuple[float, float]] = []
    read = make_truth(fleet)

    async def watch() -> None:
        while True:
            seen.append(read())
            await sleep_ns(fleet.clock, 2 * NS_PER_MS)

    watching = asyncio.get_running_loop().create_task(watch())
    report = await outcome(fleet, job(f"[{step}]"))
    watching.cancel()
    assert report.state == "done", report.reason
    return report, seen


async def measure_errors(fleet: VirtualFleet, moves: int) -> list[float]:
    """How far the point truly is from its targets after moves, mm; never farther than their bounds."""
    wanted_y = 10.0
    await prepare(fleet, y=wanted_y)
    draw = np.random.default_rng(1)
    group = "stage" if fleet.fleet.virtual else "bench"
    errors: list[float] = []
    read = make_truth(fleet)
    for number in range(moves):
        x, y = (round(float(value), 4) for value in draw.uniform((1, 1), (199, 149)))
        # Every other move names one axis, and the other one stays by truth.
        targets = f"{group}.x: {x}, {group}.y: {y}" if number % 2 == 0 else f"{group}.x: {x}"
        report = await outcome(fleet, job(f"[{{do: move, to: {{{targets}}}}}]"))
        assert report.state == "done", report.reason
        wanted_y = y if number % 2 == 0 else wanted_y
        true_x, true_y = read()
        bounds = report.steps[0].bounds
        assert not bounds or abs(true_x - x) <= bounds["stage.x"].most
        assert not bounds or abs(true_y - wanted_y) <= bounds["stage.y"].most, "it stays where it was"
        errors.append(max(abs(true_x - x), abs(true_y - wanted_y)))
    return errors


@pytest.mark.parametrize("moves", [4, pytest.param(1000, marks=[pytest.mark.nightly, pytest.mark.timeout(7200)])])
def test_a_point_is_at_its_targets_by_truth(moves: int) -> None:
    """Straightness of ±16 µm and 0.05 mrad of squareness, at 1 µm a count."""

    async def main(fleet: VirtualFleet) -> list[float]:
        return await measure_errors(fleet, moves)

    errors = run_fleet(main, stage_fleet())
    assert np.percentile(errors, 99) <= 2 * COUNT_MM
    if moves < 100:
        return  # what the mechanics do without tables shows on the path below, too
    bare_errors = run_fleet(main, bare_fleet())
    assert np.percentile(bare_errors, 99) > 8 * COUNT_MM, "the mechanics must show"


def test_a_path_in_its_frame_is_straight_by_truth() -> None:
    line = "speed: 20 mm/s, tolerance: 10 um, pieces: [{piece: line, to: [40, 50]}]"

    async def run_line(fleet: VirtualFleet, frame: str) -> tuple[float, float]:
        await prepare(fleet, 20, 50)
        step = f"{{do: path, axes: [bench.x, bench.y], {frame}start: [20, 50], {line}}}"
        report, seen = await run_seen(fleet, step)
        path = report.steps[0].path
        assert path is not None and path.bound is not None
        return max(abs(y - 50) for _, y in seen), path.bound.predicted

    async def corrected(fleet: VirtualFleet) -> None:
        off, most = await run_line(fleet, "frame: stage, ")
        assert off <= COUNT_MM and off <= most <= 6e-3

    async def bare(fleet: VirtualFleet) -> None:
        off, _ = await run_line(fleet, "")
        assert off > 3 * COUNT_MM

    run_fleet(corrected, stage_fleet())
    run_fleet(bare, bare_fleet())


def test_on_the_way_of_a_move_it_is_off_by_what_the_report_states() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet, 20, 50)
        report, seen = await run_seen(fleet, "{do: move, to: {stage.x: 180}}")
        (step,) = report.steps
        off = max(abs(y - 50) for _, y in seen)
        assert 15 * COUNT_MM < off <= step.virtual["stage.y"].most <= 0.04
        assert abs(seen[-1][1] - 50) <= step.bounds["stage.y"].most
        # Both axes are read, so that it counts as one that moves both.
        assert set(step.members["bench"].axes) == {"x", "y"}

    run_fleet(main, stage_fleet())


@pytest.mark.parametrize(
    "make",
    [
        lambda: make_cia402(2),
        pytest.param(lambda: make_shrc203(2), marks=pytest.mark.nightly),
        pytest.param(lambda: make_smc30(2, 1), marks=pytest.mark.nightly),
    ],
)
def test_the_axis_of_another_controller_moves_along(make: Callable[[], dict[str, Any]]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        for x in (12.5, 13, 29.5, 3):
            report = await outcome(fleet, job(f"[{{do: move, to: {{stage.x: {x}}}}}]"))
            assert report.state == "done", report.reason
            (step,) = report.steps
            true_x, true_y = read_truth(fleet)
            assert abs(true_x - x) <= step.bounds["stage.x"].most
            assert abs(true_y - 10) <= 2 * step.bounds["stage.y"].most, "as it was before, by its bound there"
        shown = (await fleet.make_client().virtual_states())["stage"].axes
        assert shown["x"].position == pytest.approx(true_x, abs=2e-4)
        assert shown["y"].position == pytest.approx(true_y, abs=2e-4)

    run_fleet(main, two_controllers(make()))


def test_a_jog_moves_its_own_axis_alone_and_says_that_it_is_uncorrected() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet, 10, 10)
        client = fleet.make_client()
        jog = (await client.virtual_states())["stage"].jogs["x"]
        assert jog.lacks_tables and jog.rates == [1.0, 0.0]
        begun = len(fleet.controllers["second"].commanded_motions)
        async with client.manual_control(["stage.x"]) as manual:
            with pytest.raises(
                Refusal, match=r"by its own real axis alone, uncorrected, where stage\.y is off by at most 0\.036"
            ):
                await manual.jog({"stage.x": 1000})
            await manual.jog({"stage.x": 5})
            for _ in range(30):
                await asyncio.sleep(0.05)
                await manual.renew_jog()
            await manual.stop()
        assert len(fleet.controllers["second"].commanded_motions) == begun
        true_x, true_y = read_truth(fleet)
        assert true_x > 15 and 0.005 < abs(true_y - 10) <= jog.play["y"]
        shown = (await client.virtual_states())["stage"].axes["y"].position
        assert shown == pytest.approx(true_y, abs=2e-4), "it is shown where it is"
        assert (await outcome(fleet, job("[{do: move, to: {stage.y: 10}}]"))).state == "done"
        assert abs(read_truth(fleet)[1] - 10) <= COUNT_MM

    # A make that changes the speed of a jog only at rest can be jogged as well: one axis needs no common ramp.
    run_fleet(main, two_controllers(make_shrc203(2)))


def test_other_tables_are_another_configuration() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        client = fleet.make_client()
        assert await client.reload_fleet(stage_fleet()) == []
        assert await client.reload_fleet(stage_fleet(squareness="0.06 mrad")) == ["bench"]
        assert not (await client.status())["bench"].axes["y"].referenced
        with pytest.raises(Refusal, match="are not referenced"):
            await client.move({"stage.x": 30})

    run_fleet(main, stage_fleet())


def test_a_user_offset_of_a_real_axis_is_refused_and_shown() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        offset = "{do: set-position, axes: {bench.x: 0}}"
        with pytest.raises(Refusal, match=r"bench\.x has a user offset of -19\.99"):
            steps = f"{{do: move, to: {{stage.x: 20, stage.y: 10}}}}, {offset}, {{do: move, to: {{stage.y: 5}}}}"
            await outcome(fleet, job(f"[{steps}]"))
        await outcome(fleet, job(f"[{offset}]"))
        state = (await fleet.make_client().virtual_states())["stage"]
        assert "and the errors of stage count from its reference" in state.obstacle
        path = "{do: path, axes: [bench.x, bench.y], frame: stage, start: [20, 10], tolerance: 10 um, pieces: [{piece: line, to: [30, 10]}]}"
        for step in ("{do: move, to: {stage.y: 5}}", path):
            report = await outcome(fleet, job(f"[{step}]"))
            assert report.steps[0].refused is not None and report.steps[0].refused.code == "user-offset"
        back = "{do: set-position, axes: {bench.x: null}}, {do: move, to: {stage.y: 5}}"
        assert (await outcome(fleet, job(f"[{back}]"))).state == "done"

    run_fleet(main, stage_fleet())


@pytest.mark.parametrize(
    ("steps", "text"),
    [
        ("{do: move, to: {stage.x: 170, stage.y: -1}}", "beyond its soft limits"),
        ("{do: move, to: {stage.x: 100, bench.y: 20}}", "would be moved by stage and by bench.y"),
        (
            "{do: scan, axes: {stage.x: {from: 0, to: 200, points: 3}, stage.y: {values: [149.99]}}, at_each: [{do: dwell, duration: 1 ms}]}",
            "beyond its soft limits",
        ),
        (
            "{do: scan, axes: {stage.x: {from: 0, to: 200, points: 3}}, fly: {duration: 100 ms}}",
            "only real axes fly",
        ),
    ],
)
def test_what_corrected_axes_cannot_do_is_refused(steps: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        with pytest.raises(Refusal) as caught:
            await outcome(fleet, job(f"[{{do: move, to: {{stage.x: 100, stage.y: 50}}}}, {steps}]"))
        assert text in caught.value.text

    run_fleet(main, stage_fleet())


@pytest.mark.parametrize("speed", ["20 mm/s", pytest.param("{stage.x: 20 mm/s}", marks=pytest.mark.nightly)])
def test_a_speed_of_a_corrected_axis_is_that_of_its_real_axis(speed: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet, 20, 50)
        report = await outcome(fleet, job(f"[{{do: move, to: {{stage.x: 40}}, speed: {speed}}}]"))
        assert report.state == "done", report.reason
        assert report.steps[0].planned_s == pytest.approx(1.04, abs=0.04)

    run_fleet(main, stage_fleet())


def test_a_plane_is_corrected_by_two_positions() -> None:
    first, second = [-30, 0, 15, 30], [-30, 0, 20, 30]
    along_x, along_y = [0, 0, 0.02, 0.005], [0, 0, -0.01, 0.02]

    def make_fleet() -> Fleet:
        plain = two_controllers(make_cia402(2)).to_plain()
        rows = [
            [x, y, ex + ey, 0.001]
            for x, ex in zip(first, along_x, strict=True)
            for y, ey in zip(second, along_y, strict=True)
        ]
        plain["virtual"]["stage"] |= {"tables": {"plane": {"axis": "y", "by": ["x", "y"], "points": rows}}}
        mechanics = {
            "errors_of": {"first.x": [list(row) for row in zip(first, along_x, strict=True)]},
            "errors": [list(row) for row in zip(second, along_y, strict=True)],
        }
        plain["controllers"]["second"]["simulate"]["mechanics"] = {"y": mechanics}
        return Fleet.model_validate(plain)

    async def main(fleet: VirtualFleet) -> None:
        await prepare(fleet)
        for x, y in ((15, 20), (7.5, 5), (29, 29), (1, 12)):
            report = await outcome(fleet, job(f"[{{do: move, to: {{stage.x: {x}, stage.y: {y}}}}}]"))
            assert report.state == "done", report.reason
            bounds, (true_x, true_y) = report.steps[0].bounds, read_truth(fleet)
            assert abs(true_x - x) <= bounds["stage.x"].most
            assert abs(true_y - y) <= bounds["stage.y"].most and bounds["stage.y"].table == 0.001

    run_fleet(main, make_fleet())
