"""A job in a feed hold inside a motion step: its axes brake together, stay on their path, and continue from where
they stand."""

import pytest
from cluster.test_contour import two_gantries
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.client import SubmittedJob
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.report import StepReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

FAR = "[{do: move, to: {gantry.x: 300, gantry.y: 60, stage.u: 20}, speed: 0.3}, {do: move, by: {gantry.x: 5}}]"
# Of a coordinator's request to two adapters, over a serial line of 38,400 baud and Ethernet, and of the ends of their
# ramps.
TOGETHER_NS = 60 * NS_PER_MS


async def held_inside(fleet: VirtualFleet, submitted: SubmittedJob, after_s: float = 2.0) -> None:
    """Hold a job some time after it runs; all is at rest when this returns."""
    while (await submitted.show()).transitions[-1].state != "running":
        await sleep_ns(fleet.clock, 50 * NS_PER_MS)
    await sleep_ns(fleet.clock, round(after_s * NS_PER_S))
    await submitted.pause(now=True)
    while (await submitted.show()).transitions[-1].state != "paused":
        await sleep_ns(fleet.clock, 50 * NS_PER_MS)


def rests_ns(fleet: VirtualFleet, before: dict[str, int]) -> list[int]:
    """When the first motion of every axis, since `before`, came to rest."""
    rests: dict[str, int] = {}
    for name, each in fleet.controllers.items():
        for motion in each.commanded_motions[before[name] :]:
            assert motion.end_ns is not None
            rests.setdefault(f"{name}.{motion.axis}", motion.end_ns)
    return list(rests.values())


@pytest.mark.parametrize("after_s", [0.5, 2.0, 4.2])
def test_axes_of_two_makes_brake_together_and_continue_to_the_same_targets(after_s: float) -> None:
    async def main(fleet: VirtualFleet) -> StepReport:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        before = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
        submitted = await client.submit(job(FAR))
        await held_inside(fleet, submitted, after_s)
        rests = rests_ns(fleet, before)
        assert len(rests) == 3
        assert max(rests) - min(rests) <= TOGETHER_NS
        where = {name: fleet.controllers["gantry"].position(name) for name in "XY"}
        # All on the straight path from 0 to the targets, as far as they are braked at one instant.
        part = where["X"] / 300_000
        assert where["Y"] / 60_000 == pytest.approx(part, abs=0.002)
        assert fleet.controllers["stage"].position("1") / 200_000 == pytest.approx(part, abs=0.01)
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        assert fleet.controllers["gantry"].position("X") == where["X"]
        await submitted.resume()
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert fleet.controllers["gantry"].position("X") == 305_000
        assert fleet.controllers["gantry"].position("Y") == 60_000
        assert fleet.controllers["stage"].position("1") == 200_000
        return report.steps[0]

    step = run_fleet(main)
    (held,) = step.feed_holds
    assert held.by == "client" and held.rest_skew is not None
    assert held.rest_skew.at_least_ns <= TOGETHER_NS


def test_a_relative_move_that_is_paused_twice_covers_its_distance_once() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await fleet.make_client().submit(job("[{do: move, by: {gantry.x: 200, stage.u: 15}, speed: 0.2}]"))
        fractions: list[float] = []
        for _ in range(2):
            await held_inside(fleet, submitted, 1.5)
            (entry,) = (await fleet.make_client().list_jobs(1)).jobs
            assert entry.state == "paused" and "in step 1" in entry.reason
            fractions.append(fleet.controllers["gantry"].position("X") / 200_000)
            await submitted.resume()
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert fleet.controllers["gantry"].position("X") == 200_000
        assert fleet.controllers["stage"].position("1") == 150_000
        assert len(report.steps[0].feed_holds) == 2 and 0 < fractions[0] < fractions[1] < 1

    run_fleet(main)


def test_contours_of_two_controllers_brake_within_50_ms() -> None:
    async def main(fleet: VirtualFleet) -> None:
        names = list(fleet.fleet.controllers)
        await outcome(fleet, job(f"[{{do: enable, axes: [{', '.join(names)}]}}, {{do: home}}]"))
        before = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
        axes = list(fleet.fleet.axis_names)
        # Ways of very different lengths: each axis alone would brake in another time.
        to = ", ".join(f"{axis}: {300 / (k + 1) ** 2:g}" for k, axis in enumerate(axes))
        submitted = await fleet.make_client().submit(job(f"[{{do: move, to: {{{to}}}, speed: 0.4}}]"))
        await held_inside(fleet, submitted)
        rests = rests_ns(fleet, before)
        assert len(rests) == len(axes)
        assert max(rests) - min(rests) <= 50 * NS_PER_MS
        parts = [
            fleet.controllers[axis.partition(".")[0]].position(fleet.fleet.axis(axis).motors[0])
            / (300_000 / (k + 1) ** 2)
            for k, axis in enumerate(axes)
        ]
        assert max(parts) - min(parts) < 0.01
        await submitted.resume()
        assert (await submitted.result()).state == "done"

    run_fleet(main, two_gantries(jerk=20_000.0))


@pytest.mark.parametrize("state", ["planning", "arming", "armed", "committed"])
def test_a_feed_hold_before_the_motion_starts_lets_nothing_move(state: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        before = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
        submitted = await client.submit(job(FAR))
        async for event in submitted.events():
            if event.state == state:
                await submitted.pause(now=True)
            if event.state == "paused":
                break
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        if state in ("planning", "arming"):
            assert {name: len(each.commanded_motions) for name, each in fleet.controllers.items()} == before
        assert all(each.mode == "idle" for each in (await client.status()).values())
        await submitted.resume()
        assert (await submitted.result()).state == "done"

    run_fleet(main)


def test_a_step_without_motion_ends_before_the_pause_and_a_paused_job_can_be_cancelled() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        steps = "[{do: enable, axes: [gantry, stage]}, {do: home}, {do: dwell, duration: 0.1 s}]"
        homing = await client.submit(job(steps))
        await held_inside(fleet, homing, 0.5)
        report = (await homing.show()).transitions
        assert "after step" in report[-1].reason
        await homing.resume()
        assert (await homing.result()).state == "done"
        moving = await client.submit(job(FAR))
        await held_inside(fleet, moving)
        await moving.cancel()
        assert (await moving.result()).state == "cancelled"
        stopped = await client.submit(job(FAR))
        await held_inside(fleet, stopped)
        await client.stop()
        assert (await stopped.result()).state == "aborted"

    run_fleet(main)


def test_a_resume_while_the_axes_still_brake_continues_the_motion() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await fleet.make_client().submit(job(FAR))
        while (await submitted.show()).transitions[-1].state != "running":
            await sleep_ns(fleet.clock, 50 * NS_PER_MS)
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        await submitted.pause(now=True)
        await submitted.resume()
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert [each.by for each in report.steps[0].feed_holds] == ["client"]
        assert fleet.controllers["gantry"].position("X") == 305_000

    run_fleet(main)


def test_a_fault_while_it_brakes_is_no_hold() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        submitted = await client.submit(job(FAR))
        while (await submitted.show()).transitions[-1].state != "running":
            await sleep_ns(fleet.clock, 50 * NS_PER_MS)
        await sleep_ns(fleet.clock, NS_PER_S)
        await submitted.pause(now=True)
        fleet.act_on_controller("gantry", lambda unit: unit.set_power(on=False))
        report = await submitted.result()
        assert report.state == "failed", report.reason
        assert "gantry" in report.reason

    run_fleet(main, demo_fleet())
