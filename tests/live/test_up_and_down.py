"""A fleet in the background: `tutti up --detach`, what it says, and `tutti down`; and `tutti watch` on a terminal."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from children import wait_until
from fleet import COMMAND, EXAMPLES, RunningFleet, free_port, run_tutti

from orchestrator.runtime.live.terminal_process import TerminalProcess
from orchestrator.runtime.state.folder import find_start_ticks

pytestmark = pytest.mark.live
CODE = COMMAND[-1]


def run_in(home: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    return run_tutti(*words, XDG_STATE_HOME=str(home))


def test_a_detached_fleet_is_up_when_the_command_returns_and_is_ended_by_down(tmp_path: Path) -> None:
    port = free_port()
    endpoint = ["--connect", f"tcp/127.0.0.1:{port}"]
    up = ["up", str(EXAMPLES / "demo.fleet.yaml"), "--sim", "--port", str(port), "--detach", "--no-web"]
    started = run_in(tmp_path, *up, "--wait", "--json")
    assert started.returncode == 0, started.stderr + started.stdout
    value = json.loads(started.stdout)
    try:
        assert value["not_reached"] == []
        assert Path(value["log"]).read_text().startswith("router on")
        again = run_in(tmp_path, *up)
        assert (again.returncode, again.stdout) == (1, "")
        assert "another `tutti up` uses" in again.stderr
        for words in (["enable", "gantry"], ["home", "gantry.x"]):
            assert run_in(tmp_path, "axis", *words, *endpoint).returncode == 0
        job = tmp_path / "slow.job.yaml"
        job.write_text("schema: tutti.job/1\nname: slow\nsteps: [{do: move, to: {gantry.x: 300}, speed: 0.05}]\n")
        assert run_in(tmp_path, "submit", str(job), *endpoint).returncode == 0

        def moves() -> bool:
            return json.loads(run_in(tmp_path, "axis", "ls", "--json", *endpoint).stdout)["gantry.x"]["moving"]

        wait_until(moves, "the axis moves")
    finally:
        down = run_in(tmp_path, "down")
    assert (down.returncode, down.stdout.strip()) == (0, "fleet demo is down"), down.stderr
    assert find_start_ticks(value["pid"]) is None
    assert run_in(tmp_path, "down").returncode == 3
    state = Path(value["state"])
    assert {each for each in state.rglob("*") if not each.is_symlink() and each.stat().st_mode & 0o077} == set()


@pytest.mark.nightly
def test_a_fleet_does_not_begin_anew_without_its_journal_or_over_a_link(tmp_path: Path) -> None:
    port = free_port()
    up = ["up", str(EXAMPLES / "demo.fleet.yaml"), "--sim", "--port", str(port), "--detach", "--no-web"]
    started = run_in(tmp_path, *up, "--json")
    assert started.returncode == 0, started.stderr + started.stdout
    state = Path(json.loads(started.stdout)["state"])
    assert run_in(tmp_path, "down").returncode == 0
    # Without its journal the fleet would begin anew without a word.
    (state / "journal.sqlite3").unlink()
    refused = run_in(tmp_path, *up)
    assert refused.returncode == 1 and "--new-journal" in refused.stderr
    assert run_in(tmp_path, *up, "--new-journal").returncode == 0
    assert run_in(tmp_path, "down").returncode == 0
    (state / "log").rename(state / "other")
    (state / "log").symlink_to(state / "other")
    refused = run_in(tmp_path, *up)
    assert refused.returncode == 1 and f"{state}/log: is a symbolic link, to" in refused.stderr


def test_watch_is_left_by_q_and_restores_the_terminal(shared: RunningFleet) -> None:
    watch = TerminalProcess(CODE, ["watch", "--connect", shared.endpoint], releases=False)
    try:
        wait_until(lambda: "fleet demo  connected" in watch.screen_text, "the screen is there")
        assert "stage" in watch.screen_text
        watch.type_text("/gantry.x\r")
        wait_until(lambda: "filter: gantry.x" in watch.screen_text, "the filter is shown")
        watch.type_text("q")
        assert watch.wait() == 0
        assert watch.terminal_mode() == watch.before
    finally:
        watch.close()


@pytest.mark.nightly
def test_a_controller_that_is_not_reached_is_named(tmp_path: Path) -> None:
    file = tmp_path / "lonely.fleet.yaml"
    text = (EXAMPLES / "demo.fleet.yaml").read_text().partition("  stage:")[0]
    file.write_text(text.replace("host: 192.168.1.20, port: 23", f"host: 127.0.0.1, port: {free_port()}"))
    up = ["up", str(file), "--port", str(free_port()), "--detach", "--no-web"]
    started = run_in(tmp_path, *up)
    assert started.returncode == 0, started.stderr
    assert started.stdout.startswith("fleet demo is up; gantry not reached yet; state in")
    assert run_in(tmp_path, "down").returncode == 0
    refused = run_in(tmp_path, *up, "--wait", "--limit", "1s")
    assert refused.returncode == 1
    assert "not reached within 1 s: gantry: " in refused.stderr
    assert run_in(tmp_path, "down").returncode == 3


@pytest.mark.nightly
def test_a_router_that_accepts_and_never_answers_is_restarted(tmp_path: Path) -> None:
    """It takes three failures of up to three seconds each to find out, and that at most ten seconds later."""
    fleet = RunningFleet(tmp_path)
    try:
        fleet.started()
        stopped = fleet.pid("zenoh.router")
        os.kill(stopped, signal.SIGSTOP)
        wait_until(lambda: "restarting the router" in fleet.output(), "the router is restarted")
        assert "serves no new session" in fleet.output()
        fleet.works()
        assert fleet.pid("zenoh.router") != stopped
        assert fleet.end(signal.SIGINT) == 0
    finally:
        fleet.close()
