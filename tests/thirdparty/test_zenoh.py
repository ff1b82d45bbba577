"""The bus of a simulated fleet, read by the command-line client `zenoh` from PyPI."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from children import LIMIT_S
from fleet import RunningFleet

TOOL = [sys.executable, "-c", "from zenoh_cli import main; main()", "--mode", "client"]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningFleet]:
    running = RunningFleet(Path(tmp_path_factory.mktemp("fleet")))
    try:
        yield running.started()
    finally:
        running.close()


def test_a_state_is_read_by_its_key(fleet: RunningFleet) -> None:
    command = [*TOOL, "--connect", fleet.endpoint, "get", "--decoder", "text"]
    command += ["-s", "tutti/v1/demo/ctl/gantry/state"]
    said = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=True)
    (line,) = [line for line in said.stdout.splitlines() if line.startswith("{")]
    assert json.loads(line)["axes"].keys() == {"x", "y"}


def test_heartbeats_are_printed_as_they_come(fleet: RunningFleet) -> None:
    command = [*TOOL, "--connect", fleet.endpoint, "subscribe", "--decoder", "text"]
    command += ["-k", "tutti/v1/demo/leader"]
    with subprocess.Popen([command[0], "-u", *command[1:]], stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout is not None
        found = [json.loads(listener.stdout.readline()) for _ in range(3)]
        listener.kill()
    assert {each["schema"] for each in found} == {"tutti.leader/1"}
