"""Budgets of starts, ends and ways: predicted before a step, true afterwards, and refused where a job allows less."""

import pytest
from cluster.test_chain import chain_fleet
from cluster.worlds import PREPARE as DEMO_PREPARE
from cluster.worlds import demo_fleet, job, origin_host_ns, outcome, refusal, run_fleet
from rich.console import Console

from orchestrator.client.clocks import query_clocks
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.fleet import Fleet
from orchestrator.monitor.report_table import make_report_tables
from orchestrator.runtime.simulated_fleets import make_ppsmc, make_shrc203, make_smc30, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

PREPARE = job("[{do: enable, axes: [line, gantry]}, {do: home, axes: [line, gantry]}]")


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.nightly) for n in (1, 2))])
def test_starts_and_ends_are_within_what_was_predicted(seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
        move = job("[{do: move, to: {gantry.x: 200, feeder.x: 90, outlet.x: 70}, speed: 0.05}]", max_start_skew="50 ms")
        report = await outcome(fleet, move)
        assert report.state == "done", report.reason
        budget = report.steps[0].budget
        assert budget is not None and budget.end is not None and budget.path is not None
        made = [fleet.controllers[name].commanded_motions[before[name]] for name in ("gantry", "feeder", "outlet")]
        starts = [each.start_ns for each in made]
        ends = [each.end_ns or 0 for each in made]
        assert max(starts) - min(starts) <= budget.predicted_ns
        assert max(ends) - min(ends) <= budget.end.predicted_ns
        assert budget.end.allowed_ns is None

    run_fleet(main, chain_fleet(), seed)


def test_a_budget_that_a_job_does_not_allow_refuses_the_step() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        for what in ("start", "end", "path"):
            move = f"[{{do: move, to: {{gantry.x: 100, feeder.x: 60}}, speed: 0.05, max_{what}_skew: 200 us}}]"
            refused = await refusal(fleet, job(move, max_start_skew="50 ms"))
            assert refused.code == f"{what}-skew" and refused.member in ("gantry", "feeder")
            assert "200 µs" in refused.text or "0.2" in refused.text or "200" in refused.text
            assert refused.remedy
            assert fleet.controllers["gantry"].position("X") == 0

    run_fleet(main, chain_fleet())


def test_every_controllers_clock_can_be_queried_and_its_bound_contains_the_rate() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        found = await query_clocks(fleet.make_client())
        assert list(found) == ["feeder", "gantry", "outlet", "turner"]
        for name, reply in found.items():
            mapping = reply.mapping
            assert mapping is not None and "clock" in reply.start_classes
            # A crystal that runs fast has shorter ticks.
            true_ppm = -fleet.fleet.controllers[name].simulate.drift_ppm
            assert abs(mapping.rate_ppm - true_ppm) <= mapping.drift_ppm + 1
            assert mapping.bound_ns > 0 and mapping.samples > 5

    run_fleet(main, chain_fleet())


@pytest.mark.parametrize(("decode_us", "kept"), [(1000, True), (7000, False)])
def test_a_vague_start_is_narrowed_by_the_promise_and_the_evidence_alone_holds_without_it(
    decode_us: int, kept: bool
) -> None:
    """A serial adapter that delays answers, and a controller that decodes slower than its make promises."""
    plain = demo_fleet().model_dump(by_alias=True, mode="json", exclude_none=True)
    plain["controllers"]["stage"]["simulate"] |= {"hold_ms": 16.0, "decode_us": decode_us}

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job("[{do: enable, axes: [stage]}, {do: home, axes: [stage]}]"))
        starts = []
        for target in (5, 1, 5, 1):
            before = len(fleet.controllers["stage"].commanded_motions)
            report = await outcome(fleet, job(f"[{{do: move, to: {{stage.u: {target}}}}}]", max_start_skew="50 ms"))
            assert report.state == "done", report.reason
            origin_ns = origin_host_ns(fleet)
            true_ns = fleet.controllers["stage"].commanded_motions[before].start_ns - origin_ns
            evidence = report.steps[0].members["stage"].evidence["u"]
            assert evidence.start.earliest_ns <= true_ns <= evidence.start.latest_ns
            if evidence.modelled is not None:
                starts.append(evidence.modelled.earliest_ns <= true_ns <= evidence.modelled.latest_ns)
        assert starts and all(each is kept for each in starts)

    run_fleet(main, Fleet.model_validate(plain))


@pytest.mark.parametrize("decode_us", [1000, 14_000])
def test_a_verdict_is_green_only_if_evidence_and_promises_both_hold(decode_us: int) -> None:
    """A controller that starts later than its make promises, behind an adapter that hides it: by the promise the skew
    is a few milliseconds, and the evidence allows more than the job."""
    plain = demo_fleet().model_dump(by_alias=True, mode="json", exclude_none=True)
    plain["controllers"]["stage"]["simulate"] |= {"hold_ms": 16.0, "decode_us": decode_us}

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, DEMO_PREPARE)
        for target in (5, 1, 5):
            before = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
            move = f"[{{do: move, to: {{gantry.x: {60 + target}, stage.u: {target}}}}}]"
            report = await outcome(fleet, job(move, max_start_skew="10 ms"))
            assert report.state == "done", report.reason
            starts = [each.commanded_motions[before[name]].start_ns for name, each in fleet.controllers.items()]
            step, true_ns = report.steps[0], max(starts) - min(starts)
            assert step.start_skew is not None and step.promised_skew is not None
            assert step.start_skew.at_least_ns <= true_ns <= step.start_skew.at_most_ns
            assert step.promised_skew.at_most_ns < min(10 * NS_PER_MS, step.start_skew.at_most_ns)
            assert step.verdict == ("green" if step.start_skew.at_most_ns <= 10 * NS_PER_MS else "amber")
            # By the promise alone it was green, and the truth is another.
            assert decode_us == 1000 or (step.verdict == "amber" and true_ns > 10 * NS_PER_MS)
            shown = Console(width=200)
            with shown.capture() as text:
                shown.print(make_report_tables(report, detailed=True))
            assert "by the controllers' evidence, ≤" in text.get()

    run_fleet(main, Fleet.model_validate(plain))


def test_a_move_too_slow_for_its_controller_ends_early_as_far_as_the_job_allows() -> None:
    slow = {"stage": make_shrc203(0), "pulses": make_ppsmc(1), "steps": make_smc30(2, 1)}
    plain = {"schema": "tutti.fleet/1", "fleet": "slow", "controllers": {"gantry": make_smc4000(3), **slow}}
    # Some tenths of a second at the lowest start rates, against one of two seconds.
    way = "{gantry.x: 100, stage.x: 0.004, pulses.x: 25, steps.x: 0.02}"

    async def main(fleet: VirtualFleet) -> None:
        axes = list(fleet.controllers)
        await outcome(fleet, job(f"[{{do: enable, axes: {axes}}}, {{do: home, axes: {axes}}}]"))
        before = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
        move = f"[{{do: move, by: {way}, speed: 0.2}}]"
        refused = await refusal(fleet, job(move, max_start_skew="50 ms"))
        assert refused.code == "too-slow" and refused.member in slow and "max_end_skew" in (refused.remedy or "")
        assert before == {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
        report = await outcome(fleet, job(move, max_start_skew="50 ms", max_end_skew="3 s"))
        assert report.state == "done", report.reason
        step = report.steps[0]
        ends: dict[str, int] = {}
        for name, each in fleet.controllers.items():
            (motion,) = each.commanded_motions[before[name] :]
            evidence = step.members[name].evidence["x"].end
            ends[name] = (motion.end_ns or 0) - origin_host_ns(fleet)
            assert evidence is not None and evidence.earliest_ns <= ends[name] <= evidence.latest_ns
        assert all(ends["gantry"] - ends[name] > 500 * NS_PER_MS for name in slow), ends

    run_fleet(main, Fleet.model_validate(plain))
