"""Steps that a trigger line starts: an SMC-4000 drives it, an SHRC-203 and another SMC-4000 wait for it."""

import asyncio
from typing import Any

import pytest
from cluster.worlds import demo_fleet, job, outcome, refusal, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_US, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import JobReport, StepReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

PREPARE = job("[{do: enable, axes: [gantry, stage, portal]}, {do: home}]")
WAITERS = job("[{do: move, to: {stage.u: 5, stage.v: 3, portal.x: 60}, start: line}]")


def wired_fleet(delay_us: tuple[int, int] = (5, 40), **line: Any) -> Fleet:
    """The demo fleet with a second gantry, and a wire from the first one's output 2 to the others' inputs 2."""
    plain = demo_fleet().to_plain()
    gantry = plain["controllers"]["gantry"]
    portal = gantry | {
        "link": gantry["link"] | {"host": "192.168.1.21"},
        "inputs": {"start": {"number": 2, "active": "low"}},
        "outputs": {},
        "simulate": gantry["simulate"] | {"offset_s": 17.3, "drift_ppm": -61.0},
    }
    gantry["outputs"] = gantry["outputs"] | {"start": {"number": 2}}
    stage = plain["controllers"]["stage"] | {"inputs": {"start": {"number": 2, "active": "high"}}}
    wire = {"from": "gantry.start", "to": ["stage.start", "portal.start"], "delay_us": list(delay_us)} | line
    return Fleet.model_validate(
        plain
        | {
            "controllers": {"gantry": gantry, "stage": stage, "portal": portal},
            "groups": {},
            "home_order": ["stage", "gantry", "portal"],
            "wiring": [wire],
        }
    )


def judged_rightly(fleet: VirtualFleet, report: JobReport, before: dict[str, int]) -> tuple[StepReport, int]:
    """The step, and its true start skew, which its verdict holds."""
    assert report.state == "done", report.reason
    step = report.steps[0]
    made = [m for name, each in fleet.controllers.items() for m in each.commanded_motions[before[name] :]]
    assert len(made) == sum(len(member.axes) for member in step.members.values())
    starts = [motion.start_ns for motion in made]
    skew_ns = max(starts) - min(starts)
    assert step.start_skew is not None and step.budget is not None
    assert step.start_skew.at_least_ns <= skew_ns <= step.start_skew.at_most_ns
    assert skew_ns <= step.budget.predicted_ns
    return step, skew_ns


def count(fleet: VirtualFleet) -> dict[str, int]:
    return {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}


@pytest.mark.parametrize("seed", range(4))
def test_members_that_all_wait_for_the_line_start_together_by_it(seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = count(fleet)
        step, _ = judged_rightly(fleet, await outcome(fleet, WAITERS), before)
        ways = {name: member.start_class for name, member in step.members.items()}
        assert ways == {"gantry": "clock", "stage": "line", "portal": "line"}
        assert step.budget is not None and step.budget.by_trigger_line
        # The trigger line is passive again, so that it can start the next step.
        before = count(fleet)
        step, _ = judged_rightly(
            fleet, await outcome(fleet, job("[{do: move, by: {stage.u: -2, portal.x: -10}, start: line}]")), before
        )
        assert step.members["stage"].start_class == "line"

    run_fleet(main, wired_fleet(), seed)


def test_the_driver_of_a_trigger_line_moves_with_the_members_that_wait_for_it() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = count(fleet)
        asked = job("[{do: move, to: {stage.u: 5, portal.x: 60, gantry.x: 80}, start: line}]")
        step, _ = judged_rightly(fleet, await outcome(fleet, asked), before)
        assert {name: member.start_class for name, member in step.members.items()} == {
            "gantry": "clock",
            "stage": "line",
            "portal": "line",
        }

    run_fleet(main, wired_fleet())


def test_a_member_without_a_wire_starts_when_the_trigger_line_starts_the_others() -> None:
    """Its own T0 is later than that of the line by the way of the edge, here 4 ms."""
    plain = wired_fleet(delay_us=(4000, 4010)).to_plain()
    plain["controllers"]["apart"] = plain["controllers"]["portal"] | {
        "link": {"kind": "tcp", "host": "192.168.1.22", "port": 23},
        "inputs": {},
    }
    del plain["controllers"]["portal"]
    plain |= {"home_order": [], "wiring": [plain["wiring"][0] | {"to": ["stage.start"]}]}

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job("[{do: enable, axes: [gantry, stage, apart]}, {do: home}]"))
        before = count(fleet)
        asked = job("[{do: move, to: {stage.u: 5, apart.x: 60}, start: line}]")
        step, skew_ns = judged_rightly(fleet, await outcome(fleet, asked), before)
        assert {name: member.start_class for name, member in step.members.items()} == {
            "gantry": "clock",
            "stage": "line",
            "apart": "clock",
        }
        assert skew_ns < 2 * NS_PER_MS

    run_fleet(main, Fleet.model_validate(plain))


def test_the_better_start_method_is_chosen_without_a_request() -> None:
    """A slow wire would spread the starts more than the members' own means."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        report = await outcome(fleet, job("[{do: move, to: {stage.u: 5, portal.x: 60}}]"))
        assert report.state == "done", report.reason
        assert report.steps[0].members["portal"].start_class == "clock"
        assert "gantry" not in report.steps[0].members

    run_fleet(main, wired_fleet((0, 50_000)))


def test_a_missing_wire_fails_the_step_and_a_stuck_one_refuses_it() -> None:
    async def main(clock_fleet: VirtualFleet) -> None:
        client = clock_fleet.make_client()
        await outcome(clock_fleet, PREPARE)
        stuck = clock_fleet.fleet.controllers["portal"].inputs["start"]
        clock_fleet.act_on_controller("portal", lambda unit: unit.set_input(stuck.number, level=stuck.active == "high"))
        await sleep_ns(clock_fleet.clock, 500 * NS_PER_MS)
        refused = await refusal(clock_fleet, job("[{do: move, to: {stage.u: 5, portal.x: 60}, start: line}]"))
        assert refused.code == "line-level" and refused.member == "portal" and refused.remedy
        assert all(not each.is_moving(axis) for each in clock_fleet.controllers.values() for axis in each.axis_names)
        await client.close()

    run_fleet(main, wired_fleet())

    async def cut(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = count(fleet)
        report = await outcome(fleet, job("[{do: move, to: {stage.u: 5, portal.x: 60}, start: line}]"))
        assert report.state == "failed" and "portal" in report.reason
        assert len(fleet.controllers["portal"].commanded_motions) == before["portal"]
        states = await fleet.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))
        assert states["stage"].mode == "idle"

    run_fleet(cut, wired_fleet(), wired=wired_fleet(to=["stage.start"]))


def test_without_a_wire_a_start_by_line_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        refused = await refusal(fleet, job("[{do: move, to: {gantry.x: 5}, start: line}]"))
        assert refused.code == "start-class" and "wiring" in refused.remedy

    run_fleet(main, wired_fleet())


def test_wires_differ_in_delay_within_their_bounds() -> None:
    async def main(fleet: VirtualFleet) -> None:
        at: dict[str, int] = {}
        began_ns = fleet.clock.now_ns()
        for name in ("stage", "portal"):
            unit, number = fleet.controllers[name], 2
            plain = unit.set_input

            def seen(point: int, *, level: bool, name: str = name, plain: Any = plain, number: int = number) -> None:
                if point == number:
                    at[name] = fleet.clock.now_ns() - began_ns
                plain(point, level=level)

            unit.set_input = seen  # type: ignore[method-assign]
        client = fleet.make_client()
        began_ns = fleet.clock.now_ns()
        await client.send_raw("gantry", "SB 2", i_know=True)
        await sleep_ns(fleet.clock, 10 * NS_PER_MS)
        assert set(at) == {"stage", "portal"}
        assert 0 < abs(at["stage"] - at["portal"]) <= 35 * NS_PER_US

    run_fleet(main, wired_fleet())


@pytest.mark.parametrize(
    ("really", "said"),
    [
        ({}, {"stage.start": "follows", "portal.start": "follows"}),
        ({"to": ["portal.start"]}, {"stage.start": "does not follow", "portal.start": "follows"}),
        ({"from": "gantry.lamp"}, {"stage.start": "does not follow", "portal.start": "does not follow"}),
    ],
)
def test_the_wiring_check_finds_what_is_wrong_without_motion(really: dict[str, Any], said: dict[str, str]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        found = await fleet.make_client().check_wiring()
        assert {each.input for each in found} == set(said)
        for each in found:
            assert each.text.startswith(said[each.input])
            assert each.ok == (each.text == "follows") == (not each.remedy)
        assert not any(each.commanded_motions for each in fleet.controllers.values())
        assert not any(fleet.controllers["gantry"].output_level(number) for number in (1, 2))
        # Everything is free again.
        prepared = await outcome(fleet, PREPARE)
        assert prepared.state == "done", prepared.reason

    run_fleet(main, wired_fleet(), wired=wired_fleet(**really))


def test_the_wiring_check_finds_wrong_levels_and_undeclared_wires() -> None:
    inverted = wired_fleet().to_plain()
    inverted["controllers"]["stage"]["inputs"]["start"]["active"] = "low"

    async def main(fleet: VirtualFleet) -> None:
        found = {each.input: each for each in await fleet.make_client().check_wiring()}
        assert found["portal.start"].ok
        assert "inverted" in found["stage.start"].text and "active" in found["stage.start"].remedy

    run_fleet(main, wired_fleet(), wired=Fleet.model_validate(inverted))

    async def crossed(fleet: VirtualFleet) -> None:
        found = {each.input: each for each in await fleet.make_client().check_wiring()}
        assert found["stage.start"].ok
        assert not found["portal.start"].ok and "has no such wire" in found["portal.start"].text

    run_fleet(crossed, wired_fleet(to=["stage.start"]), wired=wired_fleet())

    async def stuck(fleet: VirtualFleet) -> None:
        fleet.act_on_controller("portal", lambda unit: unit.set_input(2, level=False))
        await sleep_ns(fleet.clock, 500 * NS_PER_MS)
        found = {each.input: each for each in await fleet.make_client().check_wiring()}
        assert found["stage.start"].ok
        assert "stuck" in found["portal.start"].text

    run_fleet(stuck, wired_fleet(), wired=wired_fleet(to=["stage.start"]))


def test_the_wiring_check_waits_for_seldom_polled_controllers() -> None:
    seldom = wired_fleet().to_plain()
    for controller in seldom["controllers"].values():
        controller["state"] = {"idle_hz": 0.3}

    async def main(fleet: VirtualFleet) -> None:
        found = {each.input: each for each in await fleet.make_client().check_wiring()}
        assert found["stage.start"].ok
        assert not found["portal.start"].ok and "has no such wire" in found["portal.start"].text

    seldom["wiring"][0]["to"] = ["stage.start"]
    run_fleet(main, Fleet.model_validate(seldom), wired=wired_fleet())


def test_the_wiring_is_not_checked_while_wired_axes_are_in_use_or_without_wires() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        async with client.manual_control(["portal.x"]):
            with pytest.raises(Refusal, match="in use"):
                await client.check_wiring()

    run_fleet(main, wired_fleet())

    async def bare(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal, match="wiring"):
            await fleet.make_client().check_wiring()

    run_fleet(bare)


@pytest.mark.parametrize("after_ms", [0, 10, 40, 80, 160, 300])
def test_a_job_that_is_cancelled_before_its_start_leaves_no_driver_of_a_line_armed(after_ms: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        before = count(fleet)
        cancelled = await client.submit(WAITERS)
        await asyncio.sleep(0.01 + after_ms / 1000)
        await client.cancel_job(cancelled)
        assert (await client.wait_for_job(cancelled)).state == "cancelled"
        # The next job does not have to wait for the T0 of the one before.
        assert (await client.status())["gantry"].mode in ("idle", "stopping")
        assert (await outcome(fleet, job("[{do: move, by: {gantry.x: 1}}]"))).state == "done"
        assert count(fleet)["portal"] == before["portal"]

    run_fleet(main, wired_fleet())
