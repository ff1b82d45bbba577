"""A full disk behind standard output is named, with the exit code of a failure."""

import subprocess
import sys
from pathlib import Path

import pytest

FULL = Path("/dev/full")
EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
COMMAND = [sys.executable, "-c", "from orchestrator.cli.main import main; main(prog_name='tutti')"]


@pytest.mark.skipif(not FULL.exists(), reason="only Linux has /dev/full")
@pytest.mark.parametrize(
    "words",
    [
        ["fleet", "check", str(EXAMPLES / "demo.fleet.yaml")],
        ["fleet", "check", "--json", str(EXAMPLES / "demo.fleet.yaml")],
        ["--help"],
        ["--version"],
    ],
)
def test_a_full_disk_behind_standard_output_is_named(words: list[str]) -> None:
    with FULL.open("w") as full:
        done = subprocess.run([*COMMAND, *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert "standard output cannot be written: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr and "fault of Tutti" not in done.stderr
