"""Play and pitch errors behind the motors of a lathe: where its axes truly are, with and without compensation."""

from typing import Any

import numpy as np
from cluster.worlds import EXAMPLES, job, outcome, run_fleet

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

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


async def measure_errors(fleet: VirtualFleet, moves: int, seed: int) -> list[float]:
    """How far z truly is from its target after moves to and fro, mm."""
    await outcome(fleet, job(f"[{PREPARE}, {{do: move, to: {{lathe.z: 100}}}}]"))
    draw = np.random.default_rng(seed)
    errors: list[float] = []
    for _ in range(moves):
        target = round(float(draw.uniform(0.1, 199.9)), 4)
        report = await outcome(fleet, job(f"[{{do: move, to: {{lathe.z: {target}}}}}]"))
        assert report.state == "done", report.reason
        errors.append(abs(fleet.mechanics["lathe"].position("z") - target))
    return errors


def test_an_axis_is_at_its_targets_by_truth_in_moves_to_and_fro() -> None:
    async def main(fleet: VirtualFleet) -> list[float]:
        _ = fleet.mechanics  # follows the motors from the start
        return await measure_errors(fleet, 40, 1)

    errors = run_fleet(main, lathe_fleet())
    assert max(errors) <= 2 * COUNT_MM
    bare_errors = run_fleet(main, lathe_fleet(compensated=False))
    assert max(bare_errors) > 20 * COUNT_MM, "the mechanics must show"


def test_a_cross_slide_ends_in_one_direction_after_an_overrun() -> None:
    async def main(fleet: VirtualFleet) -> None:
        mechanics = fleet.mechanics["lathe"]
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
        mechanics = fleet.mechanics["lathe"]
        steps = ", ".join(
            f"{{do: move, to: {{lathe.z: {target}}}}}" for target in (60, 55, 70, 69.99, 69.98, 69.99, 70.1)
        )
        report = await outcome(fleet, job(f"[{PREPARE}, {steps}]"))
        assert report.state == "done", report.reason
        assert [step.chain.kept for step in report.steps[3:] if step.chain is not None] == [True] * 6
        assert abs(mechanics.position("z") - 70.1) <= report.steps[-1].bounds["lathe.z"].most

    run_fleet(main, lathe_fleet())
