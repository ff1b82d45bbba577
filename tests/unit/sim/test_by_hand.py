"""Effects of pushes on simulated axes and of stops on their motions, and the lines and the record of live
simulators."""

import io
import json
from collections.abc import Mapping

import pytest
from unit.sim.desk import Desk
from unit.sim.test_shrc203 import Rig

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.queue import EventQueue
from sim.core.controller import SimulatedController
from sim.link.truth import GroundTruthLog
from sim.link.world import EnvironmentRefused, change_environment
from sim.ppsmc import PPSMC
from sim.shrc203 import SHRC203
from sim.smc30 import SMC30
from sim.yaskawa import SMC4000


def test_a_servos_encoder_measures_a_push_and_enabling_starts_from_there() -> None:
    desk = Desk()
    desk.unit.push_axis("X", -321)
    assert "-0000000321" in desk.ask("TPX") and "0000000000" in desk.ask("RPX")
    desk.ask("SHX")
    assert "-0000000321" in desk.ask("RPX")
    assert not desk.unit.commanded_motions
    with pytest.raises(ValueError, match="keeps torque"):
        desk.unit.push_axis("X", 1)


def test_a_stepper_does_not_measure_a_push_but_its_switches_do() -> None:
    desk = Desk(travel={"X": (-1000, 1000)})
    desk.ask("MTX=2")
    desk.unit.push_axis("X", 1500)
    assert "0000000000" in desk.ask("TPX") and "0000000000" in desk.ask("RPX")
    assert desk.ask("MG _LFX{F1.0}").split()[0] == "0"


def test_an_open_loop_stage_does_not_see_a_push_and_its_origin_is_elsewhere() -> None:
    rig = Rig({"origin_pls": {"1": 500}})
    with pytest.raises(ValueError, match="keeps torque"):
        rig.unit.push_axis("1", 1)
    rig.ok("C:10")
    rig.unit.push_axis("1", 200)
    rig.ok("C:11")
    assert rig.coordinates()[0] == 0
    rig.ok("H:1")
    rig.wait(60)
    (motion,) = rig.unit.commanded_motions
    # Without the push the way would have been 500.
    assert (motion.start_counts, motion.end_counts) == (0, 300)
    assert rig.coordinates()[0] == 0


def test_a_scale_sees_a_push_and_the_loop_takes_the_stage_back() -> None:
    rig = Rig({"scales": True})
    rig.ok("F:10", "C:10")
    rig.unit.push_axis("1", 200)
    assert rig.ask("Q:SPE").split(",")[0] == "P+200" and rig.ask("Q:SPC").split(",")[0] == "P0"
    rig.ok("C:11")
    assert rig.ask("Q:SPE").split(",")[0] == "P0"


def test_pushes_of_makes_whose_motors_cannot_be_switched_off_need_rest() -> None:
    for make, axis in ((PPSMC, "1"), (SMC30, "1")):
        unit = make.build_controller(EventQueue(), {})
        name = axis if axis in unit.axis_names else unit.axis_names[0]
        before = unit.position(name)
        unit.push_axis(name, 50)
        assert unit.position(name) == before
        assert not unit.commanded_motions


@pytest.mark.parametrize("line", ["STX", "ST", "AB", "limit", "FLX=3000"])
def test_instant_at_which_a_stop_starts_to_slow_an_smc4000(line: str) -> None:
    desk = Desk()
    desk.ask("SHX", "JGX=20000", "BGX")
    desk.wait(0.2)
    told_ns = desk.clock.now_ns()
    if line == "limit":
        desk.unit.set_limit("X", "forward")
    else:
        desk.ask(line)
    desk.rest()
    (motion,) = desk.unit.commanded_motions
    assert motion.slowing_ns is not None and motion.end_ns is not None
    if line.startswith("FL"):
        assert motion.slowing_ns <= told_ns + NS_PER_MS
    else:
        assert told_ns <= motion.slowing_ns <= told_ns + NS_PER_MS
    assert (motion.end_ns == motion.slowing_ns) == (line == "AB")


def test_a_motion_without_a_stop_has_no_such_instant() -> None:
    desk = Desk()
    desk.ask("SHX", "PRX=2000", "BGX")
    desk.rest()
    assert [motion.slowing_ns for motion in desk.unit.commanded_motions] == [None]
    rig = Rig()
    rig.ok("M:1+P200", "G:1")
    rig.wait(5)
    assert [motion.slowing_ns for motion in rig.unit.commanded_motions] == [None]


@pytest.mark.parametrize(("line", "dead"), [("L:1", False), ("L:E", True), ("limit", True)])
def test_instant_at_which_a_stop_starts_to_slow_an_shrc203(line: str, dead: bool) -> None:
    rig = Rig()
    rig.ok("M:1+P100000", "G:1")
    rig.wait(2)
    told_ns = rig.clock.now_ns()
    if line == "limit":
        rig.unit.set_limit("1", "forward")
    else:
        rig.ok(line)
    rig.wait(2)
    (motion,) = rig.unit.commanded_motions
    assert motion.slowing_ns is not None and motion.end_ns is not None
    assert abs(motion.slowing_ns - told_ns) <= NS_PER_MS
    assert (motion.end_ns - motion.slowing_ns < NS_PER_MS) == dead


BUILT: Mapping[str, SimulatedController] = {
    "smc4000": SMC4000.build_controller(EventQueue(), {}),
    "shrc203": SHRC203.build_controller(EventQueue(), {}),
    "ppsmc": PPSMC.build_controller(EventQueue(), {}),
}


def test_lines_of_the_world_push_axes_and_count_inputs_from_0() -> None:
    change_environment(BUILT["smc4000"], '{"push": ["X", 500]}')
    change_environment(BUILT["ppsmc"], '{"input": [0, true]}')
    with pytest.raises(EnvironmentRefused, match="no axis 'Q'"):
        change_environment(BUILT["smc4000"], '{"push": ["Q", 500]}')
    with pytest.raises(EnvironmentRefused, match="keeps torque"):
        change_environment(BUILT["shrc203"], '{"push": ["1", 500]}')
    with pytest.raises(EnvironmentRefused, match="input or output 0"):
        change_environment(BUILT["shrc203"], '{"input": [0, true]}')


def test_the_record_lists_start_slowing_and_end_in_order() -> None:
    desk = Desk()
    file = io.StringIO()
    GroundTruthLog(desk.unit, desk.clock, file)
    desk.ask("SHX", "JGX=20000", "BGX")
    desk.wait(0.3)
    desk.ask("STX")
    desk.wait(0.3)
    desk.ask("PRX=10", "BGX")
    desk.wait(0.3)
    entries = [json.loads(line) for line in file.getvalue().splitlines()]
    assert [entry["event"] for entry in entries] == ["start", "slowing", "end", "start", "end"]
    start, slowing, end = entries[:3]
    assert start["start_ns"] < slowing["slowing_ns"] < end["end_ns"] < NS_PER_S
    assert slowing["axis"] == "X" and slowing["start_ns"] == start["start_ns"]


@pytest.mark.parametrize("command", ["HM", "FE", "FI"])
def test_a_limit_switch_of_one_axis_hides_no_simultaneous_edge_from_another(command: str) -> None:
    ends: set[float] = set()
    for sample in range(60):
        desk = Desk(home_edge={"Y": -30}, index_every={"Y": 40})
        desk.ask("SHXY", "SPY=2000", "ACY=200000", "DCY=200000", "JGY=-2000", f"{command}Y", "BGY")
        desk.wait((sample + 0.5) / 1024)
        desk.unit.set_limit("X", "both")
        desk.wait(5.0)
        assert desk.unit.at_rest(), f"pressed in sample {sample}"
        ends.add(desk.unit.commanded_motions[0].end_counts or 0.0)
    assert len(ends) == 1
