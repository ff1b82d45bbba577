"""`live_fleet`: a fleet of processes for tests of users, which ends with its context, whatever happens in it."""

from pathlib import Path

import pytest
from children import wait_until
from fleet import EXAMPLES, list_processes

from orchestrator.model.base import UnknownName
from tutti import Job, JobFailed, Move, Tutti
from tutti.testing import BadTest, FleetViolation, LiveTestbed, live_fleet

pytestmark = pytest.mark.live


def pids_of(fleet: LiveTestbed) -> list[int]:
    assert fleet._live is not None
    return [child.pid for child in fleet._live.children.values()]


def use_fleet(fleet: LiveTestbed) -> None:
    """What a test does with it."""
    fleet.tutti.enable("gantry", "stage")
    fleet.tutti.home("gantry.x", "stage.u")
    report = fleet.tutti.move({"gantry.x": 20, "stage.u": 2})
    fleet.advance("1 s")
    truth = fleet.truth("gantry.x")
    assert truth.position_at(fleet.now_s - 0.6) == pytest.approx(20, abs=0.001)
    assert report.steps[0].t0_fleet_ns is not None
    assert truth.moves[-1].start_s == pytest.approx(report.steps[0].t0_fleet_ns / 1e9, abs=0.1)
    fleet.set_input("gantry.door", on=True, at="200 ms")
    fleet.tutti.wait_input("gantry.door")

    async def read_position(tutti: Tutti) -> float:
        return await tutti.position("gantry.x")

    assert fleet.run(read_position) == pytest.approx(20, abs=0.01)
    fault = fleet.fail("gantry", "limit", at="500 ms")
    with pytest.raises(JobFailed, match=r"(?i)limit"):
        fleet.tutti.move({"gantry.x": 300, "stage.u": 20}, speed=0.1)
    fault.repair()
    with pytest.raises(UnknownName, match="power-cycle, power-off"):
        fleet.fail("gantry", "garbage")
    assert any('"text"' in line for line in fleet.log)


def test_a_live_fleet_is_used_checked_and_ended() -> None:
    with live_fleet(EXAMPLES / "demo.fleet.yaml") as fleet:
        processes, state = pids_of(fleet), fleet.state
        use_fleet(fleet)
        fleet.check()
        fleet.schedule(lambda: 1 / 0, at="1 ms")
        fleet.tutti.reset()
        fleet.tutti.enable("gantry")
        fleet.tutti.home("gantry.x")
        fleet.tutti.submit(Job("far", [Move(to={"gantry.x": 300}, speed=0.02)]))
        fleet.tutti.start_queue()
        wait_until(lambda: fleet.tutti.axes()["gantry.x"].moving, "it moves")
        with pytest.raises(Exception, match="division by zero"):
            fleet.check_and_close()
    ended(processes, state)
    with pytest.raises(BadTest, match="does not run"):
        _ = fleet.tutti


def test_it_ends_when_the_test_fails() -> None:
    processes: list[int] = []
    state = Path()
    with pytest.raises(FleetViolation, match="on purpose"), live_fleet(EXAMPLES / "smc4000.fleet.yaml") as fleet:
        processes, state = pids_of(fleet), fleet.state
        raise FleetViolation("on purpose")
    ended(processes, state)


def ended(processes: list[int], state: Path) -> None:
    assert processes and not state.exists()
    wait_until(lambda: not set(processes) & set(list_processes()), "all processes have ended")
