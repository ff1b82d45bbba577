"""The recorder of `tutti up`: it records jobs, is started again when it is killed, and serves metrics."""

import json
import re
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from children import LIMIT_S, wait_until
from fleet import BACK, RunningFleet, run_tutti

pytestmark = pytest.mark.live


def list_recordings(folder: Path) -> list[dict[str, Any]]:
    return json.loads(run_tutti("record", "ls", "--folder", str(folder), "--limit", "1000", "--json").stdout)


def test_a_fleet_is_recorded_also_after_its_recorder_was_killed(shared: RunningFleet, tmp_path: Path) -> None:
    folder = shared.state / "recordings"
    shared.bring_back()
    report = shared.run([BACK])
    wait_until(
        lambda: any(
            each["job_id"] == report.job_id and each["state"] == "complete" for each in list_recordings(folder)
        ),
        "the recording of the job is complete",
    )
    output = tmp_path / "run.csv"
    exported = run_tutti("export", report.job_id, "--folder", str(folder), "--to", "csv", "-o", str(output))
    assert exported.returncode == 0, exported.stderr
    assert "gantry.x.position" in output.read_text().splitlines()[0]
    # One recorder uses a folder.
    second = run_tutti(
        "record",
        "start",
        "--fleet",
        "demo",
        "--connect",
        shared.endpoint,
        "--folder",
        str(folder),
        "--metrics-port",
        "0",
    )
    assert second.returncode == 2 and "another recorder uses this folder" in second.stderr
    address = re.findall(r"metrics on (\S+)", shared.output())[-1]
    with urlopen(address, timeout=LIMIT_S) as answer:
        assert b'tutti_controller_online{controller="gantry"} 1.0' in answer.read()

    left = {each["file"] for each in list_recordings(folder) if each["state"] == "being written"}
    assert left
    shared.kill("orchestrator.monitor.recording.process")
    wait_until(
        lambda: left <= {each["file"] for each in list_recordings(folder) if each["state"] == "complete"},
        "what the killed recorder has left is repaired",
    )
    again = shared.run([BACK])
    wait_until(
        lambda: any(each["job_id"] == again.job_id and each["state"] == "complete" for each in list_recordings(folder)),
        "the next job is recorded",
    )
