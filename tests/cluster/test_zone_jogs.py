"""Jogs beside keep-out zones in virtual time: they end before the border, may leave it, and count with what stands around
them."""

import asyncio
from dataclasses import replace
from typing import Any

import pytest
from cluster.test_zones import ENABLE, zones_fleet
from cluster.worlds import job, outcome, run_fleet

from orchestrator.client.manual import ManualControl
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.coordinator.fleet.leases import LeaseHold, LeaseRegistry
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import JogRoom
from orchestrator.model.names import controller_of
from orchestrator.runtime.virtual.fleet import VirtualFleet

HOME = job("[{do: home}]")


async def hold_key(fleet: VirtualFleet, manual: ManualControl, velocities: dict[str, float], seconds: float) -> str:
    """Jog for a time, with a renewal every 60 ms, and rest for one second; the code of what ended it before."""
    try:
        await manual.jog(velocities)
        for _ in range(round(seconds / 0.06)):
            await sleep_ns(fleet.clock, 60 * NS_PER_MS)
            await manual.renew_jog()
    except Refusal as error:
        return error.code
    finally:
        await manual.stop()
        await sleep_ns(fleet.clock, 1000 * NS_PER_MS)  # a renewal of the lease finds the axes at rest
    return ""


def find_position(fleet: VirtualFleet, axis: str) -> float:
    """Where an axis truly is, in its unit."""
    config = fleet.fleet.axis(axis)
    counts = fleet.controllers[controller_of(axis)].position(config.motors[0])
    return config.to_unit(round(counts))


def test_a_jog_ends_before_the_border_and_may_leave_it() -> None:
    """The arm begins at 160 mm from the detector, 5 mm are asked for, and the position is uncertain by 0.501 mm."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE, HOME, job("[{do: move, to: {gantry.x: 130}}]"))
        async with fleet.make_client().manual_control(["gantry.x"]) as manual:
            assert await hold_key(fleet, manual, {"gantry.x": 20.0}, 3.0) == "not-jogging"
            end = find_position(fleet, "gantry.x")
            assert 153.9 < end < 154.5
            with pytest.raises(Refusal, match="by zone detector-sample") as failure:
                await manual.jog({"gantry.x": 5.0})
            assert failure.value.code == "zone"
            assert await hold_key(fleet, manual, {"gantry.x": -20.0}, 1.0) == ""
            assert find_position(fleet, "gantry.x") < end - 15

    run_fleet(main, zones_fleet())


def test_axes_of_one_lease_keep_apart_whatever_each_of_them_does_and_get_new_rooms_at_rest() -> None:
    """Raised, the detector may go over the arm; held low, it may not, and while it is over the arm it may not be lowered."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE, HOME, job("[{do: move, to: {gantry.x: 150}}]"))
        async with fleet.make_client().manual_control(["gantry.x", "gantry.z"]) as manual:
            await hold_key(fleet, manual, {"gantry.x": 20.0, "gantry.z": -1.0}, 2.0)
            assert find_position(fleet, "gantry.x") < 154.5
            assert await hold_key(fleet, manual, {"gantry.z": 12.0}, 4.0) == ""
            assert find_position(fleet, "gantry.z") > 40
            for _ in range(3):  # its room grows each time that it rests
                await hold_key(fleet, manual, {"gantry.x": 25.0}, 0.8)
            assert 190 < find_position(fleet, "gantry.x") < 230
            for _ in range(3):
                await hold_key(fleet, manual, {"gantry.z": -12.0}, 4.0)
            assert 15 < find_position(fleet, "gantry.z") < 17.5

    run_fleet(main, zones_fleet())


def test_what_another_user_may_move_counts_as_anywhere() -> None:
    async def main(fleet: VirtualFleet) -> float:
        await outcome(fleet, ENABLE, HOME, job("[{do: move, to: {gantry.x: 130}}]"))
        async with (
            fleet.make_client().manual_control(["stage.u", "stage.phi"]),
            fleet.make_client().manual_control(["gantry.x"]) as manual,
        ):
            await hold_key(fleet, manual, {"gantry.x": 20.0}, 3.0)
            return find_position(fleet, "gantry.x")

    assert run_fleet(main, zones_fleet()) < 150.5


def test_a_virtual_axis_ends_before_the_border_with_all_its_real_ones() -> None:
    plain = zones_fleet().to_plain()
    plain["virtual"] = {
        "lift": {
            "of": ["gantry.x", "gantry.z"],
            "kind": "linear",
            "matrix": {"across": [1, 0], "up": [0, 1]},
            "axes": {"across": {"unit": "mm"}, "up": {"unit": "mm"}},
        }
    }

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE, HOME, job("[{do: move, to: {gantry.x: 130}}]"))
        async with fleet.make_client().manual_control(["lift.across"]) as manual:
            assert await hold_key(fleet, manual, {"lift.across": 15.0}, 4.0) in ("", "soft-limit", "not-jogging")
            assert 140 < find_position(fleet, "gantry.x") < 154.5

    run_fleet(main, Fleet.model_validate(plain))


def test_a_room_is_what_both_rooms_have() -> None:
    wide = JogRoom(low=-5.0, high=100.0, high_by="a")
    narrow = wide.narrow(JogRoom(low=10.0, high=200.0, low_by="b", high_by="c"))
    assert narrow == JogRoom(low=10.0, high=100.0, low_by="b", high_by="a")


def test_while_an_axis_is_jogged_its_room_stays_and_its_lease_is_renewed() -> None:
    """Another room is asked for in the middle of a jog: the axis keeps the end that its controller has."""

    async def main(fleet: VirtualFleet) -> tuple[list[str], list[str]]:
        await outcome(fleet, ENABLE, HOME)
        async with fleet.make_client().manual_control(["gantry.x"]) as manual:
            leases = find_leases(fleet)
            hold = leases.find_lease(manual.holder)
            assert hold is not None
            other = replace(hold, rooms={"gantry.x": JogRoom(low=0.0, high=60.0)})
            await manual.jog({"gantry.x": 20.0})
            kept_axes = await leases.send_lease(other, 3000)
            for _ in range(70):
                await sleep_ns(fleet.clock, 60 * NS_PER_MS)
                await manual.renew_jog()
            assert find_position(fleet, "gantry.x") > 70
            await manual.stop()
            await sleep_ns(fleet.clock, 1000 * NS_PER_MS)
            return kept_axes, await leases.send_lease(other, 3000)

    assert run_fleet(main, zones_fleet()) == (["gantry.x"], [])


def find_leases(fleet: VirtualFleet) -> LeaseRegistry:
    """The leases of the coordinator."""
    ((_, coordinator),) = fleet.coordinators.values()
    return coordinator._leases  # pyright: ignore[reportPrivateUsage]


def test_a_lease_counts_for_jobs_before_its_controller_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its rooms are found while the axes of jobs stand; a job that is checked then must not count on its axes to stand."""
    send_lease = LeaseRegistry.send_lease

    async def send_late(registry: LeaseRegistry, hold: LeaseHold, *args: Any, **options: Any) -> Any:
        if "manual" in hold.what:
            await sleep_ns(registry._fleet.clock, 3000 * NS_PER_MS)
        return await send_lease(registry, hold, *args, **options)

    async def main(fleet: VirtualFleet) -> str:
        await outcome(fleet, ENABLE, HOME, job("[{do: move, to: {gantry.x: 130}}]"))
        monkeypatch.setattr(LeaseRegistry, "send_lease", send_late)
        manual = fleet.make_client().manual_control(["stage.u", "stage.phi"])
        acquiring = asyncio.ensure_future(manual.__aenter__())
        await sleep_ns(fleet.clock, 500 * NS_PER_MS)
        report = await fleet.make_client().wait_for_job(
            await fleet.make_client().submit(job("[{do: move, to: {gantry.x: 153}}]"))
        )
        acquiring.cancel()
        return f"{report.state}: {report.reason}"

    assert "zone detector-sample" in run_fleet(main, zones_fleet())
