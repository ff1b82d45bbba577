"""A live fleet beside busy loops: every job is done, or refused or failed with a true reason; and none is refused after
the load has gone.

`SOAK_S` in the environment is the duration of the load in seconds; 600 without it.
"""

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from fleet import READY, RunningFleet, Steps

from orchestrator.client.clocks import query_clocks
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.latency import FORGET_NS
from orchestrator.model.errors import Refusal

pytestmark = [pytest.mark.live, pytest.mark.nightly, pytest.mark.timeout(3600)]

LOADS = 2
JOBS_AFTER = 10
SETTLE_S = FORGET_NS / NS_PER_S + 30

# What a busy machine may say: a job that it was refused or stopped for says which part was late, and how.
TRUE_REASONS = (
    "unusual starts of the last minutes widen it",
    "was missed: it was",
    "the instant to write the starting command",
    "has not started",
    "has not answered",
    "the coordinator has been silent",
    "the adapter host has been silent",
    "its adapter is silent",
    "its adapter has restarted",
)


@contextmanager
def busy_loops() -> Iterator[None]:
    with ExitStack() as ended:
        for _ in range(LOADS):
            loop = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            ended.callback(loop.wait)
            ended.callback(loop.kill)
        yield


def make_steps(number: int) -> Steps:
    at = 20 if number % 2 else 5
    return [{"do": "move", "to": {"gantry.x": at, "stage.u": at / 2}}]


def run_one(fleet: RunningFleet, steps: Steps) -> str:
    """Run a job; return why it was refused or failed, or nothing."""
    try:
        report = fleet.run(steps)
    except Refusal as error:
        return error.text
    return "" if report.state == "done" else report.reason or report.state


def run_under_load(fleet: RunningFleet, until_s: float) -> list[str]:
    """Run one job after the other; return the outcome of each as by `run_one`."""
    outcomes: list[str] = []
    while time.monotonic() < until_s:
        outcomes.append(run_one(fleet, make_steps(len(outcomes))))
        if outcomes[-1]:
            # A break stops the queue, and may have cost a reference.
            fleet.ask(lambda tutti: tutti.start_queue())
            outcomes.append(run_one(fleet, READY))
    return outcomes


def forgets_starts(fleet: RunningFleet) -> bool:
    """Whether no start widens a bound any more."""
    return not any(reply.widened_ns for reply in fleet.ask(query_clocks).values())


def test_jobs_beside_busy_loops_end_with_a_true_reason_and_recover(tmp_path: Path) -> None:
    duration_s = float(os.environ.get("SOAK_S", "600"))
    fleet = RunningFleet(tmp_path)
    try:
        fleet.started().ready()
        with busy_loops():
            outcomes = run_under_load(fleet, time.monotonic() + duration_s)
        counted = Counter(outcomes)
        untrue = [each for each in counted if each and not any(reason in each for reason in TRUE_REASONS)]
        assert not untrue, counted
        assert outcomes
        give_up_s = time.monotonic() + SETTLE_S
        while not forgets_starts(fleet):
            assert time.monotonic() < give_up_s, "what was learned is not forgotten"
            time.sleep(1.0)
        fleet.ready()
        after = [run_one(fleet, make_steps(number)) for number in range(JOBS_AFTER)]
        assert after == [""] * JOBS_AFTER
        sys.stdout.write(f"{len(outcomes)} jobs in {duration_s:g} s beside {LOADS} loops: {dict(counted)}\n")
    finally:
        fleet.close()
