"""Steps back to back on the virtual demo fleet: how close they follow, and what happens with one step loaded behind a
moving one."""

import asyncio
from itertools import pairwise
from statistics import median

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from adapters.controller.slots.participant import StepParticipant
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import CommitRequest, CommittedReply
from orchestrator.model.report import JobReport
from orchestrator.runtime.simulated_fleets import make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

THERE, BACK = "{do: move, to: {gantry.x: 20}}", "{do: move, to: {gantry.x: 0}}"
LONG = "{do: move, to: {gantry.x: 300}, speed: 0.5}"
BOTH = "{do: move, to: {gantry.x: 20, stage.u: 4}}, {do: move, to: {gantry.x: 0, stage.u: 0}}"


def motions(fleet: VirtualFleet, controller: str, motor: str) -> list[tuple[int, int]]:
    """Start and end of the true motions of one motor."""
    made = fleet.controllers[controller].commanded_motions
    return [(each.start_ns, each.end_ns) for each in made if each.axis == motor and each.end_ns is not None]


def gaps_ms(fleet: VirtualFleet, controller: str, motor: str, count: int) -> list[float]:
    """The times between the last `count` motions of one motor."""
    made = motions(fleet, controller, motor)[-count:]
    return [(after[0] - before[1]) / NS_PER_MS for before, after in pairwise(made)]


def chained(report: JobReport) -> list[bool | None]:
    """Of each motion step: whether it began behind the one before; None for the first."""
    return [None if step.chain is None else step.chain.kept for step in report.steps if step.do == "move"]


def breaks(report: JobReport) -> list[str]:
    """Why motion steps began from rest."""
    return [step.chain.broken for step in report.steps if step.chain is not None and not step.chain.kept]


async def wait_for_motion(fleet: VirtualFleet, controller: str = "gantry", motor: str = "X") -> None:
    """Wait until a motor moves."""
    while not fleet.controllers[controller].is_moving(motor):
        await sleep_ns(fleet.clock, NS_PER_MS)


def test_steps_of_one_controller_follow_each_other_within_sixteen_samples() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        await outcome(fleet, job(f"[{', '.join([THERE, BACK] * 10)}]"))  # what this fleet needs is known then
        report = await outcome(fleet, job(f"[{', '.join([THERE, BACK] * 5)}]"))
        assert report.state == "done", report.reason
        assert chained(report) == [None, *[True] * 9]
        assert all(step.verdict == "green" for step in report.steps)
        measured = gaps_ms(fleet, "gantry", "X", 10)
        # Thirteen samples for the program; the end, T0 and the begin are rounded to whole ones.
        assert max(measured) <= 15.7 and median(measured) <= 15.0, measured
        stated = [step.chain.gap_s * 1000 for step in report.steps if step.chain and step.chain.gap_s is not None]
        assert stated == pytest.approx(measured, abs=2.0)

    run_fleet(main)


def test_steps_of_two_makes_follow_each_other_within_sixty_milliseconds() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        await outcome(fleet, job(f"[{', '.join([BOTH] * 10)}]"))
        report = await outcome(fleet, job(f"[{', '.join([BOTH] * 5)}]"))
        assert report.state == "done", report.reason
        assert chained(report) == [None, *[True] * 9] and all(step.verdict == "green" for step in report.steps)
        assert max(gaps_ms(fleet, "gantry", "X", 10)) <= 65.0
        for step in report.steps:
            assert step.start_skew is not None and step.budget is not None
            assert step.start_skew.at_most_ns <= step.budget.allowed_ns

    run_fleet(main)


@pytest.mark.nightly
def test_eight_controllers_follow_together() -> None:
    controllers = {f"c{number}": make_smc4000(number) for number in range(8)}
    eight = Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "eight", "controllers": controllers})

    async def main(fleet: VirtualFleet) -> None:
        there = ", ".join(f"{name}.x: 2" for name in controllers)
        pair = f"{{do: move, to: {{{there}}}}}, {{do: move, to: {{{there.replace(': 2', ': 0')}}}}}"
        names = ", ".join(controllers)
        await outcome(fleet, job(f"[{{do: enable, axes: [{names}]}}, {{do: home}}, {', '.join([pair] * 10)}]"))
        report = await outcome(fleet, job(f"[{', '.join([pair] * 5)}]"))
        assert report.state == "done" and chained(report) == [None, *[True] * 9]
        ends = [[motions(fleet, name, "X")[-10 + k] for name in controllers] for k in range(10)]
        for before, after in pairwise(ends):
            assert min(start for start, _ in after) - max(end for _, end in before) <= 20 * NS_PER_MS
            assert max(start for start, _ in after) - min(start for start, _ in after) <= 2 * NS_PER_MS

    run_fleet(main, eight)


@pytest.mark.parametrize(
    ("between", "reason"),
    [
        ("{do: wait, input: gantry.door, value: false, timeout: 1 s}", "step 2 (wait) comes before it"),
        ("{do: home, axes: [stage.v]}", "step 2 (home) comes before it"),
        ("{do: enable, axes: [stage.v]}", "step 2 (enable) comes before it"),
    ],
)
def test_what_breaks_a_chain_is_in_the_report(between: str, reason: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        report = await outcome(fleet, job(f"[{THERE}, {between}, {BACK}]"))
        assert report.state == "done", report.reason
        assert breaks(report) == [reason]

    run_fleet(main)


def test_a_dwell_between_two_steps_is_kept_and_costs_no_more() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        await outcome(fleet, job(f"[{', '.join([THERE, BACK] * 10)}]"))
        report = await outcome(fleet, job(f"[{THERE}, {{do: dwell, duration: 80 ms}}, {BACK}]"))
        assert chained(report) == [None, True]
        (gap_ms,) = gaps_ms(fleet, "gantry", "X", 2)
        assert 80.0 <= gap_ms <= 85.0

    run_fleet(main)


def test_outputs_between_two_steps_are_switched_at_rest() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        edges: list[tuple[int, bool]] = []
        fleet.controllers["gantry"].on_output(lambda number, level: edges.append((fleet.clock.now_ns(), level)))
        steps = [THERE, "{do: output, output: gantry.lamp, value: true, pulse: 10 ms}", BACK] * 6
        report = await outcome(fleet, job(f"[{', '.join([*steps, '{do: dwell, duration: 1 ms}'])}]"))
        assert report.state == "done", report.reason
        assert chained(report)[1:] == [True] * 11
        made = motions(fleet, "gantry", "X")[-12:]
        assert len(edges) == 12
        for at_ns, _ in edges:
            assert not any(start < at_ns < end for start, end in made)

    run_fleet(main)


@pytest.mark.parametrize("start", ["agreed", "at_once"])
def test_a_pause_takes_effect_before_a_step_that_is_loaded_already(start: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        steps = ", ".join(f"{step[:-1]}, start: {start}}}" for step in (LONG, BACK))
        submitted = await fleet.make_client().submit(job(f"[{steps}]"))
        await wait_for_motion(fleet)
        await sleep_ns(fleet.clock, 1500 * NS_PER_MS)  # loaded, and not yet decided
        await submitted.pause()
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        assert fleet.controllers["gantry"].position("X") == 300_000
        await submitted.resume()
        report = await submitted.result()
        assert report.state == "done" and fleet.controllers["gantry"].position("X") == 0
        assert breaks(report) == ["the job is paused"]
        assert len(fleet.journal.list_decisions(report.job_id)) == 2

    run_fleet(main)


def test_a_feed_hold_unloads_what_is_behind_the_moving_step() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await fleet.make_client().submit(job(f"[{LONG}, {{do: move, to: {{gantry.y: 20, stage.u: 2}}}}]"))
        await wait_for_motion(fleet)
        await sleep_ns(fleet.clock, NS_PER_S)
        await submitted.pause(now=True)
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        assert 0 < fleet.controllers["gantry"].position("X") < 300_000
        assert fleet.controllers["stage"].position("1") == 0
        await submitted.resume()
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert fleet.controllers["stage"].position("1") == 20_000

    run_fleet(main)


@pytest.mark.parametrize(
    ("how", "before_end_ms"),
    [
        *(("stop", ms) for ms in (400, 60, 20, -5, -40)),
        *(("estop", ms) for ms in (60, -5)),
        *(("cancel", ms) for ms in (60, 20)),
    ],
)
def test_nothing_of_a_loaded_step_moves_after_a_stop(how: str, before_end_ms: int) -> None:
    """At moments from its loading, over its release, to just after its start."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        await outcome(fleet, job(f"[{', '.join([THERE, BACK] * 10)}]"))
        client = fleet.make_client()
        submitted = await client.submit(job(f"[{{do: move, to: {{gantry.x: 120}}}}, {BACK}]"))
        await wait_for_motion(fleet)
        taken_ns = round((120 / 200 + 200 / 1000) * NS_PER_S)
        await sleep_ns(fleet.clock, taken_ns - before_end_ms * NS_PER_MS)
        if how == "cancel":
            await submitted.cancel()
        elif how == "stop":
            await client.stop()
        else:
            await client.estop()
        asked_ns = fleet.clock.now_ns()
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        report = await submitted.result()
        assert report.state != "done"
        for start_ns, end_ns in motions(fleet, "gantry", "X")[-2:]:
            assert start_ns <= asked_ns + 5 * NS_PER_MS and end_ns <= asked_ns + 250 * NS_PER_MS

    run_fleet(main)


def test_a_controller_whose_axis_met_a_switch_does_not_begin_the_loaded_step_even_without_its_host() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        await outcome(fleet, job(f"[{', '.join([THERE, BACK] * 10)}]"))
        gantry = fleet.controllers["gantry"]
        before = len(motions(fleet, "gantry", "X"))
        slowly = "{do: move, to: {gantry.x: 10}, speed: 0.1}"  # its ramps take 20 ms of 520
        submitted = await fleet.make_client().submit(job(f"[{slowly}, {BACK}]"))
        await wait_for_motion(fleet)
        await sleep_ns(fleet.clock, 490 * NS_PER_MS)
        gantry.set_limit("X", "forward")
        await sleep_ns(fleet.clock, 10 * NS_PER_MS)  # released by now
        fleet.freeze("host/local")
        await sleep_ns(fleet.clock, 300 * NS_PER_MS)
        assert not gantry.is_moving("X") and len(motions(fleet, "gantry", "X")) == before + 1
        fleet.resume("host/local")
        assert (await submitted.result()).state != "done"

    run_fleet(main)


def test_a_member_that_is_late_lets_the_fleet_rest_and_the_step_begin_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    commit, calls = StepParticipant.commit_step, list[int]()

    async def slow(member: StepParticipant, request: CommitRequest) -> CommittedReply:
        reply = await commit(member, request)
        if request.step == 1 and not calls:
            calls.append(1)
            await asyncio.sleep(0.6)
        return reply

    monkeypatch.setattr(StepParticipant, "commit_step", slow)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        calls.clear()
        report = await outcome(fleet, job(f"[{THERE}, {BACK}, {THERE}]".replace("}}", "}, start: agreed}")))
        assert report.state == "done", report.reason
        assert chained(report) == [None, False, True]
        assert "has not answered commit" in breaks(report)[0]
        assert [step.verdict for step in report.steps] == ["green"] * 3

    run_fleet(main)


def test_a_member_that_refuses_the_loaded_step_is_named_and_the_step_fails_from_rest() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        submitted = await client.submit(job(f"[{LONG}, {{do: move, to: {{stage.u: 5}}}}]"))
        await wait_for_motion(fleet)
        fleet.controllers["stage"].set_limit("1", "forward")
        report = await submitted.result()
        assert report.state == "failed" and "stage" in report.reason
        assert fleet.controllers["gantry"].position("X") == 300_000
        assert fleet.controllers["stage"].position("1") == 0

    run_fleet(main)


def test_each_step_of_a_chain_has_its_own_decision_in_the_journal() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        steps = f"[{', '.join([THERE, BACK] * 3)}]".replace("}}", "}, start: agreed}")
        job_id = await client.submit(job(steps))
        report = await client.wait_for_job(job_id)
        decided = fleet.journal.list_decisions(job_id)
        t0s: dict[int, int | None] = {step.index: step.t0_fleet_ns for step in report.steps}
        assert dict(decided) == t0s and len(decided) == 6

    run_fleet(main)


def test_a_step_that_must_settle_in_position_breaks_the_chain() -> None:
    plain = demo_fleet().to_plain()
    plain["controllers"]["gantry"]["axes"]["x"] |= {"done": "in_position", "in_position_window": 0.05}

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        report = await outcome(fleet, job(f"[{THERE}, {BACK}]"))
        assert report.state == "done" and breaks(report) == ["gantry.x must settle in position before it"]

    run_fleet(main, Fleet.model_validate(plain))


def test_many_steps_between_two_motion_steps_are_the_reason_that_is_stated() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        dwells = ", ".join(["{do: dwell, duration: 1 ms}"] * 21)
        report = await outcome(fleet, job(f"[{THERE}, {dwells}, {BACK}, {THERE}]"))
        assert report.state == "done" and chained(report) == [None, False, True]
        assert breaks(report) == ["more than 20 steps come before it"]

    run_fleet(main)


def test_a_chained_step_that_was_paused_in_its_motion_counts_as_begun_from_rest() -> None:
    """Its record is that of the last part, which is long after the end of the step before."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await fleet.make_client().submit(job(f"[{THERE}, {LONG}]"))
        await wait_for_motion(fleet)
        while len(motions(fleet, "gantry", "X")) < 2 or not fleet.controllers["gantry"].is_moving("X"):
            await sleep_ns(fleet.clock, NS_PER_MS)
        await sleep_ns(fleet.clock, NS_PER_S // 2)
        await submitted.pause(now=True)
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        await submitted.resume()
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert chained(report) == [None, False] and breaks(report) == ["it was braked on the way"]

    run_fleet(main)
