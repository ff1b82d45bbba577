"""A fleet on a computer with four, and with ten, times as many busy processes as processors: what is kept, and what may need a second
attempt, as `docs/explanation/failures.md` says."""

import os
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest
from fleet import BACK, READY, SLOW_AXES, RunningFleet, Steps, margin_s

from orchestrator.clock.live import raw_ns

pytestmark = [pytest.mark.live, pytest.mark.nightly]

PROCESSORS = os.cpu_count() or 1
LOOP = "import os, sys\nwhile os.getppid() == int(sys.argv[1]): pass"
PATIENCE_S = 120.0
STOP_S = 5.0  # from the command to the rest: with the start of an interpreter, at a share of a processor
TRIES = 5
HOST = "adapters.host.host_process"


@contextmanager
def busy_loops(count: int) -> Generator[None]:
    """Processes that use all the time that they get; they end with the context, or with this process."""
    loops = [subprocess.Popen([sys.executable, "-c", LOOP, str(os.getpid())]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def run_until_done(fleet: RunningFleet, steps: Steps) -> int:
    """Run steps until they are done; return how many attempts that took."""
    reasons: list[str] = []
    for attempt in range(1, TRIES + 1):
        fleet.works()
        fleet.ask(lambda tutti: tutti.start_queue())
        report = fleet.run(steps)
        if report.state == "done":
            return attempt
        reasons.append(f"{report.state}: {report.reason}")
    raise AssertionError(reasons)


def stop_s(fleet: RunningFleet, *command: str) -> float:
    """Send a command in a slow move; return how long the axes still moved."""
    run_until_done(fleet, [*READY[:2], BACK])
    fleet.slow_move()
    sent_ns = raw_ns()
    done = fleet.tutti(*command)
    assert done.returncode == 0, done.stderr
    return max(margin_s(sent_ns, fleet.rest_ns(name)) for name in SLOW_AXES)


@pytest.mark.parametrize("load", [4 * PROCESSORS, 10 * PROCESSORS])
def test_a_busy_computer_starts_restarts_moves_and_stops(
    load: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("children", "fleet"):
        monkeypatch.setattr(f"{module}.LIMIT_S", PATIENCE_S)
    with busy_loops(load):
        begun_ns = raw_ns()
        fleet = RunningFleet(tmp_path)
        try:
            fleet.started()
            figures = {"start_s": (raw_ns() - begun_ns) / 1e9, "attempts": run_until_done(fleet, READY)}
            killed_ns = fleet.kill(HOST)
            fleet.works()
            figures["restart_s"] = (raw_ns() - killed_ns) / 1e9
            figures["attempts_again"] = run_until_done(fleet, READY)
            figures["stop_s"] = stop_s(fleet, "stop")
            figures["estop_s"] = stop_s(fleet, "estop")
            sys.stdout.write(f"{figures}\n")
            assert figures["stop_s"] < STOP_S and figures["estop_s"] < STOP_S
            assert all(state.estop is not None for state in fleet.status().values())
            assert fleet.end() == 0
        finally:
            fleet.close()
