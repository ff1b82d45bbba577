"""The jog panel as an operator uses it: on a terminal of its own, with a whole live fleet; judged by the simulators'
ground truth."""

import getpass
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
from children import LIMIT_S, wait_until
from fleet import EXAMPLES, RunningFleet, margin_s, run_tutti, wait_a_moment

from orchestrator.clock.live import raw_ns
from orchestrator.runtime.live.terminal_process import TerminalProcess

# By itself: a renewal that a busy machine delays for 200 ms rightly ends a jog.
pytestmark = [pytest.mark.live, pytest.mark.alone]

COMMAND = "from orchestrator.cli.main import main; main(prog_name='tutti')"

# The declared times, in seconds, and a margin for a busy machine.
SILENCE_S = 0.2
RAMP_S = 0.1
BUSY_S = 1.5


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningFleet]:
    running = RunningFleet(tmp_path_factory.mktemp("jog"))
    try:
        running.started()
        done = running.run([{"do": "enable", "axes": ["gantry"]}, {"do": "home", "axes": ["gantry"]}])
        assert done.state == "done", done.reason
        yield running
    finally:
        running.close()


Start = Callable[..., TerminalProcess]


@pytest.fixture
def start(fleet: RunningFleet) -> Iterator[Start]:
    """Starts panels, and ends them with the test. Ready when the axes are listed and free."""
    wait_until(lambda: not fleet.status()["gantry"].leases, "the axes are free")
    begun: list[TerminalProcess] = []

    def started(*arguments: str, releases: bool = True) -> TerminalProcess:
        panel = TerminalProcess(COMMAND, ["axis", "jog", *arguments, "--connect", fleet.endpoint], releases=releases)
        begun.append(panel)
        wait_until(lambda: "motor" in panel.screen_text and " on " in panel.screen_text, "the panel is there")
        return panel

    yield started
    for panel in begun:
        panel.close()


def begins(fleet: RunningFleet, panel: TerminalProcess, arrow: str = "right") -> None:
    """Press and hold an arrow until the axis really moves."""
    before = fleet.starts("gantry")
    panel.press_arrow(arrow)
    holding(panel, arrow, lambda: fleet.starts("gantry") > before, "it moves")


def holding(panel: TerminalProcess, arrow: str, condition: Callable[[], bool], what: str) -> None:
    """Wait with the key held."""

    def repeated() -> bool:
        panel.repeat_arrow(arrow)
        return condition()

    wait_until(repeated, what)


def at_rest_ns(fleet: RunningFleet) -> int:
    """When the axis came to rest; waited for."""
    return fleet.at_rest("gantry")["end_ns"]


def test_an_axis_moves_while_its_key_is_held(fleet: RunningFleet, start: Start) -> None:
    panel = start("gantry.x")
    assert "Releases are reported" in panel.screen_text
    begins(fleet, panel)
    began_ns = raw_ns()
    holding(panel, "right", lambda: raw_ns() > began_ns + 1_500_000_000, "it is held for longer than without repeats")
    holding(panel, "right", lambda: "you" in panel.screen_text, "the panel shows who has it")
    let_go_ns = panel.release_arrow("right")
    last = fleet.at_rest("gantry")
    # Not necessarily until it was let go: a stop by silence is right when a busy machine delays a renewal.
    assert margin_s(last["start_ns"], last["end_ns"]) > SILENCE_S + RAMP_S
    assert margin_s(let_go_ns, last["end_ns"]) < RAMP_S + BUSY_S
    assert last["end_counts"] > last["start_counts"]
    begins(fleet, panel, "left")
    panel.release_arrow("left")
    last = fleet.at_rest("gantry")
    assert last["end_counts"] < last["start_counts"]
    wait_until(lambda: not fleet.status()["gantry"].leases, "it is given back after a while")


def test_a_step_is_a_job_of_the_panel(fleet: RunningFleet, start: Start) -> None:
    panel = start("gantry.x")
    before = fleet.status()["gantry"].axes["x"].position
    panel.type_text("\t\t\t")
    wait_until(lambda: "[1]" in panel.screen_text, "the size is chosen")
    panel.press_arrow("left")
    panel.release_arrow("left")
    wait_until(lambda: "done: move gantry.x by -1" in panel.screen_text, "the step is made")
    assert fleet.status()["gantry"].axes["x"].position == pytest.approx(before - 1)


@pytest.mark.nightly
def test_a_plain_terminal_taps_and_holds(fleet: RunningFleet, start: Start) -> None:
    panel = start("gantry.x", releases=False)
    assert "reports no releases" in panel.screen_text
    before = fleet.starts("gantry")
    tapped_ns = panel.press_arrow("right")
    wait_until(lambda: fleet.starts("gantry") > before, "the tap moves it")
    assert margin_s(tapped_ns, at_rest_ns(fleet)) < SILENCE_S + RAMP_S + BUSY_S
    begins(fleet, panel)
    let_go_ns = raw_ns()
    assert margin_s(let_go_ns, at_rest_ns(fleet)) < SILENCE_S + RAMP_S + BUSY_S


def test_a_killed_panel_stops_by_silence(fleet: RunningFleet, start: Start) -> None:
    panel = start("gantry.x")
    begins(fleet, panel)
    killed_ns = panel.kill()
    assert margin_s(killed_ns, at_rest_ns(fleet)) < SILENCE_S + RAMP_S + BUSY_S


def test_an_unplugged_terminal_stops_it_and_ends_the_panel(fleet: RunningFleet, start: Start) -> None:
    panel = start("gantry.x")
    begins(fleet, panel)
    unplugged_ns = raw_ns()
    panel.hang_up()
    assert margin_s(unplugged_ns, at_rest_ns(fleet)) < SILENCE_S + RAMP_S + BUSY_S
    assert panel.wait(LIMIT_S) == 130
    assert not fleet.status()["gantry"].leases


def test_a_second_panel_is_refused_and_shows_the_owner_of_the_lease(fleet: RunningFleet, start: Start) -> None:
    first, second = start("gantry.x"), start("gantry.x")
    begins(fleet, first)
    motions = len(fleet.truth("gantry"))
    second.press_arrow("left")
    holding(first, "right", lambda: "refused" in second.screen_text, "the second one is refused")
    assert f"in use by {getpass.getuser()} (jog panel)" in second.screen_text
    job_id = fleet.submit([{"do": "enable", "axes": ["gantry"]}])

    def waits() -> bool:
        entry = fleet.ask(lambda tutti: tutti.show_job(job_id)).entry
        return entry is not None and entry.state == "queued" and "gantry" in entry.reason

    holding(first, "right", waits, "the job waits, and says for what")
    first.release_arrow("right")
    at_rest_ns(fleet)
    ended = [entry for entry in fleet.truth("gantry")[motions:] if entry["event"] == "end"]
    assert all(entry["end_counts"] >= entry["start_counts"] for entry in ended), "the refused key moved it to the left"
    assert fleet.wait(job_id).state == "done"


def test_a_jog_that_was_stopped_elsewhere_needs_another_press(fleet: RunningFleet, start: Start) -> None:
    panel = start("gantry.x")
    begins(fleet, panel)
    assert json.loads(fleet.tutti("stop", "--json").stdout)["gantry"] is None
    at_rest_ns(fleet)
    count = fleet.starts("gantry")

    def moves() -> bool:
        panel.repeat_arrow("right")
        return fleet.starts("gantry") != count

    assert not wait_a_moment(moves, 1.0)
    wait_until(lambda: "refused" in panel.screen_text or "stopped" in panel.screen_text, "it says why")
    panel.release_arrow("right")
    begins(fleet, panel, "left")
    panel.type_text("q")
    assert panel.wait(LIMIT_S) == 0
    at_rest_ns(fleet)


@pytest.mark.parametrize(("end", "code"), [("q", 0), ("\x1b[99;5u", 130), (signal.SIGTERM, 130), (signal.SIGHUP, 130)])
def test_the_terminal_settings_are_restored(
    fleet: RunningFleet, start: Start, end: str | signal.Signals, code: int
) -> None:
    panel = start()
    assert panel.keyboard_flags == 3
    assert panel.terminal_mode() != panel.before
    begins(fleet, panel)
    if isinstance(end, str):
        panel.type_text(end)
    else:
        panel.process.send_signal(end)
    assert panel.wait(LIMIT_S) == code
    assert panel.terminal_mode() == panel.before
    assert panel.keyboard_flags == 0
    wait_until(lambda: panel.recent_output.endswith("\x1b[?25h\x1b[?1049l"), "cursor and screen are back")
    at_rest_ns(fleet)
    assert not fleet.status()["gantry"].leases


def test_ctrl_z_does_not_suspend_it(fleet: RunningFleet, start: Start) -> None:
    panel = start("gantry.x")
    begins(fleet, panel)
    panel.type_text("\x1b[122;5u")
    at_rest_ns(fleet)
    wait_until(lambda: "background" in panel.screen_text, "it says so")
    panel.process.send_signal(signal.SIGTSTP)
    begins(fleet, panel, "left")
    panel.release_arrow("left")
    at_rest_ns(fleet)


def test_without_a_terminal_it_reports_what_to_do(fleet: RunningFleet) -> None:
    done = fleet.tutti("axis", "jog")
    assert done.returncode == 2
    assert "tutti axis move --relative" in done.stderr
    assert run_tutti("axis", "jog").returncode == 2


def test_the_example_jogs_for_a_second(fleet: RunningFleet, start: Start) -> None:
    del start  # waits until the axes are free
    example = [sys.executable, str(EXAMPLES / "jog_by_hand.py"), "gantry.x", "5", fleet.endpoint]
    done = subprocess.run(example, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    last = fleet.at_rest("gantry")  # it has received a stop, and may have been on its ramp when the script ended
    assert 0.9 < margin_s(last["start_ns"], last["end_ns"]) < 1.0 + SILENCE_S + BUSY_S
    assert last["end_counts"] - last["start_counts"] > 4000
    example[2] = "stage.u"
    example[3] = "500"
    refused = subprocess.run(example, capture_output=True, text=True, timeout=LIMIT_S)
    assert refused.returncode == 1
    assert refused.stderr


def test_an_unknown_axis_is_bad_input(fleet: RunningFleet) -> None:
    panel = TerminalProcess(COMMAND, ["axis", "jog", "gantry.q", "--connect", fleet.endpoint], releases=True)
    try:
        assert panel.wait(LIMIT_S) == 2
        assert "gantry.q" in panel.recent_output
    finally:
        panel.close()
