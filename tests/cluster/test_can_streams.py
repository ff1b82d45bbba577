"""Jerk-limited jobs over CiA 402 drives on two buses, which follow positions, and an SMC-4000, which runs contours."""

from typing import Any

import pytest
from cluster.worlds import job, origin_host_ns, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.simulated_fleets import make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.cia402.unit import SimulatedDrive

LIMITS = {"velocity": 100, "acceleration": 500, "jerk": 10_000}
DRIVES = {"c0": ("can0", 1), "c1": ("can0", 2), "c2": ("can1", 1)}


def fleet() -> Fleet:
    gantry = make_smc4000(0)
    controllers: dict[str, Any] = {
        "gantry": {**gantry, "axes": {"x": {**gantry["axes"]["x"], "limits": LIMITS}}},
    }
    for number, (name, (channel, unit)) in enumerate(DRIVES.items()):
        controllers[name] = {
            "adapter": "cia402",
            "link": {"kind": "can", "interface": "socketcan", "channel": channel, "address": unit},
            "options": {"cycle_us": 100, "start_us": 50, "start_spread_us": 50},
            "axes": {"x": {"motors": ["1"], "unit": "mm", "scale": 1000, "limits": LIMITS}},
            "simulate": {"drift_ppm": 40 - 40 * number, "options": {"objects": {"6065": 500, "6066": 0}}},
        }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "streams", "controllers": controllers})


PREPARE = job("[{do: enable, axes: [gantry, c0, c1, c2]}, {do: home}]")
OUT = job("[{do: move, to: {gantry.x: 150, c0.x: 200, c1.x: 120, c2.x: -90}, speed: 0.5}]")
BACK = job("[{do: move, to: {gantry.x: 0, c0.x: 0, c1.x: 0, c2.x: 0}, speed: 0.5, max_path_skew: 20 ms}]")


def motor(name: str) -> str:
    return "X" if name == "gantry" else "1"


def test_streams_and_contours_start_and_end_together_with_evidence_that_contains_the_truth() -> None:
    async def main(virtual: VirtualFleet) -> None:
        assert (await outcome(virtual, PREPARE)).state == "done"
        await sleep_ns(virtual.clock, 8 * NS_PER_S)
        for each in (OUT, BACK):
            before = {name: len(unit.commanded_motions) for name, unit in virtual.controllers.items()}
            report = await outcome(virtual, each)
            assert report.state == "done", report.reason
            step = report.steps[0]
            assert step.start_skew is not None
            made = {name: unit.commanded_motions[before[name]] for name, unit in virtual.controllers.items()}
            origin_ns = origin_host_ns(virtual)
            starts = [motion.start_ns for motion in made.values()]
            ends = [motion.end_ns or 0 for motion in made.values()]
            assert step.start_skew.at_least_ns <= max(starts) - min(starts) <= step.start_skew.at_most_ns
            assert max(starts) - min(starts) <= 2 * NS_PER_MS
            assert max(ends) - min(ends) <= 3 * NS_PER_MS
            for name, motion in made.items():
                said = step.members[name].evidence["x"]
                assert said.start is not None and said.end is not None
                assert said.start.earliest_ns <= motion.start_ns - origin_ns <= said.start.latest_ns
                assert said.end.earliest_ns <= (motion.end_ns or 0) - origin_ns <= said.end.latest_ns
        assert all(unit.position(motor(name)) == 0 for name, unit in virtual.controllers.items())

    run_fleet(main, fleet())


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ("bus cut", "has been silent"),
        ("bus-off", "has left the bus"),
        ("power", "has been silent"),
        ("SYNC lost", "underrun"),
        ("stall", "following error"),
    ],
)
def test_a_broken_stream_ends_the_step_of_all(trouble: str, words: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        assert (await outcome(virtual, PREPARE)).state == "done"
        drive, wire = virtual.controllers["c0"], virtual.wires["c0"]
        assert isinstance(drive, SimulatedDrive)
        bus: Any = drive.segment.bus

        def break_it() -> None:
            if trouble == "bus cut":
                bus.cut = True
            elif trouble == "bus-off":
                # Only the frames of the adapter host are destroyed: the drives stay on the bus.
                bus._nodes[-1].count_errors(transmit=256)
            elif trouble == "power":
                drive.set_power(on=False)
            elif trouble == "stall":
                drive.set_stalled("1", stalled=True)
            else:
                wire.to_far = lambda data: data[16:] if data[:2] == b"\x80\0" else data

        client = virtual.make_client()
        job_id = await client.submit(OUT)
        await virtual.wait_until(lambda states: abs(states["c0"].axes["x"].position) > 40)
        virtual.act_on_controller("c0", lambda _: break_it())
        report = await client.wait_for_job(job_id)
        assert report.state == "failed"
        assert words in report.reason, report.reason
        await sleep_ns(virtual.clock, NS_PER_S)
        for name, unit in virtual.controllers.items():
            assert not unit.is_moving(motor(name))
            assert 0 < abs(unit.position(motor(name))) < 200_000

    run_fleet(main, fleet())
