"""Commands through real terminals: what they begin ends with them, and nothing begins by itself after a break."""

import os
import pty
import select
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from children import LIMIT_S, wait_until
from fleet import COMMAND, RunningFleet, margin_s

from orchestrator.clock.live import raw_ns

pytestmark = pytest.mark.live

STOPPED_WITHIN_S = 1.0 + 0.3 + 1.5  # a session's timeout, a ramp, a busy machine
SHORT = [{"do": "move", "by": {"gantry.y": 1}}]


class Terminal:
    """A command with a terminal of its own."""

    def __init__(self, *arguments: str, kind: str = "xterm") -> None:
        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            os.execvpe(COMMAND[0], [*COMMAND, *arguments], {**os.environ, "COLUMNS": "120", "TERM": kind})
        self.shown = ""

    def read_until(self, condition: Callable[[str], bool]) -> None:
        """Read what it shows until `condition` holds for all of it, or it has ended."""
        give_up_s = time.monotonic() + LIMIT_S
        while not condition(self.shown):
            assert time.monotonic() < give_up_s, self.shown
            if not select.select([self.fd], [], [], 0.1)[0]:
                continue
            try:
                data = os.read(self.fd, 4096)
            except OSError:
                return
            if not data:
                return
            self.shown += data.decode(errors="replace")

    def press_ctrl_c(self) -> None:
        os.write(self.fd, b"\x03")

    def wait(self) -> int:
        """Its exit code, or the negative number of the signal that ended it."""
        self.read_until(lambda _: False)
        _, status = os.waitpid(self.pid, 0)
        self.pid = 0
        return os.waitstatus_to_exitcode(status)

    def close(self) -> None:
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            self.pid = 0
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


@pytest.fixture
def slow_move(shared: RunningFleet) -> Iterator[Terminal]:
    """A manual move of some 40 s on a terminal, in motion."""
    shared.bring_back()
    before = shared.starts("gantry")
    terminal = Terminal("axis", "move", "gantry.x=200", "--speed", "0.05", "--connect", shared.endpoint)
    try:
        wait_until(lambda: shared.starts("gantry") > before, "the gantry moves")
        terminal.read_until(lambda shown: "running" in shown)
        yield terminal
    finally:
        terminal.close()


def test_ctrl_c_stops_the_axis_and_reports_where_it_is(shared: RunningFleet, slow_move: Terminal) -> None:
    asked_ns = raw_ns()
    slow_move.press_ctrl_c()
    assert slow_move.wait() == 130
    assert margin_s(asked_ns, shared.rest_ns("gantry")) < STOPPED_WITHIN_S
    assert "stopping" in slow_move.shown
    assert "stopped: gantry.x " in slow_move.shown


@pytest.mark.parametrize(
    "how", ["kill", pytest.param("freeze", marks=pytest.mark.nightly), pytest.param("close", marks=pytest.mark.nightly)]
)
def test_an_axis_stops_when_its_command_is_gone(shared: RunningFleet, slow_move: Terminal, how: str) -> None:
    gone_ns = raw_ns()
    if how == "close":
        os.close(slow_move.fd)  # the terminal: SIGHUP
        slow_move.fd = -1
    else:
        os.kill(slow_move.pid, signal.SIGKILL if how == "kill" else signal.SIGSTOP)
    assert margin_s(gone_ns, shared.rest_ns("gantry")) < STOPPED_WITHIN_S


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP, signal.SIGINT])
def test_a_live_job_ends_with_its_program(shared: RunningFleet, how: signal.Signals) -> None:
    shared.bring_back()
    terminal = Terminal("live", "gantry", "--connect", shared.endpoint)
    try:
        terminal.read_until(lambda shown: "live job" in shown)
        before = shared.starts("gantry")
        os.write(terminal.fd, b"move gantry.x=200 --speed 0.05\n")
        wait_until(lambda: shared.starts("gantry") > before, "the gantry moves")
        gone_ns = raw_ns()
        os.kill(terminal.pid, how)
        assert margin_s(gone_ns, shared.rest_ns("gantry")) < STOPPED_WITHIN_S
        if how == signal.SIGINT:
            assert terminal.wait() == 130 and "stopped" in terminal.shown
    finally:
        terminal.close()


@pytest.mark.nightly
def test_a_command_that_was_interrupted_while_it_waited_moves_nothing(shared: RunningFleet) -> None:
    shared.ready()
    reserve = ["axis", "acquire", "gantry", "--for", "1h", "--what", "new belt"]
    assert shared.tutti(*reserve).returncode == 0
    refused = shared.tutti("axis", "move", "gantry.x=50")
    assert refused.returncode == 1
    assert "new belt" in refused.stderr
    before = shared.starts("gantry")
    terminal = Terminal("axis", "move", "gantry.x=50", "--wait", "--connect", shared.endpoint, kind="dumb")
    try:
        terminal.read_until(lambda shown: "new belt" in shown)
        terminal.press_ctrl_c()
        assert terminal.wait() == 130
    finally:
        terminal.close()
    assert shared.tutti("axis", "release", "gantry").returncode == 0
    assert shared.tutti("axis", "move", "stage.u=2").returncode == 0
    assert shared.starts("gantry") == before


@pytest.mark.nightly
def test_submit_says_that_the_job_continues(shared: RunningFleet) -> None:
    shared.ready()
    job = shared.file([{"do": "dwell", "duration": "3 s"}], "dwell")
    terminal = Terminal("submit", str(job), "--wait", "--connect", shared.endpoint)
    try:
        terminal.read_until(lambda shown: "running" in shown)
        terminal.press_ctrl_c()
        assert terminal.wait() == 130
        job_id = shared.ask(lambda tutti: tutti.list_jobs(1)).jobs[0].id
        assert f"job {job_id} continues; cancel it with: tutti job cancel {job_id}" in terminal.shown
        assert shared.wait(job_id).state == "done"
    finally:
        terminal.close()


@pytest.mark.nightly
def test_jobs_that_wait_for_an_estop_are_not_lost(shared: RunningFleet) -> None:
    shared.ready()
    assert shared.tutti("estop", "--reason", "test").returncode == 0
    jobs = [shared.submit(SHORT) for _ in range(3)]
    assert "the queue is stopped" in shared.tutti("job", "ls").stdout
    shared.tutti("queue", "start")
    waiting = shared.ask(lambda tutti: tutti.list_jobs(state="queued"))
    assert [each.id for each in waiting.jobs] == jobs[::-1]
    assert shared.tutti("reset").returncode == 0
    shared.tutti("axis", "home")  # an e-stop may cost a stepper its position
    assert [shared.wait(each).state for each in jobs] == ["done"] * 3


@pytest.mark.nightly
def test_after_a_restart_the_queue_waits_for_an_operator(tmp_path: Path) -> None:
    fleet = RunningFleet(tmp_path)
    try:
        fleet.started().ready()
        assert fleet.tutti("axis", "acquire", "gantry", "--for", "3s").returncode == 0
        job_id = fleet.submit([{"do": "enable", "axes": ["gantry"]}, {"do": "home", "axes": ["gantry"]}])
        before = fleet.starts("gantry")
        assert fleet.end(signal.SIGKILL) == -signal.SIGKILL
        again = RunningFleet(tmp_path)
        try:
            again.started()
            told = again.tutti("queue", "status").stdout
            assert "the queue is stopped" in told
            assert "1 job waits" in told
            assert again.starts("gantry") == before
            assert "is running" in again.tutti("queue", "start").stdout
            assert again.wait(job_id).state == "done"
        finally:
            again.close()
    finally:
        fleet.close()
