"""Jerk-limited jobs on a fleet of two SMC-4000: by contour on both, started together, judged by evidence and truth."""

from typing import Any

from cluster.test_chain import chain_fleet
from cluster.worlds import demo_fleet, job, origin_host_ns, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

PREPARE = job("[{do: enable, axes: [gantry, portal]}, {do: home}]")
JERK = 20_000.0  # mm/s³
MOTORS = {"x": "X", "y": "Y"}


def two_gantries(**limits: Any) -> Fleet:
    """The demo fleet's gantry twice, with crystals that run apart, and limits changed on all axes."""
    plain = demo_fleet().to_plain()
    gantry = plain["controllers"]["gantry"]
    for axis in gantry["axes"].values():
        axis["limits"] |= {"jerk": JERK} | limits
    portal = gantry | {
        "link": gantry["link"] | {"host": "192.168.1.21"},
        "inputs": {},
        "outputs": {},
        "simulate": gantry["simulate"] | {"offset_s": 17.3, "drift_ppm": -61.0},
    }
    return Fleet.model_validate(
        plain
        | {
            "controllers": {"gantry": gantry, "portal": portal},
            "groups": {},
            "home_order": ["gantry", "portal"],
        }
    )


def test_a_jerk_limited_job_on_two_controllers_is_green_and_its_evidence_contains_the_truth() -> None:
    async def main(fleet: VirtualFleet) -> None:
        steps = (
            "[{do: move, to: {gantry.x: 200, gantry.y: 100, portal.x: 300, portal.y: 20}},"
            " {do: move, by: {gantry.x: -50, portal.y: 50}, sync: phase},"
            " {do: move, to: {portal.x: 10}}]"
        )
        report = await outcome(fleet, PREPARE, job(steps))
        assert report.state == "done", report.reason
        assert [step.verdict for step in report.steps[:2]] == ["green", "green"]
        origin_ns = origin_host_ns(fleet)
        homed = 2
        for name, controller in fleet.controllers.items():
            made = iter(controller.commanded_motions[homed:])
            for step in report.steps:
                member = step.members.get(name)
                if member is None:
                    continue
                motions = {motion.axis: motion for _, motion in zip(member.axes, made, strict=False)}
                for axis, evidence in member.evidence.items():
                    motion = motions[MOTORS[axis]]
                    assert evidence.start.earliest_ns <= motion.start_ns - origin_ns <= evidence.start.latest_ns
                    assert evidence.end is not None and motion.end_ns is not None
                    assert evidence.end.earliest_ns <= motion.end_ns - origin_ns <= evidence.end.latest_ns
                    # The tick of the mapping, a sample for the last record, and the crystal's part.
                    assert abs(member.lowered_s[axis] - (motion.end_ns - motion.start_ns) * 1e-9) < 2.1e-3
        first = report.steps[0]
        assert first.start_skew is not None and first.start_skew.at_most_ns <= 10_000_000
        assert first.end_skew is not None and first.end_skew.at_most_ns <= 20_000_000
        assert [fleet.controllers["gantry"].position(motor) for motor in "XY"] == [150_000, 100_000]
        assert [fleet.controllers["portal"].position(motor) for motor in "XY"] == [10_000, 70_000]

    run_fleet(main, two_gantries())


def test_a_jerk_limited_move_that_is_too_long_for_the_arrays_is_refused_before_anything_moves() -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 390}, speed: 0.001}]"))
        assert report.state == "failed"
        refused = report.steps[-1].refused
        assert refused is not None
        assert refused.code == "contour-too-long" and "axis x" in refused.text and refused.remedy
        assert fleet.controllers["gantry"].position("X") == 0

    plain = two_gantries().to_plain()
    plain["controllers"]["gantry"]["options"] = {"array_elements": 2000}
    run_fleet(main, Fleet.model_validate(plain))


def test_a_stop_in_a_contour_stops_both_controllers_and_the_next_step_runs() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        job_id = await client.submit(job("[{do: move, to: {gantry.x: 390, portal.x: 390}, speed: 0.5}]"))
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        await sleep_ns(fleet.clock, 700 * NS_PER_MS)
        await client.stop()
        report = await client.wait_for_job(job_id)
        assert report.state != "done"
        await fleet.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))
        assert all(0 < fleet.controllers[name].position("X") < 390_000 for name in ("gantry", "portal"))
        again = await outcome(fleet, job("[{do: move, to: {gantry.x: 20, portal.x: 20}}]"))
        assert again.state == "done", again.reason
        assert all(fleet.controllers[name].position("X") == 20_000 for name in ("gantry", "portal"))

    run_fleet(main, two_gantries())


def test_a_chain_and_another_make_start_a_jerk_limited_step_together() -> None:
    """The controllers of the chain load their records for seconds, and the other's clock mapping has to hold for as
    long."""
    plain = chain_fleet().to_plain()
    for name in ("feeder", "outlet", "gantry"):
        for axis in plain["controllers"][name]["axes"].values():
            axis["limits"]["jerk"] = 5_000.0
    prepare = job("[{do: enable, axes: [line, gantry]}, {do: home, axes: [line, gantry]}]")
    move = job("[{do: move, to: {gantry.x: 60, feeder.x: 30, outlet.x: 40}}]", max_start_skew="25 ms")

    async def main(fleet: VirtualFleet) -> None:
        prepared = await outcome(fleet, prepare)
        assert prepared.state == "done", prepared.reason
        before = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
        report = await outcome(fleet, move)
        assert report.state == "done", report.reason
        step = report.steps[0]
        assert step.verdict == "green"
        moved = {
            name: fleet.controllers[name].commanded_motions[before[name]] for name in ("gantry", "feeder", "outlet")
        }
        starts = [each.start_ns for each in moved.values()]
        ends = [each.end_ns for each in moved.values() if each.end_ns is not None]
        assert step.start_skew is not None and step.end_skew is not None
        assert step.start_skew.at_least_ns <= max(starts) - min(starts) <= step.start_skew.at_most_ns
        assert len(ends) == 3
        assert step.end_skew.at_least_ns <= max(ends) - min(ends) <= step.end_skew.at_most_ns
        assert [each.end_counts for each in moved.values()] == [60_000, 30_000, 40_000]

    run_fleet(main, Fleet.model_validate(plain))


def test_a_contour_whose_axes_are_named_in_another_order_ends_at_its_stamp() -> None:
    """Its one stamp is that of the controller's first axis, whichever is named first."""
    steps = "{do: move, to: {gantry.y: 10, gantry.x: 20}}, {do: move, to: {gantry.y: 0, gantry.x: 5}}"

    async def main(fleet: VirtualFleet) -> None:
        begin = "{do: enable, axes: [gantry]}, {do: home, axes: [gantry]}"
        report = await outcome(fleet, job(f"[{begin}, {steps}]"))
        assert report.state == "done", report.reason
        assert [step.verdict for step in report.steps[2:]] == ["green", "green"]

    run_fleet(main, two_gantries())
