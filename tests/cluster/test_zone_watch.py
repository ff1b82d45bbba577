"""The watch on keep-out zones: what moves by another's doing is stopped before bodies meet, and what was checked is not."""

from collections.abc import Mapping

import pytest
from cluster.test_zones import ENABLE, zones_fleet
from cluster.worlds import job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.plan.zones.clearance import PairClearance
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.runtime.virtual.fleet import VirtualFleet

ZONES = FleetZones(zones_fleet())
HOME = job("[{do: home}]")


def find_true_distance(fleet: VirtualFleet, rule: str = "detector-sample") -> float:
    """The true distance of the bodies of a rule now, mm."""
    counts = {
        "gantry.x": fleet.controllers["gantry"].position("X") / 1000,
        "gantry.z": fleet.controllers["gantry"].position("Y") / 1000,
        "stage.u": fleet.controllers["stage"].position("1") / 10000,
        "stage.phi": fleet.controllers["stage"].position("2") / 400,
    }
    constraint = next(check.constraint for check in ZONES.rules if check.name == rule)
    assert isinstance(constraint, PairClearance)
    return constraint.find_distance(counts)[0]


async def move_by_another_client(fleet: VirtualFleet, commands: str) -> None:
    link = await fleet.wires["gantry"].open_link()
    link.write(f"{commands}\r".encode())
    await sleep_ns(fleet.clock, 50 * NS_PER_MS)
    await link.close()


async def watch_until_rest(fleet: VirtualFleet, limit_s: float = 10.0) -> float:
    """The smallest true distance until all axes stand."""
    nearest, resting = find_true_distance(fleet), 0
    end_ns = fleet.clock.now_ns() + int(limit_s * NS_PER_S)
    before: Mapping[str, float] = {}
    while resting < 50:
        await sleep_ns(fleet.clock, 5 * NS_PER_MS)
        nearest = min(nearest, find_true_distance(fleet))
        positions = {motor: fleet.controllers["gantry"].position(motor) for motor in "XY"}
        resting = resting + 1 if positions == before else 0
        before = positions
        assert fleet.clock.now_ns() < end_ns, "an axis still moves"
    return nearest


@pytest.mark.parametrize("speed", [20, 100])
def test_what_another_client_moves_is_stopped_before_bodies_meet(speed: int) -> None:
    async def main(fleet: VirtualFleet) -> tuple[float, float]:
        await outcome(fleet, ENABLE, HOME)
        await move_by_another_client(fleet, f"SPX={speed * 1000};ACX=1000000;DCX=1000000;PAX=300000;BGX")
        nearest = await watch_until_rest(fleet)
        return nearest, fleet.controllers["gantry"].position("X") / 1000

    nearest, position = run_fleet(main, zones_fleet())
    assert nearest >= 5 and 60 < position < 155


def test_what_leads_nowhere_near_a_body_goes_on() -> None:
    async def main(fleet: VirtualFleet) -> float:
        await outcome(fleet, ENABLE, HOME)
        await move_by_another_client(fleet, "SPX=20000;PAX=60000;BGX")
        await watch_until_rest(fleet)
        return fleet.controllers["gantry"].position("X") / 1000

    assert run_fleet(main, zones_fleet()) == pytest.approx(60, abs=0.01)


def test_a_motion_beside_an_axis_whose_position_is_lost_is_stopped() -> None:
    """Its plan counted the stage where it stood; anywhere in its range it may be in the way."""

    async def main(fleet: VirtualFleet) -> tuple[str, float]:
        await outcome(fleet, ENABLE, HOME)
        client = fleet.make_client()
        job_id = await client.submit(job("[{do: move, to: {gantry.x: 150}, speed: 10 mm/s}]"))
        while fleet.controllers["gantry"].position("X") < 100_000:
            await sleep_ns(fleet.clock, 20 * NS_PER_MS)
        fleet.wires["stage"].cut = True
        report = await client.wait_for_job(job_id)
        return report.reason, fleet.controllers["gantry"].position("X") / 1000

    reason, position = run_fleet(main, zones_fleet())
    assert "stage.u (not read for 1." in reason and ") may be anywhere in its range" in reason
    assert 105 < position < 120


def test_bodies_that_stand_too_near_raise_an_alarm_until_a_jog_has_taken_them_apart() -> None:
    plain = zones_fleet().to_plain()
    plain["zones"]["rules"]["detector-sample"]["apart"]["distance"] = "162 mm"  # they stand 160 apart after homing

    async def main(fleet: VirtualFleet) -> tuple[list[str], list[str]]:
        client = fleet.make_client()
        await outcome(fleet, ENABLE, HOME)
        await sleep_ns(fleet.clock, NS_PER_S)
        near = [alarm.text for alarm in await client.list_alarms() if alarm.kind == "zone"]
        async with client.manual_control(["gantry.x"]) as manual:
            for _ in range(20):
                await manual.jog({"gantry.x": -3.0})
                await sleep_ns(fleet.clock, 50 * NS_PER_MS)
        await sleep_ns(fleet.clock, 10 * NS_PER_S)
        return near, [alarm.kind for alarm in await client.list_alarms() if alarm.is_active]

    near, left = run_fleet(main, Fleet.model_validate(plain))
    assert near == ["zone detector-sample: detector and sample are 160 mm apart, and must be 162 mm apart"]
    assert left == []
