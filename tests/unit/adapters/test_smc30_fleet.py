"""Seven SMC30 on one bus as a fleet: coordinator, adapters and simulators together, judged by the simulators' truth."""

from typing import Any

from cluster.worlds import job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

NAMES = [f"u{address}" for address in range(1, 8)]


def fleet() -> Fleet:
    def controller(address: int) -> dict[str, Any]:
        return {
            "adapter": "smc30",
            "link": {
                "kind": "serial",
                "device": "/dev/ttyUSB0",
                "baud": 9600,
                "data_bits": 7,
                "parity": "odd",
                "address": address,
            },
            "axes": {
                "x": {
                    "motors": ["1"],
                    "unit": "mm",
                    "scale": 100,
                    "limits": {"velocity": 20, "acceleration": 100},
                    "start_rate": {"min": 1, "max": 4},
                    "homing": {"speed": 10},
                }
            },
            "simulate": {
                "options": {"checksum": True, "travel_steps": [-500, 20_000]},
                "drift_ppm": 10 * address,
                "spread_us": 200,
            },
        }

    controllers = {f"u{address}": controller(address) for address in range(1, 8)}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "bus", "controllers": controllers})


def axes(names: list[str] | None = None) -> str:
    return ", ".join(f"{name}.x" for name in names or NAMES)


PREPARE = job(f"[{{do: enable, axes: [{', '.join(NAMES)}]}}, {{do: home}}]")
MOVE = job("[{do: move, to: {" + ", ".join(f"{n}.x: {10 + i}" for i, n in enumerate(NAMES)) + "}}]")


def test_a_bus_homes_and_starts_together_with_a_verdict_that_contains_the_truth() -> None:
    async def main(virtual: VirtualFleet) -> None:
        prepared = await outcome(virtual, PREPARE)
        assert prepared.state == "done", prepared.reason
        before = {name: len(each.commanded_motions) for name, each in virtual.controllers.items()}
        report = await outcome(virtual, MOVE)
        assert report.state == "done", report.reason
        starts = [each.commanded_motions[before[name]].start_ns for name, each in virtual.controllers.items()]
        skew_ns = max(starts) - min(starts)
        assert skew_ns < 3 * NS_PER_MS
        step = report.steps[0]
        assert step.start_skew is not None
        assert step.start_skew.at_least_ns <= skew_ns <= step.start_skew.at_most_ns

    run_fleet(main, fleet())


def test_a_controller_that_is_switched_off_ends_the_step_of_all() -> None:
    async def main(virtual: VirtualFleet) -> None:
        assert (await outcome(virtual, PREPARE)).state == "done"
        virtual.clock.call_at_ns(
            virtual.clock.now_ns() + 8 * NS_PER_S, lambda: virtual.controllers["u4"].set_power(on=False)
        )
        long = job("[{do: move, to: {" + ", ".join(f"{name}.x: 190" for name in NAMES) + "}}]")
        report = await outcome(virtual, long)
        assert report.state != "done"
        await sleep_ns(virtual.clock, 5 * NS_PER_S)
        assert not any(each.is_moving("1") for each in virtual.controllers.values())

    run_fleet(main, fleet())
