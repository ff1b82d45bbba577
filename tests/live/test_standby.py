"""Two live coordinators: the standby takes over when the other is killed or stopped, and the queue continues."""

import os
import signal
from pathlib import Path

import pytest
from children import wait_until
from fleet import EXAMPLES, RunningFleet, margin_s

from orchestrator.clock.live import raw_ns

pytestmark = pytest.mark.live

TAKE_OVER_S = 2.0
BUSY_S = 4.0  # margin for a busy machine, including an interpreter's start
COORDINATOR = "orchestrator.coordinator.process"


def coordinators(fleet: RunningFleet) -> set[int]:
    return {pid for pid, command in fleet.family().items() if COORDINATOR in command}


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.nightly)])
def test_the_queue_is_kept_when_the_leader_is_lost(tmp_path: Path, number: signal.Signals) -> None:
    fleet = RunningFleet(tmp_path, EXAMPLES / "demo.fleet.yaml", "--standby")
    try:
        fleet.started().bring_back()
        both = coordinators(fleet)
        assert len(both) == 2
        first = fleet.epoch()
        (reigning,) = (pid for pid in both if "--standby" not in fleet.family()[pid])
        running = fleet.slow_move()
        queued = fleet.submit([{"do": "move", "to": {"gantry.x": 5, "stage.u": 2}}])
        lost_ns = raw_ns()
        os.kill(reigning, number)
        wait_until(lambda: fleet.epoch() > first, "the second one reigns")
        assert margin_s(lost_ns, raw_ns()) < TAKE_OVER_S + BUSY_S
        assert fleet.wait(running).state == "interrupted"
        # A step was interrupted: the queue begins when an operator starts it.
        assert "the queue is stopped" in fleet.tutti("queue", "status").stdout
        assert "the queue is running" in fleet.tutti("queue", "start").stdout
        assert fleet.wait(queued).state == "done"
        # A stopped one is ended, and started again after the other.
        wait_until(lambda: len(coordinators(fleet) - {reigning}) == 2, "the lost one stands by again")
        assert fleet.end(signal.SIGINT) == 0
    finally:
        fleet.close()
