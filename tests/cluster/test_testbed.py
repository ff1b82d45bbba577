"""Fleets in virtual time for tests of users: calls, time, truth, faults, and the checks at their end."""

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from orchestrator.campaign.faults import FAULTS
from orchestrator.campaign.fleets import MAKES
from orchestrator.model.base import UnknownName
from orchestrator.model.jobs.files import FileError, load_fleet
from orchestrator.testing.checks import find_controllers
from tutti import BlockingTutti, Dwell, Enable, Home, Job, JobFailed, Move, Refusal, SetOutput, Tutti
from tutti.testing import BadTest, CallbackFailed, CallTooLong, FleetViolation, VirtualTestbed, virtual_fleet

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
DEMO = EXAMPLES / "demo.fleet.yaml"
FAR = {"gantry.x": 200, "stage.u": 10}


@pytest.fixture
def fleet() -> Iterator[VirtualTestbed]:
    with virtual_fleet(DEMO) as fleet:
        fleet.tutti.enable("gantry", "stage")
        fleet.tutti.home()
        yield fleet


# Calls and time


def test_time_goes_on_in_calls_only(fleet: VirtualTestbed) -> None:
    begun_s = fleet.now_s
    fleet.advance("90 s")
    assert fleet.now_s == pytest.approx(begun_s + 90, abs=1e-9)
    fleet.advance(0.5)
    assert fleet.now_s == pytest.approx(begun_s + 90.5, abs=1e-9)
    fleet.tutti.dwell(2.0)
    assert begun_s + 92.5 <= fleet.now_s < begun_s + 93


def test_the_client_has_the_methods_and_iterators_of_the_blocking_one(fleet: VirtualTestbed) -> None:
    assert isinstance(fleet.tutti, BlockingTutti)
    seen = [now["gantry.x"] for now, _ in zip(fleet.tutti.positions(["gantry.x"], hz=10), range(3), strict=False)]
    assert seen == [0.0, 0.0, 0.0]
    job = fleet.tutti.submit(Job("there", [Move(to={"gantry.x": 5})]))
    assert [each.state for each in job.events() if hasattr(each, "state")][-1] == "done"
    with fleet.tutti.manual_control(["gantry.x"]) as hand:
        hand.jog({"gantry.x": 5.0})
    other = fleet.connect("ben")
    assert other.submit(Job("named", [Dwell(duration="1 s")])).result().actor == "ben"


def test_an_asynchronous_test_runs_in_virtual_time(fleet: VirtualTestbed) -> None:
    async def main(tutti: Tutti) -> float:
        moving = asyncio.ensure_future(tutti.move({"gantry.x": 100}, speed=0.1))
        await asyncio.sleep(2)
        between = await tutti.position("gantry.x")
        await moving
        return between

    begun_s = fleet.now_s
    assert 1 < fleet.run(main) < 99
    assert fleet.now_s > begun_s + 4

    async def fail_it(tutti: Tutti) -> None:
        fault = fleet.fail("gantry", "power-off")
        await asyncio.sleep(3)
        assert (await tutti.status())["gantry"].mode == "offline"
        fault.repair()
        await asyncio.sleep(5)
        assert (await tutti.status())["gantry"].mode == "idle"

    fleet.run(fail_it)


def test_equal_seeds_give_equal_runs_and_others_do_not() -> None:
    def run(seed: int) -> tuple[list[str], float]:
        with virtual_fleet(DEMO, seed=seed) as fleet:
            fleet.tutti.enable("gantry", "stage")
            fleet.tutti.home("gantry")
            fleet.tutti.move({"gantry.x": 7})
            return fleet.log, fleet.truth("gantry.x").moves[-1].start_s

    first, again, other = run(5), run(5), run(6)
    assert first == again
    assert first[1] != other[1]


def test_a_call_works_where_an_event_loop_runs_already(fleet: VirtualTestbed) -> None:
    async def in_a_notebook() -> float:
        fleet.tutti.move({"gantry.x": 3})
        assert asyncio.get_running_loop() is not fleet.clock.loop
        return fleet.tutti.position("gantry.x")

    assert asyncio.run(in_a_notebook()) == pytest.approx(3.0, abs=0.01)


def test_a_client_in_another_event_loop_is_refused(fleet: VirtualTestbed) -> None:
    kept: list[Tutti] = []

    async def keep(tutti: Tutti) -> None:
        kept.append(tutti)

    fleet.run(keep)
    with pytest.raises(RuntimeError, match="another event loop"):
        asyncio.run(kept[0].position("gantry.x"))


def test_a_blocking_call_inside_a_call_is_refused(fleet: VirtualTestbed) -> None:
    async def main(_: Tutti) -> None:
        fleet.tutti.home()

    with pytest.raises(BadTest, match=r"fleet\.run"):
        fleet.run(main)


def test_a_call_that_never_ends_is_ended() -> None:
    with virtual_fleet(DEMO, limit="20 s") as fleet:
        with pytest.raises(CallTooLong, match=r"20\.000 s"):
            fleet.tutti.wait_input("gantry.door", timeout_s=3600)
        fleet.tutti.enable("gantry")  # the fleet works on


def test_an_interrupt_stops_what_the_call_has_begun(
    fleet: VirtualTestbed, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    fleet.clock.loop.call_at_ns(fleet.clock.now_ns() + 1_000_000_000, interrupt)
    with pytest.raises(KeyboardInterrupt):
        fleet.tutti.move(FAR, speed=0.1)
    assert "interrupted: move is cancelled" in capsys.readouterr().err
    assert fleet.truth("gantry.x").moves[-1].end_s is not None


def test_a_fleet_that_has_ended_and_one_that_was_not_started_say_so() -> None:
    fleet = virtual_fleet(DEMO, check=False)
    with pytest.raises(BadTest, match="with virtual_fleet"):
        _ = fleet.tutti
    with fleet:
        tutti = fleet.tutti
    with pytest.raises(BadTest, match="has ended"):
        tutti.home()
    fleet.close()
    with pytest.raises(BadTest, match="make another one"), fleet:
        pass


def test_two_fleets_run_side_by_side() -> None:
    with virtual_fleet(DEMO) as one, virtual_fleet(EXAMPLES / "smc30.fleet.yaml") as other:
        one.tutti.enable("gantry")
        other.advance("30 s")
        assert one.now_s < 2 < 30 < other.now_s


# Truth


def test_truth_is_exact_at_begins_and_ends_and_close_between(fleet: VirtualTestbed) -> None:
    report = fleet.tutti.move({"gantry.x": 120, "gantry.y": 80, "stage.u": 6}, speed=0.5)
    (step,) = [each for each in report.steps if each.do == "move"]
    assert step.t0_fleet_ns is not None
    truth = fleet.truth("gantry.x")
    move = truth.moves[-1]
    assert move.end_s is not None
    assert move.start_s == pytest.approx(step.t0_fleet_ns / 1e9, abs=0.01)
    assert (move.from_position, move.to_position) == (0, pytest.approx(120, abs=0.001))
    assert truth.position_at(move.start_s) == 0
    assert truth.position_at(move.end_s) == pytest.approx(120, abs=0.001)
    assert truth.position_at(fleet.now_s) == pytest.approx(120, abs=0.001)
    # 100 mm/s at most, by 1000 mm/s² at most, as the file limits them; the plan is a trapezoid or softer.
    places = [truth.position_at(move.start_s + n * (move.end_s - move.start_s) / 400) for n in range(401)]
    assert places == sorted(places)
    middle = (move.start_s + move.end_s) / 2
    assert truth.position_at(middle) == pytest.approx(60, abs=0.1)
    with pytest.raises(BadTest, match=r"fleet\.advance"):
        truth.position_at(fleet.now_s + 1)


def test_truth_between_samples_is_what_the_controllers_command(fleet: VirtualTestbed) -> None:
    axes = {"gantry.x": "X", "stage.u": "1"}
    seen: list[tuple[str, float, float]] = []

    def look() -> None:
        for name, motor in axes.items():
            controller = fleet._virtual.controllers[name.partition(".")[0]]
            seen.append((name, fleet.now_s, fleet.fleet.axis(name).to_unit(controller.position(motor))))

    for number in range(500):
        fleet.schedule(look, at=0.1 + 0.0037 * number)
    fleet.tutti.move({"gantry.x": 60, "stage.u": 6})
    fleet.tutti.move({"gantry.x": 40, "stage.u": 5})
    fleet.advance("1 s")
    assert len({place for _, _, place in seen}) > 300
    for name, at_s, place in seen:
        # The acceleration changes by up to twice its limit of 1 m/s²; a stepper begins and ends with its start rate.
        assert fleet.truth(name).position_at(at_s) == pytest.approx(place, abs=0.0035), (name, at_s)


@pytest.mark.parametrize("name", ["gantry.q", "gantry", "nothing.x"])
def test_truth_of_an_unknown_axis_lists_the_known_ones(fleet: VirtualTestbed, name: str) -> None:
    with pytest.raises(UnknownName, match=r"gantry\.x"):
        fleet.truth(name)


# The environment


def test_inputs_and_limits_have_the_names_of_the_file(fleet: VirtualTestbed) -> None:
    fleet.set_input("gantry.door", on=True)
    fleet.tutti.wait_input("gantry.door")
    fleet.set_input("gantry.door", on=False, at="1 s")
    begun_s = fleet.now_s
    fleet.tutti.wait_input("gantry.door", on=False)
    assert fleet.now_s >= begun_s + 1
    fleet.press_limit("gantry.x", "forward", at="1 s")
    with pytest.raises(JobFailed, match="limit"):
        fleet.tutti.move(FAR, speed=0.1)
    fleet.press_limit("gantry.x", "none")


def test_what_does_not_exist_is_refused_with_what_does(fleet: VirtualTestbed) -> None:
    wrong: list[tuple[Callable[[], Any], str]] = [
        (lambda: fleet.set_input("gantry.dor", on=True), r"gantry\.door"),
        (lambda: fleet.press_limit("gantry.xx", "both"), r"gantry\.x"),
        (lambda: fleet.press_limit("gantry.x", "up"), "forward, reverse"),  # type: ignore[arg-type]
        (lambda: fleet.stall_axis("stage.w"), r"stage\.u"),
        (lambda: fleet.fail("gantry", "power-of"), "did you mean power-off"),
        (lambda: fleet.fail("gantri", "power-off"), "did you mean gantry"),
    ]
    for act, said in wrong:
        with pytest.raises(UnknownName, match=said):
            act()
    refused: list[tuple[Callable[[], Any], str]] = [
        (lambda: fleet.fail(None, "power-off"), "name its controller: one of gantry, stage"),
        (lambda: fleet.fail("stage", "cable-pulled"), "smc4000; stage is a shrc203"),
        (lambda: fleet.fail(None, "permit-lost"), "no permit"),
        (lambda: fleet.fail("stage", "stall", at="3 s", until="1 s"), "later"),
        (lambda: fleet.fail("stage", "stall", at="soon"), "at: 'soon' is not a duration"),
        (lambda: fleet.advance("-1 s"), "advance: .* is not a duration"),
        (lambda: fleet.advance(-1.0), "advance: .* is not a duration"),
    ]
    for act, said in refused:
        with pytest.raises(BadTest, match=said):
            act()
    assert not fleet._faults.faults


def test_a_fleet_file_with_mistakes_is_refused_with_all_of_them(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.fleet.yaml"
    wrong.write_text(DEMO.read_text(encoding="utf-8").replace("velocity: 200", "velocity: -200"), encoding="utf-8")
    with pytest.raises(FileError, match="velocity"):
        virtual_fleet(wrong)
    plain = load_fleet(DEMO).to_plain()
    plain["controllers"]["stage"]["options"] = {"nm_per_puls": 100}
    with pytest.raises(FileError, match="nm_per_puls"):
        virtual_fleet(type(load_fleet(DEMO)).model_validate(plain))


def test_a_callback_that_raises_is_named_with_its_cause(fleet: VirtualTestbed) -> None:
    def open_door() -> None:
        raise ValueError("no such door")

    fleet.schedule(open_door, at="1 s")
    with pytest.raises(CallbackFailed, match=r"open_door.*ValueError: no such door") as failed:
        fleet.advance("5 s")
    assert isinstance(failed.value.__cause__, ValueError)
    with pytest.raises(CallbackFailed):
        fleet.tutti.home()
    fleet.close()


# Faults


def test_a_fault_begins_at_its_time_and_ends_with_its_repair(fleet: VirtualTestbed) -> None:
    begun_s = fleet.now_s
    fault = fleet.fail("gantry", "power-off", at="2 s")
    assert "to come" in repr(fault)
    with pytest.raises(JobFailed, match="gantry"):
        fleet.tutti.move(FAR, speed=0.05)
    assert begun_s + 2 < fleet.now_s < begun_s + 5 and fault.affected == ["gantry"]
    assert fleet.tutti.status()["gantry"].mode == "offline"
    fault.repair()
    fleet.advance("5 s")
    assert fleet.tutti.status()["gantry"].mode == "idle" and "repaired" in repr(fault)
    until = fleet.fail("stage", "link-cut", until="1 s")
    fleet.advance("500 ms")
    assert "in force" in repr(until)
    fleet.advance("600 ms")
    assert "repaired" in repr(until)
    fleet.fail("stage", "power-off", at="1 s").repair()
    fleet.advance("5 s")
    assert fleet.tutti.status()["stage"].mode == "idle"


@pytest.mark.parametrize("fault", ["operator-lost", "operator-interrupts", "stop", "estop"])
def test_what_people_do_ends_the_job(fleet: VirtualTestbed, fault: str) -> None:
    begun_s = fleet.now_s
    fleet.fail(None, fault, at="1 s")
    with pytest.raises(JobFailed, match=r"aborted|cancelled"):
        fleet.tutti.move(FAR, speed=0.05)
    assert begun_s + 1 < fleet.now_s < begun_s + 4


OF_GANTRIES = [name for name, fault in FAULTS.items() if "smc4000" in (fault.makes or MAKES) and not fault.of_databases]
QUICK = ("power-cycle", "link-cut", "firmware-hung", "host-hung", "permit-lost", "fleet-restarted", "disk-bit-flip")


@pytest.mark.parametrize(
    "fault", [each if each in QUICK else pytest.param(each, marks=pytest.mark.nightly) for each in sorted(OF_GANTRIES)]
)
def test_every_fault_of_the_campaign_can_be_injected_and_the_invariants_hold(fault: str) -> None:
    plain = load_fleet(DEMO).to_plain()
    plain["permits"] = {"closed": {"input": "gantry.door", "value": False}}
    with virtual_fleet(type(load_fleet(DEMO)).model_validate(plain), seed=2) as fleet:
        fleet.tutti.enable("gantry", "stage")
        fleet.tutti.home("gantry", "stage.u")
        fleet.fail("gantry", fault, at="600 ms", until="2500 ms")
        with suppress(JobFailed, Refusal):
            fleet.tutti.move({"gantry.x": 20, "stage.u": 3}, speed=0.06)
        fleet.advance("3 s")


# Checks


def test_short_steps_back_to_back_hold_the_invariants(fleet: VirtualTestbed) -> None:
    """Each step takes 0.2 s, and the next one is armed before its T0: every motion belongs to its own step."""
    steps = [Move(by={axis: 2}) for _ in range(3) for axis in ("gantry.x", "gantry.y")]
    report = fleet.tutti.run(Job("short", steps))
    assert [each.chain is not None and each.chain.kept for each in report.steps] == [False] + [True] * 5
    fleet.check()


def test_an_axis_left_in_motion_fails_the_test_with_the_seed() -> None:
    def leave_it(fleet: VirtualTestbed) -> None:
        fleet.tutti.enable("gantry", "stage")
        fleet.tutti.home()
        fleet.tutti.submit(Job("far", [Move(to=FAR, speed=0.01)]))
        fleet.advance("1 s")

    with (
        pytest.raises(FleetViolation, match=r"seed 4.*\n.*job far is still running") as failed,
        virtual_fleet(DEMO, seed=4) as fleet,
    ):
        leave_it(fleet)
    assert isinstance(failed.value, AssertionError) and "gantry is not at rest" in str(failed.value)
    with virtual_fleet(DEMO, check=False) as fleet:
        leave_it(fleet)


def command_past_tutti(fleet: VirtualTestbed, commands: bytes, seconds: float) -> None:
    """Send commands to the gantry over a connection of their own, and let them act for a time."""

    async def command(tutti: Tutti) -> None:
        link = await fleet._virtual.wires["gantry"].open_link()
        link.write(commands)
        await asyncio.sleep(seconds)
        await link.close()

    fleet.run(command)


def test_a_motion_that_nothing_has_asked_for_is_found(fleet: VirtualTestbed) -> None:
    command_past_tutti(fleet, b"PRX=5000\rBGX\r", 1)
    with pytest.raises(FleetViolation, match=r"invariant 1/2: gantry\.x moved at"):
        fleet.check_and_close()


def test_an_axis_beyond_its_limits_is_found(fleet: VirtualTestbed) -> None:
    command_past_tutti(fleet, b"ACX=9000000\rSPX=900000\rPAX=410000\rBGX\r", 3)
    with pytest.raises(FleetViolation, match=r"(?s)counts/s; its limit.*moved to 410000; limits"):
        fleet.check_and_close()


def test_evidence_that_does_not_contain_the_truth_is_found(fleet: VirtualTestbed) -> None:
    fleet.tutti.move({"gantry.x": 20})
    move = fleet._virtual.controllers["gantry"].commanded_motions[-1]
    move.start_ns += 200_000_000
    with pytest.raises(FleetViolation, match=r"(?s)invariant 8: gantry\.x of move start.*invariant 12"):
        fleet.check_and_close()


def test_jogs_are_not_taken_for_motion_without_a_job(fleet: VirtualTestbed) -> None:
    with fleet.tutti.manual_control(["gantry.x", "stage.u"]) as hand:
        for pause in ("2 s", "100 ms", "2 s"):
            hand.jog({"gantry.x": 8.0, "stage.u": 1.0})
            fleet.advance(pause)
        hand.jog({"gantry.x": -8.0, "stage.u": 0.0})
        for _ in range(20):
            fleet.advance("60 ms")
            hand.renew_jog()
    fleet.check()


@pytest.mark.parametrize("make", ["cia402", "galil", "ppsmc", "shrc203", "smc2000", "smc30", "smc4000"])
def test_the_invariants_hold_for_the_example_of_every_make(make: str) -> None:
    """Simulated firmware takes a time that the adapter expects, also where the file states none."""
    with virtual_fleet(EXAMPLES / f"{make}.fleet.yaml") as fleet:
        fleet.tutti.enable(make)
        fleet.tutti.home()
        (axis, *_) = fleet.fleet.axis_names
        with fleet.tutti.manual_control([axis]) as hand:
            hand.jog({axis: fleet.fleet.axis(axis).limits.velocity * 0.2})
            fleet.advance("100 ms")
            hand.stop()
        fleet.tutti.move(by={axis: 2}, speed=0.3)
        fleet.tutti.move(by={axis: -1})


def test_jobs_that_wait_or_were_stopped_are_no_violation(fleet: VirtualTestbed) -> None:
    job = fleet.tutti.submit(Job("far", [Move(to=FAR, speed=0.05)]))
    fleet.tutti.submit(Job("later", [Move(to={"gantry.x": 1})])).hold()
    fleet.advance("2 s")
    job.cancel()
    fleet.advance("1 s")
    fleet.tutti.stop()
    fleet.check()
    assert [each.state for each in fleet.tutti.list_jobs()][:2] == ["queued", "cancelled"]


def test_the_controllers_of_a_job_are_those_that_it_names() -> None:
    both = ["gantry", "stage"]
    assert find_controllers(Job("a", [Move(to={"stage.u": 1})]), both) == ("stage",)
    assert find_controllers(Job("a", [SetOutput(output="gantry.lamp", value=True)]), both) == ("gantry",)
    assert set(find_controllers(Job("a", [Enable(axes=["table"])]), both)) == set(both)
    assert set(find_controllers(Job("a", [Home()]), both)) == set(both)
    assert set(find_controllers(Job("a", [Dwell(duration="1 s")]), both)) == set(both)


def test_a_fleet_leaves_no_thread_and_no_loop_behind() -> None:
    before = threading.active_count()
    with virtual_fleet(DEMO) as fleet:
        fleet.advance("1 s")
    assert threading.active_count() == before and fleet.clock.loop.is_closed()
