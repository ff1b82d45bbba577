"""Two SHRC-203 in a fleet: one drives the trigger line that the other waits for, with or without axes of its own in
the step."""

from typing import Any

import pytest
from cluster.worlds import demo_fleet, job, outcome, run_fleet

from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

PREPARE = job("[{do: enable, axes: [stage, other]}, {do: home}]")
MOVES = {
    "{stage.u: 5, stage.v: 3, other.u: 4}": {"stage": "host", "other": "line"},
    "{other.u: 1, other.v: 2}": {"stage": "host", "other": "line"},
    "{stage.u: 2, other.u: 3}": {"stage": "host", "other": "line"},
}


def fleet() -> Fleet:
    """Two stages on ports of their own."""
    plain = demo_fleet().to_plain()
    stage: dict[str, Any] = plain["controllers"]["stage"]
    points = {"inputs": {"start": {"number": 2}}, "outputs": {"line": {"number": 3}}}
    other = stage | points | {"link": stage["link"] | {"device": "/dev/ttyUSB7"}}
    return Fleet.model_validate(
        plain
        | {
            "controllers": {"stage": stage | points, "other": other},
            "groups": {},
            "home_order": ["stage", "other"],
            "permits": {},
            "wiring": [{"from": "stage.line", "to": ["other.start"], "delay_us": [1, 20]}],
        }
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_stage_drives_the_trigger_line_that_starts_another(seed: int) -> None:
    async def main(world: VirtualFleet) -> None:
        assert (await outcome(world, PREPARE)).state == "done"
        for targets, ways in MOVES.items():
            before = {name: len(unit.commanded_motions) for name, unit in world.controllers.items()}
            asked = job(f"[{{do: move, to: {targets}, start: line}}]", max_start_skew="20 ms")
            report = await outcome(world, asked)
            assert report.state == "done", report.reason
            (step,) = report.steps
            assert {name: member.start_class for name, member in step.members.items()} == ways
            made = [m for name, unit in world.controllers.items() for m in unit.commanded_motions[before[name] :]]
            assert len(made) == targets.count(":")
            starts = [each.start_ns for each in made]
            assert step.start_skew is not None
            assert step.start_skew.at_least_ns <= max(starts) - min(starts) <= step.start_skew.at_most_ns
            assert not world.controllers["stage"].output_level(3)

    run_fleet(main, fleet(), seed)
