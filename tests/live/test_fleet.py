"""The whole fleet live, as a user runs it: completed jobs, killed processes, stops, refusals; judged by the
simulators' ground truth."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from children import wait_until
from fleet import (
    EXAMPLES,
    SLOW_AXES,
    RunningFleet,
    free_port,
    margin_s,
    run_example,
    run_tutti,
    wait_a_moment,
)

from orchestrator.clock.live import raw_ns
from orchestrator.clock.realtime import RealtimePriority
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal

pytestmark = pytest.mark.live

# The declared times of the processes, in seconds, and a margin for a busy machine.
HOST_DEAD_S = 0.3
COORDINATOR_LOST_S = 0.5
RAMPS_S = 0.3
BUSY_S = 1.5
# A simulated controller is a process: on a busy machine it acts and answers late, which no real one does. Evidence is
# compared with the truth exactly in virtual time.
LATE_NS = 10_000_000

BROKEN_OFF = ("failed", "aborted", "interrupted")

AXES = {"gantry": {"x": "X", "y": "Y"}, "stage": {"u": "1", "v": "2", "focus": "3"}}


def note(name: str, value: object) -> None:
    """Shown by `pytest -rP`."""
    sys.stdout.write(f"{name}: {value}\n")


@pytest.fixture
def own(tmp_path: Path) -> Iterator[RunningFleet]:
    """A fleet that the test may ruin; it is still starting."""
    fleet = RunningFleet(tmp_path)
    try:
        yield fleet
    finally:
        fleet.close()


def test_the_demo_job_is_done_and_its_evidence_contains_the_truth(shared: RunningFleet) -> None:
    done = shared.tutti("submit", str(EXAMPLES / "demo.job.yaml"), "--wait", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert report["state"] == "done"
    scale = SqliteJournal(shared.state / "journal.sqlite3")
    try:
        _, origin_ns = scale.fleet_time_scale(Path("/proc/sys/kernel/random/boot_id").read_text().strip(), 0, "none")
    finally:
        scale.close()
    judged = 0
    for step in report["steps"]:
        for member, part in step["members"].items():
            for axis, evidence in part["evidence"].items():
                t0_ns, start = int(step["t0_fleet_ns"]), evidence["start"]
                of_axis = [e["start_ns"] - origin_ns for e in shared.truth(member) if e["axis"] == AXES[member][axis]]
                true_ns = min(of_axis, key=lambda ns: abs(ns - t0_ns))
                earliest_ns, latest_ns = int(start["earliest_ns"]) - LATE_NS, int(start["latest_ns"]) + LATE_NS
                assert earliest_ns <= true_ns <= latest_ns, (member, axis)
                judged += 1
    assert judged == 12


@pytest.mark.nightly
def test_the_demo_prints_one_object_with_every_step() -> None:
    done = run_tutti("demo", "--headless", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert report["state"] == "done"
    moves = [step for step in report["steps"] if step["do"] == "move"]
    assert len(moves) == 3
    for step in moves:
        assert set(step["members"]) == set(AXES)
        assert 0 <= step["start_skew"]["at_least_ns"] <= step["start_skew"]["at_most_ns"]
        assert step["start_skew"]["at_most_ns"] <= step["budget"]["allowed_ns"]
        assert step["planned_s"] == pytest.approx(step["actual_s"], abs=0.02)


@pytest.mark.nightly
def test_all_makes_run_one_job_together_and_a_wire_starts_them() -> None:
    """The precision depends on this machine; that they start, and that the budget names every member, does not."""
    done = run_tutti("demo", "--fleet", "all", "--headless", "--json")
    assert done.stdout, done.stderr
    report = json.loads(done.stdout)
    assert report["state"] == "done", report["reason"]
    moves = [step for step in report["steps"] if step["do"] == "move"]
    assert [step["state"] for step in moves] == ["done"] * 3
    everybody = {"gantry", "feeder", "outlet", "stage", "table", "lift", "tilt", "arm", "hand"}
    assert set(moves[0]["members"]) == set(moves[0]["budget"]["members"]) == everybody
    assert moves[0]["budget"]["worst_member"] == "table"
    by_line = {name: member["start_class"] for name, member in moves[2]["members"].items()}
    assert by_line == {"gantry": "clock", "stage": "line", "lift": "line", "tilt": "line"}
    assert len(report["truth"]) == 3


def test_processes_that_controllers_wait_for_get_priority_or_the_user_is_warned(shared: RunningFleet) -> None:
    urgencies = {
        "orchestrator.bus.zenoh.router": RealtimePriority.BUS,
        "adapters.host.guardian": RealtimePriority.GUARDIAN,
        "adapters.host.host_process": RealtimePriority.SERVICE,
        "adapters.host.firing_process": RealtimePriority.FIRING,
        "sim.link.process --model smc4000": RealtimePriority.BUS,
        "coordinator.process": RealtimePriority.SERVICE,
    }
    found = {words: priorities(shared.pid(words)) for words in urgencies}
    if "no permission for real-time processes" in shared.output():
        assert found == {words: {0} for words in urgencies}
    else:
        wanted: dict[str, set[int]] = {words: {urgency} for words, urgency in urgencies.items()}
        wanted["adapters.host.guardian"].add(0)  # what it receives, the e-stop latch, does not keep it from watching
        assert found == wanted


def priorities(pid: int) -> set[int]:
    """Of its own thread and those by which the bus receives; 0 is that of ordinary ones."""
    tasks = {int(task.name): (task / "comm").read_text() for task in Path(f"/proc/{pid}/task").iterdir()}
    return {os.sched_getparam(task).sched_priority for task, name in tasks.items() if task == pid or "rx-" in name}


def test_clocks_are_listed_and_a_fleet_without_wires_is_reported(shared: RunningFleet) -> None:
    listed = json.loads(shared.tutti("clock", "ls", "--json").stdout)
    assert listed["gantry"]["mapping"]["samples"] > 1
    assert listed["stage"]["mapping"] is None
    shown = shared.tutti("clock", "show", "gantry")
    assert shown.returncode == 0 and "ppm" in shown.stdout and "guaranteed" in shown.stdout
    unknown = shared.tutti("clock", "show", "portal")
    assert unknown.returncode == 2 and "gantry" in unknown.stderr
    unwired = shared.tutti("wiring", "check")
    assert unwired.returncode == 1 and "wiring" in unwired.stderr


@pytest.mark.parametrize(
    ("victim", "bound_s"),
    [
        ("adapters.host.host_process", HOST_DEAD_S),
        ("orchestrator.coordinator.process", COORDINATOR_LOST_S),
    ],
)
def test_a_killed_process_stops_everything_and_work_continues(
    shared: RunningFleet, victim: str, bound_s: float
) -> None:
    shared.bring_back()
    job_id = shared.slow_move()
    killed_ns = shared.kill(victim)
    took_s = {name: margin_s(killed_ns, shared.rest_ns(name)) for name in SLOW_AXES}
    starts = {name: shared.starts(name) for name in SLOW_AXES}
    assert max(took_s.values()) < bound_s + RAMPS_S + BUSY_S, took_s
    report = shared.wait(job_id)
    assert report.state in BROKEN_OFF
    assert report.reason
    shared.works()
    assert {name: shared.starts(name) for name in SLOW_AXES} == starts
    shared.bring_back()
    note("rest_s", took_s)


def test_a_killed_router_is_back_before_the_end_or_everything_stops(shared: RunningFleet) -> None:
    shared.bring_back()
    before = {name: shared.starts(name) for name in SLOW_AXES}
    job_id = shared.slow_move([{"do": "move", "by": {"gantry.x": 40, "stage.u": 4}, "speed": 0.1}])
    killed_ns = shared.kill("orchestrator.bus.zenoh.router")
    took_s = {name: margin_s(killed_ns, shared.rest_ns(name)) for name in SLOW_AXES}
    report = shared.wait(job_id)
    if report.state != "done":
        assert report.reason
        assert max(took_s.values()) < COORDINATOR_LOST_S + RAMPS_S + BUSY_S, (took_s, report.reason)
    shared.works()
    assert all(shared.starts(name) == count + 1 for name, count in before.items())
    shared.bring_back()
    note("rest_s", took_s)
    note("job", f"{report.state} {report.reason}")


def test_a_hung_router_stops_everything_and_work_continues(shared: RunningFleet) -> None:
    shared.bring_back()
    job_id = shared.slow_move()
    router = shared.pid("orchestrator.bus.zenoh.router")
    os.kill(router, signal.SIGSTOP)
    try:
        stopped_ns = raw_ns()
        took_s = {name: margin_s(stopped_ns, shared.rest_ns(name)) for name in SLOW_AXES}
    finally:
        os.kill(router, signal.SIGCONT)
    assert max(took_s.values()) < COORDINATOR_LOST_S + RAMPS_S + BUSY_S, took_s
    starts = {name: shared.starts(name) for name in SLOW_AXES}
    report = shared.wait(job_id)
    assert report.state in BROKEN_OFF
    assert report.reason
    shared.works()
    assert {name: shared.starts(name) for name in SLOW_AXES} == starts
    shared.bring_back()
    note("rest_s", took_s)


@pytest.mark.nightly
def test_a_router_that_hangs_in_a_motion_and_stays_so_is_restarted(shared: RunningFleet) -> None:
    """The last states that arrived say that axes move, for ever; they are at rest half a second later."""
    shared.bring_back()
    job_id = shared.slow_move()
    router = shared.pid("orchestrator.bus.zenoh.router")
    os.kill(router, signal.SIGSTOP)
    stopped_ns = raw_ns()
    for name in SLOW_AXES:
        shared.rest_ns(name)
    wait_until(lambda: router not in shared.family(), "the router that hangs is ended")
    shared.works()
    took_s = (raw_ns() - stopped_ns) / 1e9
    assert shared.wait(job_id).state in BROKEN_OFF
    shared.bring_back()
    note("works_again_s", took_s)


@pytest.mark.nightly
def test_a_killed_simulator_stops_the_others_and_comes_back(shared: RunningFleet) -> None:
    shared.bring_back()
    job_id = shared.slow_move()
    killed_ns = shared.kill("--name gantry")
    took_s = margin_s(killed_ns, shared.rest_ns("stage"))
    assert took_s < HOST_DEAD_S + RAMPS_S + BUSY_S
    report = shared.wait(job_id)
    assert report.state == "failed"
    assert "gantry" in report.reason
    shared.bring_back()
    note("rest_s", took_s)


def test_stop_ends_a_move(shared: RunningFleet) -> None:
    shared.bring_back()
    job_id = shared.slow_move()
    asked_ns = raw_ns()
    done = shared.tutti("stop", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout) == {"gantry": None, "stage": None}
    took_s = {name: margin_s(asked_ns, shared.rest_ns(name)) for name in SLOW_AXES}
    assert max(took_s.values()) < RAMPS_S + 2 * BUSY_S, took_s
    report = shared.wait(job_id)
    assert report.state in BROKEN_OFF
    assert report.reason
    note("rest_s", took_s)


def test_an_estop_latches_survives_a_restart_and_is_reset(shared: RunningFleet) -> None:
    shared.bring_back()
    shared.slow_move()
    asked_ns = raw_ns()
    done = shared.tutti("estop", "--reason", "test", "--json")
    try:
        assert json.loads(done.stdout) == {"gantry": True, "stage": True}
        took_s = {name: margin_s(asked_ns, shared.rest_ns(name)) for name in SLOW_AXES}
        assert max(took_s.values()) < RAMPS_S + 2 * BUSY_S, took_s
        before = {state.instance for state in shared.status().values()}
        shared.kill("adapters.host.host_process")

        def is_back() -> bool:
            states = shared.status().values()
            return len(states) == 2 and all(
                s.instance not in before and s.mode in ("idle", "fault") and s.epoch == shared.epoch() for s in states
            )

        wait_until(is_back, "the adapter host is back")
        assert all(state.estop is not None for state in shared.status().values())
        refused = shared.tutti("axis", "enable", "gantry")
        assert refused.returncode == 1
        assert "e-stop" in refused.stderr
    finally:
        assert shared.tutti("reset").returncode == 0
    assert all(state.estop is None for state in shared.status().values())
    shared.bring_back()
    note("rest_s", took_s)


def test_a_second_fleet_is_refused_with_the_remedy(shared: RunningFleet, tmp_path: Path) -> None:
    up = ["up", str(EXAMPLES / "demo.fleet.yaml"), "--sim"]
    taken = run_tutti(*up, "--port", str(shared.port), "--state", str(tmp_path))
    assert taken.returncode == 1
    assert f"port {shared.port}" in taken.stderr
    assert "--port" in taken.stderr and "--connect" in taken.stderr
    second = run_tutti(*up, "--connect", shared.endpoint, "--state", str(tmp_path))
    assert second.returncode == 1
    assert "leads fleet demo" in second.stderr
    folder = run_tutti(*up, "--port", str(free_port()), "--state", str(shared.state))
    assert folder.returncode == 1
    assert "--state" in folder.stderr


@pytest.mark.nightly
def test_bad_jobs_and_absent_fleets_have_their_exit_codes(shared: RunningFleet, tmp_path: Path) -> None:
    bad = tmp_path / "bad.job.yaml"
    bad.write_text("schema: tutti.job/1\nname: bad\nsteps:\n  - {do: mvoe, to: {gantry.x: 1}}\n")
    malformed = shared.tutti("submit", str(bad))
    assert malformed.returncode == 2
    assert f"{bad}:4" in malformed.stderr
    unknown = shared.tutti("submit", str(shared.file([{"do": "move", "to": {"gantry.q": 1}}], "unknown")), "--wait")
    assert unknown.returncode == 2
    assert "gantry.q" in unknown.stderr
    with socket.create_server(("127.0.0.1", 0)) as silent:
        endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
    absent = run_tutti("status", "--connect", endpoint)
    assert absent.returncode == 3
    assert endpoint in absent.stderr


@pytest.mark.nightly
def test_axes_and_outputs_under_manual_control(shared: RunningFleet) -> None:
    shared.bring_back()
    moved = shared.tutti("axis", "move", "gantry.x=12", "stage.u=1500 um", "--line")
    assert (moved.returncode, moved.stdout.strip()) == (0, "gantry.x 12.000 mm, stage.u 1.500 mm"), moved.stderr
    assert shared.tutti("axis", "move", "gantry.x=-2", "--relative").returncode == 0
    axes = json.loads(shared.tutti("axis", "ls", "--json").stdout)
    assert axes["gantry.x"]["position"] == 10.0
    assert axes["stage.u"]["position"] == 1.5
    limits = json.loads(shared.tutti("axis", "limits", "gantry.x", "--json").stdout)
    assert limits["gantry.x"]["velocity"] == 200
    beyond = shared.tutti("axis", "move", "gantry.x=999")
    assert beyond.returncode == 1
    assert "beyond its soft limits -10 to 400 mm" in beyond.stderr
    assert shared.tutti("axis", "move", "gantry.x").returncode == 2
    assert shared.tutti("io", "set", "gantry.lamp", "on").returncode == 0
    assert json.loads(shared.tutti("io", "ls", "--json").stdout)["gantry"]["outputs"] == {"lamp": True}
    assert shared.tutti("io", "set", "gantry.horn", "on").returncode == 2
    assert shared.tutti("axis", "disable", "gantry.y").returncode == 0
    assert json.loads(shared.tutti("axis", "ls", "--json").stdout)["gantry.y"]["enabled"] is False


def test_a_fleet_file_is_checked_offline_and_against_the_units(shared: RunningFleet, tmp_path: Path) -> None:
    shared.works()
    running = str(shared.folder / "state" / "fleet.json")
    assert run_tutti("fleet", "check", running).returncode == 0
    assert shared.tutti("fleet", "check", running, "--live").returncode == 0
    other = tmp_path / "other.json"
    other.write_text(Path(running).read_text().replace('"velocity":200.0', '"velocity":201.0', 1))
    differs = shared.tutti("fleet", "check", str(other), "--live")
    assert differs.returncode == 1
    assert "another configuration" in differs.stdout
    other.write_text(Path(running).read_text().replace('"motors":["Y"]', '"motors":["Q"]'))
    wrong = run_tutti("fleet", "check", str(other))
    assert wrong.returncode == 2
    assert "there is no motor 'Q'" in wrong.stderr


def test_positions_can_be_watched_with_zenoh_alone(shared: RunningFleet) -> None:
    seen = run_example("watch_positions.py", shared.endpoint, "4")
    assert seen.returncode == 0, seen.stderr
    lines = seen.stdout.splitlines()
    assert len(lines) == 4
    assert all(line.split()[0] in AXES for line in lines)


def test_jobs_are_submitted_from_a_script_and_with_zenoh_alone(shared: RunningFleet) -> None:
    job = shared.file([{"do": "enable", "axes": ["gantry"]}, {"do": "dwell", "duration": "100 ms"}], "scripted")
    script = run_example("submit_job.py", str(job), shared.endpoint)
    assert script.returncode == 0, script.stderr
    states = [line.split()[1] for line in script.stdout.splitlines()]
    assert states[0] == "queued" and states[-1] == "done"
    plain = run_example("submit_with_zenoh.py", str(job), "demo", shared.endpoint)
    assert plain.returncode == 0, plain.stderr
    assert plain.stdout.split()[1] == "done"
    wrong = shared.file([{"do": "move", "to": {"gantry.q": 1}}], "wrong")
    refused = run_example("submit_with_zenoh.py", str(wrong), "demo", shared.endpoint)
    assert refused.returncode == 1
    assert "gantry" in refused.stderr


@pytest.mark.nightly
def test_a_coordinator_that_slept_loses_leadership_and_moves_nothing(own: RunningFleet) -> None:
    own.started().bring_back()
    own.slow_move()
    first = own.pid("orchestrator.coordinator.process")
    os.kill(first, signal.SIGSTOP)
    stopped_ns = raw_ns()
    took_s = {name: margin_s(stopped_ns, own.rest_ns(name)) for name in SLOW_AXES}
    assert max(took_s.values()) < COORDINATOR_LOST_S + RAMPS_S + BUSY_S, took_s
    command = [sys.executable, "-m", "orchestrator.coordinator.process", "--fleet", str(own.state / "fleet.json")]
    command += ["--connect", own.endpoint, "--journal", str(own.folder / "second.sqlite3")]
    command += ["--log", str(own.folder / "second.jsonl"), "--take-over"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as second:
        try:
            assert second.stdout is not None
            assert second.stdout.readline() == "ready\n"
            starts = {name: own.starts(name) for name in SLOW_AXES}
            os.kill(first, signal.SIGCONT)
            wait_until(lambda: "has lost leadership" in own.output(), "the first one ends")
            assert not wait_a_moment(lambda: {name: own.starts(name) for name in SLOW_AXES} != starts, 1.0)
            report = own.run([{"do": "move", "by": {"gantry.x": 1, "stage.u": 1}}])
            assert report.state == "done", report.reason
            assert report.epoch > 1
        finally:
            second.terminate()
    note("rest_s", took_s)


def test_ctrl_c_in_a_move_stops_it_and_ends_everything(own: RunningFleet) -> None:
    own.started().bring_back()
    own.slow_move()
    asked_ns = raw_ns()
    assert own.end(signal.SIGINT) == 0
    took_s = {name: margin_s(asked_ns, own.rest_ns(name)) for name in SLOW_AXES}
    assert max(took_s.values()) < RAMPS_S + BUSY_S, took_s
    note("rest_s", took_s)


def test_ctrl_c_while_starting_leaves_nothing(own: RunningFleet) -> None:
    wait_until(lambda: "router on" in own.output(), "the router")
    assert own.end(signal.SIGINT) == 130


def test_a_killed_tutti_up_leaves_no_orphans(own: RunningFleet) -> None:
    own.started()
    assert len(own.family()) >= 7
    assert own.end(signal.SIGKILL) == -signal.SIGKILL
