"""Moves of a live job that wait armed, and moves that replace one another."""

import asyncio
import statistics
from random import Random

import pytest
from cluster.worlds import EXAMPLES

from orchestrator.clock.base import NS_PER_S
from tutti import FollowPath, JobFailed, Refusal, StepFailed, Tutti
from tutti.testing import VirtualTestbed, virtual_fleet

DEMO = EXAMPLES / "demo.fleet.yaml"
AXES = ["gantry", "stage.u"]
LEAD_S = 0.060  # one start lead of the demo fleet


def prepare(fleet: VirtualTestbed) -> None:
    """Enable and home all axes."""
    fleet.tutti.enable()
    fleet.tutti.home()


def test_go_starts_what_waits_within_a_lead_and_each_inside_its_promise() -> None:
    draws = Random("waits")

    async def main(tutti: Tutti) -> list[float]:
        leads: list[float] = []
        async with tutti.live(AXES, speed=1.0) as live:
            for number in range(24):  # the first ones teach what a release takes
                move = live.make_move({"gantry.x": 10 + number % 2 * 10, "stage.u": 1 + number % 2})
                armed = await live.arm(move)
                assert 0 < armed.lead_s <= armed.most_lead_s
                await asyncio.sleep(draws.uniform(0, 50 if number % 8 == 0 else 2))
                t0_ns = await armed.go()
                report = await armed.wait()
                assert report.t0_fleet_ns == t0_ns and report.verdict in ("green", "amber")
                assert report.waited_armed is not None and report.waited_armed.by == "request"
                leads.append(report.waited_armed.lead_ns / NS_PER_S)
        return leads

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        leads_s = fleet.run(main)
        assert statistics.median(leads_s[16:]) <= LEAD_S


@pytest.mark.parametrize("ahead_s", [1, 3, 31])
def test_an_instant_can_be_asked_for(ahead_s: int) -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live(AXES, speed=1.0) as live:
            armed = await live.arm(live.make_move({"gantry.x": 10, "stage.u": 1}))
            now_ns = armed.until_fleet_ns - 60 * NS_PER_S
            for past_ns in (now_ns - NS_PER_S, now_ns + 1000):
                with pytest.raises(Refusal) as caught:
                    await armed.go_at(past_ns)
                assert caught.value.code == "too-near" and "nearest possible" in caught.value.text
            with pytest.raises(Refusal) as caught:
                await armed.go_at(armed.until_fleet_ns + NS_PER_S)
            assert caught.value.code == "too-late"
            wanted_ns = now_ns + ahead_s * NS_PER_S
            await armed.go_at(wanted_ns)
            with pytest.raises(Refusal) as caught:
                await armed.go()
            assert caught.value.code == "begun"
            report = await armed.wait()
            assert report.t0_fleet_ns is not None and abs(report.t0_fleet_ns - wanted_ns) < 2_000_000

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)


def test_an_input_starts_it_and_a_path_waits_too() -> None:
    path = FollowPath(
        axes=["gantry.x", "gantry.y"],
        start=[0, 0],
        tolerance="0.1 mm",
        speed="20 mm/s",
        pieces=[{"piece": "line", "to": [10, 5]}],
    )

    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry") as live:
            with pytest.raises(Refusal) as caught:
                await live.arm(path, input="gantry.door")
            assert caught.value.code == "input-active"
            armed = await live.arm(path, input="gantry.door", level=True)
            report = await armed.wait()
            assert report.waited_armed is not None and report.waited_armed.by == "input"

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.set_input("gantry.door", on=True)
        fleet.advance("2 s")
        with pytest.raises(Refusal):
            fleet.run(main_without_level)
        fleet.run(main)


async def main_without_level(tutti: Tutti) -> None:
    async with tutti.live("gantry") as live:
        await live.arm(live.make_move({"gantry.x": 1}), input="gantry.door")


def test_the_end_of_the_wait_ends_that_alone_and_the_end_of_the_program_ends_it() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry", speed=1.0) as live:
            armed = await live.arm(live.make_move({"gantry.x": 30}), timeout_s=2)
            with pytest.raises(Refusal) as caught:
                await armed.wait()
            assert caught.value.code == "wait-timeout"
            with pytest.raises(Refusal) as caught:
                await armed.go()
            assert caught.value.code == "not-armed"
            assert (await live.move({"gantry.x": 5})).state == "done"
        with pytest.raises(JobFailed):
            async with tutti.live("gantry", speed=1.0) as live:
                armed = await live.arm(live.make_move({"gantry.x": 30}))
                await tutti.estop("test")
                await asyncio.sleep(1)
                with pytest.raises(Refusal) as caught:
                    await armed.go()
                await live.move({"gantry.x": 6})

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)
        fleet.tutti.reset()
        fleet.advance("5 s")
        assert fleet.truth("gantry.x").position_at(fleet.now_s) == pytest.approx(5, abs=0.01)


def test_a_move_replaces_the_present_one() -> None:
    async def main(tutti: Tutti) -> None:
        async with tutti.live("gantry.x", speed=0.2) as live:
            first = asyncio.create_task(live.move({"gantry.x": 200}))
            await asyncio.sleep(1.5)
            second = await live.move({"gantry.x": 20}, replace=True)
            assert second.index == (await first).index
            assert [entry.to["gantry.x"] for entry in second.retargets] == [20]
            assert second.positions["gantry.x"].position == pytest.approx(20, abs=0.01)
            third = await live.move({"gantry.x": 25}, replace=True)  # nothing moves: a move of its own
            assert third.index == second.index + 1 and not third.retargets
            task = asyncio.create_task(live.move({"gantry.x": 200}))
            await asyncio.sleep(1.0)
            with pytest.raises(Refusal) as caught:
                await live.move({"gantry.x": 5000}, replace=True)
            assert caught.value.code == "soft-limit"
            await live.stop()
            with pytest.raises(StepFailed):
                await task
        assert live.result is not None
        assert [row.target for row in live.result.points][:2] == [{"gantry.x": 20.0}, {"gantry.x": 25.0}]

    with virtual_fleet(DEMO) as fleet:
        prepare(fleet)
        fleet.run(main)
