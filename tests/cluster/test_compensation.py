"""Play and pitch errors behind the motors of a lathe: where its axes truly are, with and without compensation."""

import asyncio
from math import hypot
from typing import Any

import numpy as np
import pytest
from cluster.worlds import EXAMPLES, job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.mechanics import Mechanics

PREPARE = "{do: enable, axes: [lathe]}, {do: home, axes: [lathe]}"
COUNT_MM = 1e-3


def lathe_fleet(*, compensated: bool = True, **axis_z: Any) -> Fleet:
    """The example; without compensation the play and the errors of its mechanics stay."""
    plain = load_fleet(EXAMPLES / "lathe.fleet.yaml").to_plain()
    axes = plain["controllers"]["lathe"]["axes"]
    if not compensated:
        for axis in axes.values():
            axis.pop("backlash", None)
            axis.pop("correction", None)
    axes["z"] |= axis_z
    return Fleet.model_validate(plain)


def find_mechanics(fleet: VirtualFleet) -> Mechanics:
    """What is behind the motors: where the axes truly are."""
    return Mechanics(fleet.controllers["lathe"], fleet.fleet.controllers["lathe"])


async def measure_errors(fleet: VirtualFleet, moves: int) -> list[float]:
    """How far z truly is from its target after moves to and fro, mm; never farther than its bound."""
    await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{lathe.z: 100}}}}]"))
    draw, mechanics = np.random.default_rng(1), find_mechanics(fleet)
    errors: list[float] = []
    for _ in range(moves):
        target = round(float(draw.uniform(0.1, 199.9)), 4)
        report = await outcome(fleet, job(f"[{{do: move, to: {{lathe.z: {target}}}}}]"))
        assert report.state == "done", report.reason
        errors.append(abs(mechanics.position("z") - target))
        bounds = report.steps[0].bounds
        assert not bounds or errors[-1] <= bounds["lathe.z"].most
    return errors


@pytest.mark.parametrize("moves", [16, pytest.param(1000, marks=pytest.mark.nightly)])
def test_an_axis_is_at_its_targets_by_truth_in_moves_to_and_fro(moves: int) -> None:
    """Play of 20 µm and pitch errors of ±15 µm, at 1 µm a count."""

    async def main(fleet: VirtualFleet) -> list[float]:
        return await measure_errors(fleet, moves)

    errors = run_fleet(main, lathe_fleet())
    assert np.percentile(errors, 99) <= 2 * COUNT_MM
    bare_errors = run_fleet(main, lathe_fleet(compensated=False))
    assert np.percentile(bare_errors, 99) > 20 * COUNT_MM, "the mechanics must show"


def test_a_cross_slide_ends_in_one_direction_after_an_overrun() -> None:
    async def main(fleet: VirtualFleet) -> None:
        mechanics = find_mechanics(fleet)
        await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{lathe.x: 30}}}}]"))
        for target in (20, 19.5, 19.51, 40, 39.999):
            begun = len(fleet.controllers["lathe"].commanded_motions)
            report = await outcome(fleet, job(f"[{{do: move, to: {{lathe.x: {target}}}}}]"))
            assert report.state == "done", report.reason
            motions = fleet.controllers["lathe"].commanded_motions[begun:]
            assert len(motions) == (1 if target in (19.51, 40) else 2), target
            assert motions[-1].end_counts is not None and motions[-1].end_counts > motions[-1].start_counts
            assert abs(mechanics.position("x") - target) <= report.steps[0].bounds["lathe.x"].most
            assert report.steps[0].bounds["lathe.x"].play == 0

    run_fleet(main, lathe_fleet())


def test_moves_in_one_job_follow_each_other_with_the_play_in_both() -> None:
    async def main(fleet: VirtualFleet) -> None:
        mechanics = find_mechanics(fleet)
        steps = ", ".join(
            f"{{do: move, to: {{lathe.z: {target}}}}}" for target in (60, 55, 70, 69.99, 69.98, 69.99, 70.1)
        )
        report = await outcome(fleet, job(f"[{PREPARE}, {steps}]"))
        assert report.state == "done", report.reason
        assert [step.chain.kept for step in report.steps[3:] if step.chain is not None] == [True] * 6
        assert abs(mechanics.position("z") - 70.1) <= report.steps[-1].bounds["lathe.z"].most

    run_fleet(main, lathe_fleet())


def test_a_path_follows_the_table_and_states_the_play_of_its_reversals() -> None:
    axes = {"z": {"interpolation": "cubic"}}

    async def main(fleet: VirtualFleet) -> None:
        mechanics = find_mechanics(fleet)
        await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{lathe.z: 30, lathe.x: 20}}}}]"))
        radii: list[float] = []

        async def watch() -> None:
            while True:
                radii.append(hypot(mechanics.position("z") - 50, mechanics.position("x") - 20))
                await sleep_ns(fleet.clock, NS_PER_MS)

        watching = asyncio.get_running_loop().create_task(watch())
        arc = "{piece: arc, to: [30, 20], centre: [50, 20]}"
        path = f"{{do: path, axes: [lathe.z, lathe.x], start: [30, 20], speed: 20 mm/s, tolerance: 60 um, pieces: [{arc}]}}"
        report = await outcome(fleet, job(f"[{path}]"))
        watching.cancel()
        assert report.state == "done", report.reason
        path_report = report.steps[0].path
        assert path_report is not None and path_report.bound is not None
        assert max(abs(radius - 20) for radius in radii) <= path_report.bound.predicted <= 0.035
        assert {term.name for term in path_report.bound.terms} >= {"compensation"}
        # Where the play is after that is not known, and the next move says so until it has taken it up.
        moved_report = await outcome(fleet, job("[{do: move, to: {lathe.z: 30.01}}, {do: move, to: {lathe.z: 31}}]"))
        first_play, second_play = (step.bounds["lathe.z"].play for step in moved_report.steps)
        assert 0 < first_play <= 0.02 and second_play == 0
        assert abs(mechanics.position("z") - 31) <= moved_report.steps[1].bounds["lathe.z"].most

    fleet = lathe_fleet(correction={**lathe_fleet().axis("lathe.z").to_plain()["correction"], **axes["z"]})
    plain = fleet.to_plain()
    for axis in plain["controllers"]["lathe"]["axes"].values():
        axis["limits"]["jerk"] = 20_000
    run_fleet(main, Fleet.model_validate(plain))


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ("{do: move, to: {lathe.x: 0.01}}", "the overrun of 0.03 mm leads to"),
        ("{do: move, to: {lathe.z: 0}, approach: positive}", "the overrun of 0.04 mm leads to"),
    ],
)
def test_what_cannot_be_compensated_is_refused_by_name(step: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{lathe.z: 50, lathe.x: 50}}}}]"))
        begun = len(fleet.controllers["lathe"].commanded_motions)
        report = await outcome(fleet, job(f"[{step}]"))
        assert report.state == "failed" and text in report.reason
        assert len(fleet.controllers["lathe"].commanded_motions) == begun

    run_fleet(main, lathe_fleet())


def test_a_flight_of_a_compensated_axis_is_refused_when_it_is_submitted() -> None:
    async def main(fleet: VirtualFleet) -> None:
        scan = "{do: scan, axes: {lathe.z: {from: 10, to: 20, points: 11}}, fly: {duration: 100 ms}}"
        with pytest.raises(Refusal, match="which are not applied in flight yet"):
            await outcome(fleet, job(f"[{scan}]"))

    run_fleet(main, lathe_fleet())


def test_play_is_taken_up_at_its_own_speed_before_a_move_that_reverses() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{lathe.z: 50}}}}]"))
        begun = len(fleet.controllers["lathe"].commanded_motions)
        report = await outcome(fleet, job("[{do: move, to: {lathe.z: 40}}, {do: move, to: {lathe.z: 30}}]"))
        assert report.state == "done", report.reason
        motions = fleet.controllers["lathe"].commanded_motions[begun:]
        distances = [motion.end_counts - motion.start_counts for motion in motions if motion.end_counts is not None]
        assert len(distances) == 3 and distances[0] == -20
        assert abs(find_mechanics(fleet).position("z") - 30) <= report.steps[1].bounds["lathe.z"].most

    run_fleet(main, lathe_fleet(backlash={"amount": 0.02, "speed": 1.0}))


def test_shown_positions_are_those_of_the_axis_and_counts_those_of_the_motor() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{lathe.z: 60}}}}, {{do: move, to: {{lathe.z: 50}}}}]"))
        state = (await client.status())["lathe"].axes["z"]
        assert state.position == pytest.approx(50, abs=COUNT_MM)
        # 15 µm of pitch error, and 20 µm of play on the way down.
        assert state.commanded_counts == 50_000 - 15 - 20
        assert state.play is not None and (state.play.least, state.play.most) == (20, 20)

    run_fleet(main, lathe_fleet())
