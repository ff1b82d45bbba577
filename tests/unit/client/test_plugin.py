"""The pytest plugin: fixtures, the checks as failures of tests, the log of failed tests; harmless to other suites."""

import subprocess
import sys
from pathlib import Path

import pytest

DEMO = Path(__file__).parents[3] / "deploy" / "examples" / "demo.fleet.yaml"


def run_tests(folder: Path, text: str, *options: str) -> "subprocess.CompletedProcess[str]":
    """Run a suite of its own, which is not in the project."""
    (folder / "pytest.ini").write_text("[pytest]\nfilterwarnings = error\n", encoding="utf-8")
    (folder / "test_it.py").write_text(text.replace("DEMO", repr(str(DEMO))), encoding="utf-8")
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *options],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


SUITE = """
import pytest
from tutti import Job, Move
from tutti.testing import virtual_fleet as make_fleet

def test_that_passes(virtual_fleet):
    fleet = virtual_fleet(DEMO, seed=3)
    fleet.tutti.enable("gantry")
    fleet.tutti.home("gantry.x")
    with fleet:
        fleet.tutti.move({"gantry.x": 5})

def test_that_asserts(virtual_fleet):
    fleet = virtual_fleet(DEMO)
    fleet.tutti.enable("gantry")
    assert fleet.now_s < 0

def test_that_leaves_an_axis_moving(virtual_fleet):
    fleet = virtual_fleet(DEMO, seed=9)
    fleet.tutti.enable("gantry")
    fleet.tutti.home("gantry.x")
    fleet.tutti.submit(Job("far", [Move(to={"gantry.x": 300}, speed=0.01)]))
    fleet.advance("1 s")

def test_that_is_not_checked(virtual_fleet):
    fleet = virtual_fleet(DEMO, seed=9, check=False)
    fleet.tutti.enable("gantry")
    fleet.tutti.home("gantry.x")
    fleet.tutti.submit(Job("far", [Move(to={"gantry.x": 300}, speed=0.01)]))
    fleet.advance("1 s")

def test_that_forgets_its_fleet():
    make_fleet(DEMO).__enter__()

@pytest.fixture
def homed(virtual_fleet):
    fleet = virtual_fleet(DEMO)
    fleet.tutti.enable("gantry")
    fleet.tutti.home("gantry.x")
    return fleet

def test_with_a_fixture_of_its_own(homed):
    homed.tutti.move({"gantry.x": 5})
"""


def test_violations_are_failures_with_seed_and_log_and_a_fleet_left_running_is_ended(tmp_path: Path) -> None:
    done = run_tests(tmp_path, SUITE, "-rA")
    out = done.stdout
    assert "3 failed, 3 passed" in out, out + done.stderr
    for name in ("passes", "is_not_checked"):
        assert f"PASSED test_it.py::test_that_{name}" in out
    assert "PASSED test_it.py::test_with_a_fixture_of_its_own" in out
    assert "FleetViolation: fleet demo, seed 9" in out and "job far is still running at the end of the test" in out
    assert "has left <virtual fleet demo, seed 1" in out and "use it as a context" in out
    log = out[out.index("test_that_asserts") :]
    assert "Captured tutti call" in log and '"text": "link opened"' in log


def test_other_suites_are_not_touched(tmp_path: Path) -> None:
    suite = (
        "import sys\ndef test_it():\n    assert not [n for n in sys.modules if n.startswith(('adapters', 'sim.'))]\n"
    )
    assert run_tests(tmp_path, suite).returncode == 0
    without = run_tests(tmp_path, suite + "def test_two(virtual_fleet):\n    pass\n", "-p", "no:tutti")
    assert "1 passed, 1 error" in without.stdout and "fixture 'virtual_fleet' not found" in without.stdout


def test_the_fixtures_are_there_in_every_suite(virtual_fleet: object, request: pytest.FixtureRequest) -> None:
    assert callable(virtual_fleet) and request.config.pluginmanager.has_plugin("tutti")
