"""`tutti bench scale --live` with few controllers: everything is measured, and all processes end."""

import contextlib
import json
import os
import subprocess
from pathlib import Path

import pytest
from fleet import COMMAND

pytestmark = [pytest.mark.live, pytest.mark.alone]


def test_ten_controllers_are_measured_live(tmp_path: Path) -> None:
    words = [*COMMAND, "bench", "scale", "--live", "--controllers", "10", "--hosts", "2", "--json"]
    ran = subprocess.run(
        words, env={**os.environ, "TMPDIR": str(tmp_path)}, capture_output=True, text=True, timeout=240, check=False
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    live = json.loads(ran.stdout)["live"]
    assert (live["controllers"], live["hosts"], live["jobs"]) == (10, 2, 10)
    assert (live["jobs_failed"], live["refusals"], live["alarms"], live["losses"]) == (0, 0, 0, 0)
    # A move of 10 mm takes at least a quarter of a second at 200 mm/s and 1000 mm/s².
    assert live["done_s"] > live["start_ms"] / 1e3 + 0.25 and live["jobs_done_s"] > 0.25
    assert all(live[f"{part}_cpu_ms"] > 0 and live[f"{part}_mb"] > 5 for part in ("coordinator", "host", "router"))
    assert list_processes_in(tmp_path) == []


def list_processes_in(folder: Path) -> list[str]:
    """The command lines of processes that have something of `folder` in them."""
    lines: list[str] = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            lines.append(path.read_bytes().replace(b"\0", b" ").decode())
    return [line for line in lines if str(folder) in line]
