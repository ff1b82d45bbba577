"""Four CiA 402 drives on two buses as a fleet: coordinator, adapters and simulators, judged by the simulators' truth."""

from typing import Any

from cluster.worlds import job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.cia402.unit import SimulatedDrive

NAMES = [f"d{number}" for number in range(4)]


def fleet() -> Fleet:
    def controller(number: int) -> dict[str, Any]:
        return {
            "adapter": "cia402",
            "link": {"kind": "can", "interface": "socketcan", "channel": f"can{number % 2}", "address": 10 + number},
            "options": {"cycle_us": 100, "start_us": 50, "start_spread_us": 50},
            "axes": {
                "x": {
                    "motors": ["1"],
                    "unit": "mm",
                    "scale": 1000,
                    "soft_limits": {"min": "-10 mm", "max": "200 mm"},
                    "limits": {"velocity": 50, "acceleration": 200},
                    "homing": {"method": "home_switch_negative", "speed": 10},
                }
            },
            "simulate": {"options": {"home_switch": [-3000, -2000]}, "drift_ppm": 20 * number},
        }

    controllers = {f"d{number}": controller(number) for number in range(len(NAMES))}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "buses", "controllers": controllers})


def move(to: int) -> Any:
    return job("[{do: move, to: {" + ", ".join(f"{name}.x: {to + i}" for i, name in enumerate(NAMES)) + "}}]")


PREPARE = job(f"[{{do: enable, axes: [{', '.join(NAMES)}]}}, {{do: home}}]")


def test_two_buses_home_and_start_together_with_a_verdict_that_contains_the_truth() -> None:
    async def main(virtual: VirtualFleet) -> None:
        prepared = await outcome(virtual, PREPARE)
        assert prepared.state == "done", prepared.reason
        for to in (10, 60):
            before = {name: len(each.commanded_motions) for name, each in virtual.controllers.items()}
            report = await outcome(virtual, move(to))
            assert report.state == "done", report.reason
            starts = {name: each.commanded_motions[before[name]].start_ns for name, each in virtual.controllers.items()}
            for bus in (0, 1):
                of_bus = [start_ns for name, start_ns in starts.items() if int(name[1:]) % 2 == bus]
                assert max(of_bus) - min(of_bus) <= 0.15 * NS_PER_MS
            skew_ns = max(starts.values()) - min(starts.values())
            step = report.steps[0]
            assert step.start_skew is not None
            assert step.start_skew.at_least_ns <= skew_ns <= step.start_skew.at_most_ns
        stand = {name: round(each.position("1")) for name, each in virtual.controllers.items()}
        assert stand == {name: 1000 * (60 + number) for number, name in enumerate(NAMES)}

    run_fleet(main, fleet())


def test_a_drive_that_is_switched_off_ends_the_step_of_all() -> None:
    async def main(virtual: VirtualFleet) -> None:
        assert (await outcome(virtual, PREPARE)).state == "done"
        virtual.clock.call_at_ns(
            virtual.clock.now_ns() + 3 * NS_PER_S, lambda: virtual.controllers["d2"].set_power(on=False)
        )
        report = await outcome(virtual, move(190))
        assert report.state != "done"
        await sleep_ns(virtual.clock, 3 * NS_PER_S)
        assert not any(each.is_moving("1") for each in virtual.controllers.values())
        assert all(each.position("1") < 180_000 for each in virtual.controllers.values())

    run_fleet(main, fleet())


def test_a_fleet_does_not_move_a_drive_whose_scaling_has_changed() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = virtual.make_client()
        assert (await outcome(virtual, PREPARE)).state == "done"
        unit = virtual.controllers["d3"]
        assert isinstance(unit, SimulatedDrive)
        unit.station.dictionary.put_value(0x607C, 0, 500)
        await sleep_ns(virtual.clock, 15 * NS_PER_S)
        state = (await client.status())["d3"]
        assert [fault.code for fault in state.faults] == ["setting-changed"]
        assert "607Ch" in state.faults[0].text
        assert not state.axes["x"].referenced
        assert not any((await client.reset()).values())
        await sleep_ns(virtual.clock, 2 * NS_PER_S)
        assert not (await client.status())["d3"].faults
        assert unit.station.dictionary.get_value(0x607C) == 0

    run_fleet(main, fleet())


def test_a_coordinate_that_another_master_sets_at_rest_loses_the_reference() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = virtual.make_client()
        assert (await outcome(virtual, PREPARE)).state == "done"
        await sleep_ns(virtual.clock, NS_PER_S)
        for name in NAMES:
            unit = virtual.controllers[name]
            assert isinstance(unit, SimulatedDrive)
            unit.station.drive.servo.offset += 3000
            unit.station.drive._changed()
            await sleep_ns(virtual.clock, 37 * NS_PER_MS)
        await sleep_ns(virtual.clock, NS_PER_S)
        states = await client.status()
        assert [name for name in NAMES if states[name].axes["x"].referenced] == []

    run_fleet(main, fleet())
