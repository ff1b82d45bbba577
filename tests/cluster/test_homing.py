"""Axes are homed in order; a failure stops the axes that depend on it, and nothing else."""

import asyncio
import json
from collections.abc import Iterator

import pytest
from cluster.worlds import PREPARE, changed, demo_fleet, first_leases_ns, job, outcome, refusal, rested, run_fleet
from unit.random_rounds import share_with_nightly

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.steps import home
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import JobProgress
from orchestrator.plan.homing_order import HomingOrder, find_prerequisites
from orchestrator.runtime.simulated_fleets import make_smc2000
from orchestrator.runtime.virtual.fleet import VirtualFleet

ENABLE = job("[{do: enable, axes: [gantry, stage]}]")
HOME = job("[{do: home}]")
NEVER = {"X": -1_000_000_000, "Y": -1500}  # a home switch that is nowhere


def first_motion_ns(fleet: VirtualFleet, controller: str, motor: str) -> int:
    return next(motion.start_ns for motion in fleet.controllers[controller].commanded_motions if motion.axis == motor)


def last_end_ns(fleet: VirtualFleet, controller: str, motor: str) -> int:
    ends = [motion.end_ns for motion in fleet.controllers[controller].commanded_motions if motion.axis == motor]
    assert ends[-1] is not None
    return ends[-1]


def test_the_fleet_is_homed_in_its_order_and_reports_its_progress() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client, said = fleet.make_client(), list[str]()

        def receive(progress: JobProgress) -> None:
            if progress.step_name.startswith("homing") and progress.step_name not in said:
                said.append(progress.step_name)

        await outcome(fleet, ENABLE)
        report = await client.wait_for_job(await client.submit(HOME), receive)
        assert report.state == "done", report.reason
        assert said == [
            "homing stage.focus",
            "homing gantry.x, gantry.y",
            "homing stage.u",
            "homing stage.v",
        ]
        # By the simulators' ground truth: z came to rest before x and y started, and those before u.
        assert last_end_ns(fleet, "stage", "3") < first_motion_ns(fleet, "gantry", "X")
        assert last_end_ns(fleet, "gantry", "X") < first_motion_ns(fleet, "stage", "1")
        assert last_end_ns(fleet, "gantry", "Y") < first_motion_ns(fleet, "stage", "1")
        assert abs(first_motion_ns(fleet, "gantry", "X") - first_motion_ns(fleet, "gantry", "Y")) < 10_000_000

    run_fleet(main)


def test_an_axis_that_fails_stops_those_that_come_after_it() -> None:
    fleet = changed(
        demo_fleet(),
        gantry={"simulate": {"home_edge": NEVER}, "axes": {"x": {"homing": {"speed": 20, "timeout_s": 5}}}},
        stage={"axes": {"u": {"homing": {"after": ["gantry.x"]}}}},
    ).model_copy(update={"home_order": ["stage.focus", "gantry"]})

    async def main(virtual: VirtualFleet) -> None:
        refused = await refusal(virtual, ENABLE, HOME)
        assert refused.code == "homing-timeout"
        assert "axis x: no reference found within" in refused.text
        assert "not homed because they come after gantry.x" in refused.text
        assert "stage.u" in refused.text
        assert refused.remedy
        await virtual.wait_until(lambda states: not any(a.moving for s in states.values() for a in s.axes.values()))
        states = await virtual.make_client().status()
        assert states["stage"].axes["focus"].referenced
        assert not states["gantry"].axes["x"].referenced
        assert states["gantry"].axes["y"].referenced  # it was looked for side by side with x, and found
        assert [m.axis for m in virtual.controllers["stage"].commanded_motions] == ["3"] * len(
            virtual.controllers["stage"].commanded_motions
        )

    run_fleet(main, fleet)


def test_axes_without_an_order_are_homed_one_by_one_even_if_others_fail() -> None:
    fleet = changed(
        demo_fleet(),
        gantry={"simulate": {"home_edge": NEVER}, "axes": {"x": {"homing": {"speed": 20, "timeout_s": 2}}}},
    ).model_copy(update={"home_order": []})

    async def main(virtual: VirtualFleet) -> None:
        refused = await refusal(virtual, ENABLE, HOME)
        assert "axis x" in refused.text
        states = await virtual.make_client().status()
        known = {f"{c}.{a}" for c, s in states.items() for a, now in s.axes.items() if now.referenced}
        assert known == {"gantry.y", "stage.u", "stage.v", "stage.focus"}
        assert last_end_ns(virtual, "gantry", "X") < first_motion_ns(virtual, "gantry", "Y")

    run_fleet(main, fleet)


def test_an_axis_after_another_is_homed_only_when_that_one_is_referenced() -> None:
    fleet = changed(demo_fleet(), gantry={"axes": {"x": {"homing": {"after": ["stage.focus"]}}}})

    async def main(virtual: VirtualFleet) -> None:
        only_x = job("[{do: home, axes: [gantry.x]}]")
        refused = await refusal(virtual, ENABLE, only_x)
        assert refused.code == "not-referenced"
        assert "gantry.x must be homed after stage.focus" in refused.text
        assert "home stage.focus first" in refused.remedy
        assert not virtual.controllers["gantry"].commanded_motions
        assert (await outcome(virtual, job("[{do: home, axes: [stage.focus]}]"), only_x)).state == "done"
        contrary = job("[{do: home, axes: [gantry.x, stage.focus]}]")
        with pytest.raises(Refusal, match="but comes before it in the given order"):
            await virtual.make_client().submit(contrary)

    run_fleet(main, fleet)


class Backwards(set[str]):
    """A set that is iterated in the reverse order of its names, as the hash seed of a process may have it."""

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(super().__iter__(), reverse=True))


def test_of_several_missing_references_the_first_one_by_name_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = changed(demo_fleet(), gantry={"axes": {"x": {"homing": {"after": ["stage.u", "stage.focus", "gantry.y"]}}}})

    def find_backwards(fleet: Fleet, order: HomingOrder) -> dict[str, set[str]]:
        return {axis: Backwards(waits) for axis, waits in find_prerequisites(fleet, order).items()}

    monkeypatch.setattr(home, "find_prerequisites", find_backwards)

    async def main(virtual: VirtualFleet) -> None:
        refused = await refusal(virtual, ENABLE, job("[{do: home, axes: [gantry.x]}]"))
        assert "gantry.x must be homed after gantry.y" in refused.text

    run_fleet(main, fleet)


def test_a_cyclic_homing_order_is_refused_in_the_file() -> None:
    with pytest.raises(ValueError, match=r"axis gantry\.x waits for itself"):
        changed(
            demo_fleet(),
            gantry={
                "axes": {
                    "x": {"homing": {"after": ["stage.u"]}},
                    "y": {"homing": {"after": ["gantry.x"]}},
                }
            },
            stage={"axes": {"u": {"homing": {"after": ["gantry.y"]}}}},
        )


def test_a_home_switch_that_is_active_at_the_start_is_left_and_found() -> None:
    # The axis stands beyond the edge at power-up: the switch is active, and the homing starts in the other direction.
    fleet = changed(demo_fleet(), gantry={"simulate": {"home_edge": {"X": 1500, "Y": 1500}}})

    async def main(virtual: VirtualFleet) -> None:
        assert (await outcome(virtual, ENABLE, HOME)).state == "done"
        states = await virtual.make_client().status()
        assert all(axis.referenced for axis in states["gantry"].axes.values())
        assert (await outcome(virtual, job("[{do: move, to: {gantry.x: 10}}]"))).state == "done"

    run_fleet(main, fleet)


def test_a_stop_while_homing_ends_it_and_leaves_the_axis_unreferenced() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE)
        client = fleet.make_client()
        homing = await client.submit(job("[{do: home, axes: [gantry.x]}]"))
        await fleet.wait_until(lambda states: states["gantry"].axes["x"].homing)
        await asyncio.sleep(0.1)
        await client.stop()
        report = await client.wait_for_job(homing)
        assert report.state == "aborted"
        await asyncio.sleep(0.5)
        state = (await client.status())["gantry"]
        assert state.mode == "idle"
        assert not state.axes["x"].referenced
        assert not fleet.controllers["gantry"].is_moving("X")
        assert (await outcome(fleet, PREPARE)).state == "done"

    run_fleet(main)


@pytest.mark.parametrize("name", ["gantry", "stage"])
def test_a_controller_that_loses_power_while_homing(name: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE)
        client = fleet.make_client()
        homing = await client.submit(job(f"[{{do: home, axes: [{name}]}}]"))
        await fleet.wait_until(lambda states: any(axis.homing for axis in states[name].axes.values()))
        fleet.act_on_controller(name, lambda unit: unit.set_power(on=False))
        await asyncio.sleep(0.2)
        fleet.act_on_controller(name, lambda unit: unit.set_power(on=True))
        report = await client.wait_for_job(homing)
        assert report.state == "failed"
        states = await fleet.wait_until(lambda states: states[name].mode == "idle")
        assert not any(axis.referenced for axis in states[name].axes.values())
        assert (await outcome(fleet, PREPARE)).state == "done"

    run_fleet(main)


def searching() -> Fleet:
    """Axis x of the gantry, and of another controller, do not find their switches for a minute."""
    x = {"homing": {"speed": 20, "timeout_s": 60}}
    plain = changed(demo_fleet(), gantry={"simulate": {"home_edge": NEVER}, "axes": {"x": x}}).to_plain()
    plain["controllers"]["unit"] = make_smc2000(1)
    plain["controllers"]["unit"]["simulate"]["options"] = {"home_edge": NEVER}
    return Fleet.model_validate(plain)


def test_an_unreachable_adapter_is_not_waited_for_while_homing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE)
        client = fleet.make_client()
        homing = await client.submit(job("[{do: home, axes: [gantry.x]}]"))
        await fleet.wait_until(lambda states: states["gantry"].axes["x"].homing)
        cut_ns = fleet.clock.now_ns()
        host = fleet.find_process(f"host/{fleet.fleet.controllers['gantry'].host}")
        fleet.net.partition_net({host.name}, {fleet.find_process("coordinator/first").name})
        report = await client.wait_for_job(homing)
        assert report.state == "failed" and "gantry: its adapter is silent" in report.reason
        assert fleet.clock.now_ns() - cut_ns < 7 * NS_PER_S  # most of it for answers to stop and release
        assert fleet.controllers["gantry"].at_rest()

    run_fleet(main, searching())


@pytest.mark.parametrize("lost", ["request", "answer"])
def test_a_homing_whose_request_or_answer_is_lost_is_done_once_and_soon(lost: str) -> None:
    """The bus was away for a moment, too short for anything to be missed."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE)
        client = fleet.make_client()
        host = fleet.find_process(f"host/{fleet.fleet.controllers['gantry'].host}").name
        coordinator = fleet.find_process("coordinator/first").name
        way = (coordinator, host) if lost == "request" else (host, coordinator)
        begun_ns = fleet.clock.now_ns()
        homing = await client.submit(job("[{do: home, axes: [gantry.x]}]"))
        if lost == "answer":
            await fleet.wait_until(lambda states: states["gantry"].axes["x"].homing)
            while not fleet.controllers["gantry"].at_rest():
                await asyncio.sleep(0.001)
        fleet.net.block_way(*way)
        await asyncio.sleep(0.4)
        fleet.net.open_way(*way)
        report = await client.wait_for_job(homing)
        assert report.state == "done", report.reason
        assert fleet.clock.now_ns() - begun_ns < 10 * NS_PER_S
        homed = [json.loads(line) for line in fleet.lines if '"homed"' in line]
        assert len(homed) == 1

    run_fleet(main)


@pytest.mark.parametrize("after_ms", [5, 30, 90, 180])
@pytest.mark.parametrize("name", ["gantry", "unit"])
def test_a_homing_that_is_stopped_while_it_is_prepared_does_not_start(name: str, after_ms: int) -> None:
    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, job(f"[{{do: enable, axes: [{name}.x]}}]"))
        client = virtual.make_client()
        homing = await client.submit(job(f"[{{do: home, axes: [{name}.x]}}]"))
        await asyncio.sleep(after_ms / 1000)
        stopped_ns = virtual.clock.now_ns()
        await client.stop()
        report = await client.wait_for_job(homing)
        assert report.state == "aborted"
        await asyncio.sleep(2.0)
        assert all(
            motion.start_ns < stopped_ns + 50 * NS_PER_MS for motion in virtual.controllers[name].commanded_motions
        )
        assert virtual.controllers[name].at_rest()

    run_fleet(main, searching())


@pytest.mark.parametrize("after_ms", share_with_nightly([*range(4, 60, 8), *range(8, 60, 8)], 7))
def test_an_axis_is_not_passed_on_before_its_homing_has_come_to_rest(after_ms: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job("[{do: enable, axes: [gantry]}]"))
        client = fleet.make_client()
        leased_ns, before = (
            await first_leases_ns(fleet, client, "gantry"),
            len(fleet.controllers["gantry"].commanded_motions),
        )
        first = await client.submit(job("[{do: home, axes: [gantry.x]}]"))
        second = await client.submit(job("[{do: enable, axes: [gantry.x]}]"))
        await asyncio.sleep(after_ms / 1000)
        await client.cancel_job(first)
        assert (await client.wait_for_job(second)).state == "done"
        assert rested(fleet, "gantry", leased_ns[second])
        # Nor did it start afterwards.
        searched = fleet.controllers["gantry"].commanded_motions[before:]
        assert all(motion.start_ns < leased_ns[second] for motion in searched)

    run_fleet(main, searching())


@pytest.mark.parametrize("name", ["gantry", "unit"])
def test_a_homing_whose_link_is_closed_is_stopped(name: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, job(f"[{{do: enable, axes: [{name}]}}]"))
        client = virtual.make_client()
        homing = await client.submit(job(f"[{{do: home, axes: [{name}.x]}}]"))
        await virtual.wait_until(lambda states: virtual.controllers[name].is_moving("X"))
        closed_ns = virtual.clock.now_ns()
        for link in list(virtual.wires[name].links):
            link.hang_up()
        report = await client.wait_for_job(homing)
        # Found by the poll of the homing, or by the supervisor before it.
        assert report.state == "failed"
        assert "closed" in report.reason or "is not connected" in report.reason
        await asyncio.sleep(5.0)
        end_ns = last_end_ns(virtual, name, "X")
        assert end_ns - closed_ns < NS_PER_S

    run_fleet(main, searching())


def test_a_homing_order_that_names_an_unknown_axis() -> None:
    with pytest.raises(ValueError, match=r"the fleet has no axis, group or controller stage\.z; did you mean stage\.v"):
        Fleet.model_validate({**demo_fleet().to_plain(), "home_order": ["stage.z"]})
