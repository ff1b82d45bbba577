"""Budgets of starts, ends and ways: predicted before a step, true afterwards, and refused where a job allows less."""

import pytest
from cluster.test_chain import chain_fleet
from cluster.worlds import job, outcome, refusal, run_fleet

from orchestrator.client.clocks import clocks
from orchestrator.lab.virtual import VirtualFleet

PREPARE = job("[{do: enable, axes: [line, gantry]}, {do: home, axes: [line, gantry]}]")


@pytest.mark.parametrize("seed", range(3))
def test_starts_and_ends_are_within_what_was_predicted(seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = {name: len(each.motions) for name, each in fleet.controllers.items()}
        move = job("[{do: move, to: {gantry.x: 200, feeder.x: 90, outlet.x: 70}, speed: 0.05}]", max_start_skew="50 ms")
        report = await outcome(fleet, move)
        assert report.state == "done", report.reason
        budget = report.steps[0].budget
        assert budget is not None and budget.end is not None and budget.path is not None
        made = [fleet.controllers[name].motions[before[name]] for name in ("gantry", "feeder", "outlet")]
        starts = [each.start_ns for each in made]
        ends = [each.end_ns or 0 for each in made]
        assert max(starts) - min(starts) <= budget.predicted_ns
        assert max(ends) - min(ends) <= budget.end.predicted_ns
        assert budget.end.allowed_ns is None

    run_fleet(main, chain_fleet(), seed)


@pytest.mark.parametrize("what", ["start", "end", "path"])
def test_a_budget_that_a_job_does_not_allow_refuses_the_step(what: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        move = f"[{{do: move, to: {{gantry.x: 100, feeder.x: 60}}, speed: 0.05, max_{what}_skew: 200 us}}]"
        refused = await refusal(fleet, job(move, max_start_skew="50 ms"))
        assert refused.code == f"{what}-skew" and refused.member in ("gantry", "feeder")
        assert "200 µs" in refused.text or "0.2" in refused.text or "200" in refused.text
        assert refused.remedy
        assert fleet.controllers["gantry"].position("X") == 0

    run_fleet(main, chain_fleet())


def test_every_controllers_clock_can_be_asked_for_and_its_bound_holds_the_rate() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        found = await clocks(fleet.client())
        assert list(found) == ["feeder", "gantry", "outlet", "turner"]
        for name, reply in found.items():
            mapping = reply.mapping
            assert mapping is not None and "clock" in reply.start_classes
            # A crystal that runs fast has shorter ticks.
            true_ppm = -fleet.fleet.controllers[name].simulate.drift_ppm
            assert abs(mapping.rate_ppm - true_ppm) <= mapping.drift_ppm + 1
            assert mapping.bound_ns > 0 and mapping.samples > 5

    run_fleet(main, chain_fleet())
