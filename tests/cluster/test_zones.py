"""Keep-out zones of a fleet in virtual time: what a step is refused for, by the positions that the fleet has."""

import pytest
from cluster.worlds import EXAMPLES, job, outcome, run_fleet, virtual_demo_fleet

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.operation.zone_state import ZoneState
from orchestrator.model.report import JobReport
from orchestrator.model.templates.template import load_job
from orchestrator.runtime.virtual.fleet import VirtualFleet

ENABLE = job("[{do: enable, axes: [gantry, stage]}]")


def example_fleet() -> Fleet:
    return load_fleet(EXAMPLES / "zones.fleet.yaml")


def zones_fleet() -> Fleet:
    """The example, with homings that are not checked."""
    plain = example_fleet().to_plain()
    plain["zones"]["homes_away"] = ["gantry.x", "gantry.z", "stage.u", "stage.phi"]
    return Fleet.model_validate(plain)


def run_steps(steps: str, homed: str = "gantry.x, gantry.z, stage") -> JobReport:
    """The report of steps after some axes were homed."""

    async def main(fleet: VirtualFleet) -> JobReport:
        return await outcome(fleet, ENABLE, job(f"[{{do: home, axes: [{homed}]}}]"), job(steps))

    return run_fleet(main, zones_fleet())


def test_the_example_job_runs_through() -> None:
    """Its steps follow each other without a rest: each is checked from where the one before ends."""

    async def main(fleet: VirtualFleet) -> JobReport:
        return await outcome(fleet, ENABLE, load_job(EXAMPLES / "zones.job.yaml"))

    report = run_fleet(main, example_fleet())
    assert report.state == "done", report.reason


def test_a_step_that_would_bring_bodies_together_is_refused_and_nothing_moves() -> None:
    async def main(fleet: VirtualFleet) -> tuple[JobReport, float]:
        report = await outcome(fleet, ENABLE, job("[{do: home}]"), job("[{do: move, to: {gantry.x: 300}}]"))
        return report, fleet.controllers["gantry"].position("X")

    report, counts = run_fleet(main, zones_fleet())
    assert report.state == "failed" and "zone detector-sample: " in report.reason and "5 mm apart" in report.reason
    assert report.steps[0].refused is not None and report.steps[0].refused.code == "zone"
    assert abs(counts) < 5


def test_it_depends_on_where_axes_of_other_steps_were_left() -> None:
    over, low = "{do: move, to: {gantry.x: 230}}", "{do: move, to: {gantry.z: 0}}"
    up = "{do: move, to: {gantry.z: 60}}"
    assert run_steps(f"[{up}, {over}]").state == "done"
    assert [step.state for step in run_steps(f"[{up}, {over}, {low}]").steps] == ["done", "done", "failed"]


def test_an_axis_without_a_reference_counts_as_anywhere() -> None:
    """The arm begins at 190 mm with the stage at 0, and at 185 with stage.phi turned by 45 degrees."""
    near, nearer = (f"[{{do: move, to: {{gantry.x: {x}}}}}]" for x in (145, 152))
    assert run_steps(near, homed="gantry.x, gantry.z").state == "done"
    report = run_steps(nearer, homed="gantry.x, gantry.z")
    assert report.state == "failed" and "the position of stage.u, stage.phi is not known" in report.reason
    assert "home stage.u, stage.phi" in report.reason
    assert run_steps(nearer).state == "done"


def test_other_targets_on_the_way_are_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE, job("[{do: home}]"))
        client = fleet.make_client()
        submitted = await client.submit(job("[{do: move, to: {gantry.x: 100}, speed: 0.1}]"))
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        with pytest.raises(Refusal, match="other targets on the way are not checked") as failure:
            await client.retarget_job(submitted, {"gantry.x": 50})
        assert failure.value.code == "zone"

    run_fleet(main, zones_fleet())


def test_an_axis_that_another_user_holds_counts_as_anywhere() -> None:
    """It stands still, and may be moved at any time."""

    async def main(fleet: VirtualFleet) -> tuple[JobReport, JobReport]:
        await outcome(fleet, ENABLE, job("[{do: home}]"), job("[{do: move, to: {gantry.x: 20}}]"))
        async with fleet.make_client().manual_control(["stage.u", "stage.phi"]):
            held_report = await outcome(fleet, job("[{do: move, to: {gantry.x: 152}}]"))
        return held_report, await outcome(fleet, job("[{do: move, to: {gantry.x: 152}}]"))

    held_report, free_report = run_fleet(main, zones_fleet())
    assert held_report.state == "failed" and "stage.u, stage.phi is not known" in held_report.reason
    assert free_report.state == "done", free_report.reason


def test_a_dry_run_says_it_from_where_the_axes_stand_and_nothing_moves() -> None:
    async def main(fleet: VirtualFleet) -> list[tuple[object, str]]:
        await outcome(fleet, ENABLE, job("[{do: home}]"))
        steps = "[{do: move, to: {gantry.x: 100}}, {do: move, by: {gantry.x: 100}}]"
        checked = await fleet.make_client().dry_run(job(steps))
        return [(problem.place[1], problem.code) for problem in checked.problems]

    assert run_fleet(main, zones_fleet()) == [(1, "zone")]


def test_clients_see_where_bodies_are_and_what_is_not_known() -> None:
    async def main(fleet: VirtualFleet) -> tuple[ZoneState, ZoneState]:
        client = fleet.make_client()
        first_state = await client.zone_state()
        await outcome(fleet, ENABLE, job("[{do: home}]"), job("[{do: move, to: {gantry.x: 100}}]"))
        await sleep_ns(fleet.clock, NS_PER_S)
        return first_state, await client.zone_state()

    before_homing, after_move = run_fleet(main, zones_fleet())
    assert before_homing.unknown == dict.fromkeys(("gantry.x", "gantry.z", "stage.u", "stage.phi"), "not referenced")
    assert not before_homing.positions and not before_homing.bodies["detector"].certain
    assert after_move.positions["gantry.x"] == pytest.approx(100, abs=0.05) and not after_move.unknown
    assert all(rule.holds for rule in after_move.rules)
    assert run_fleet(lambda fleet: fleet.make_client().zone_state(), virtual_demo_fleet()) == ZoneState()


def test_a_path_is_checked_before_it_is_run() -> None:
    path = (
        "{{do: path, axes: [gantry.x, gantry.z], start: [0, 0], tolerance: 100 um, speed: 50 mm/s, "
        "pieces: [{{piece: line, to: [20, 60]}}, {{piece: line, to: [230, 60]}}, {{piece: line, to: [230, {}]}}]}}"
    )
    report = run_steps(
        f"[{path.format(30)}, {{do: move, to: {{gantry.z: 60}}}}, {{do: move, to: {{gantry.x: 0}}}}, "
        f"{{do: move, to: {{gantry.z: 0}}}}, {path.format(12)}]"
    )
    assert [step.state for step in report.steps] == ["done"] * 4 + ["failed"], report.reason
    assert report.steps[4].refused is not None and report.steps[4].refused.code == "zone"


def test_what_would_follow_without_a_rest_begins_from_rest_where_a_stop_before_it_would_matter() -> None:
    """z may stop as it rises, while x goes on above it."""
    up, over = "{do: move, to: {gantry.z: 60}}", "{do: move, to: {gantry.x: 230}}"
    report = run_steps(f"[{{do: move, to: {{gantry.x: 110}}}}, {up}, {over}]")
    assert report.state == "done", report.reason
    chains = [step.chain for step in report.steps]
    assert chains[1] is not None and chains[1].kept
    assert chains[2] is not None and not chains[2].kept and "zone detector-sample" in chains[2].broken


def test_a_homing_that_zones_do_not_allow_is_refused_before_anything_moves() -> None:
    async def main(fleet: VirtualFleet) -> list[JobReport]:
        steps = ("{do: home}", "{do: home, axes: [gantry]}", "{do: home, axes: [stage]}", "{do: home, axes: [stage.u]}")
        await outcome(fleet, ENABLE)
        return [await outcome(fleet, job(f"[{step}]")) for step in steps]

    whole, gantry, stage, alone = run_fleet(main, example_fleet())
    assert whole.state == "failed" and "homing of stage.phi: zone low-detector: " in whole.reason, whole.reason
    assert "no order of homing fits" in whole.reason
    assert gantry.state == "done"  # both lead away
    assert stage.state == "failed" and "until it has its reference, stage.phi counts as anywhere" in stage.reason
    assert alone.state == "done", alone.reason


def test_a_probe_is_checked_to_its_end_and_beyond() -> None:
    plain = zones_fleet().to_plain()
    plain["controllers"]["gantry"]["inputs"] = {"touch": {"number": 1}}
    fleet = Fleet.model_validate(plain)

    async def main(virtual: VirtualFleet) -> list[JobReport]:
        probe = (
            "[{{do: probe, to: {{gantry.x: {}}}, until: gantry.touch, level: passive, speed: 20 mm/s, else: continue}}]"
        )
        await outcome(virtual, ENABLE, job("[{do: home}]"))
        return [await outcome(virtual, job(probe.format(end))) for end in (154.4, 140)]

    far, near = run_fleet(main, fleet)
    assert far.state == "failed" and "zone detector-sample: somewhere on its way" in far.reason, far.reason
    assert near.state == "done", near.reason
