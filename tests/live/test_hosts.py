"""A fleet whose adapter hosts are started apart: `tutti up --host`, and `tutti host`."""

import signal
import subprocess
from pathlib import Path

import pytest
from children import LIMIT_S, wait_until
from fleet import COMMAND, EXAMPLES, SLOW, RunningFleet, run_tutti

from orchestrator.model.jobs.files import load_fleet

pytestmark = pytest.mark.live


def write_fleet(folder: Path) -> Path:
    """The demo fleet, its stage on a host of its own."""
    fleet = load_fleet(EXAMPLES / "demo.fleet.yaml")
    hosts = {"gantry": "left", "stage": "right"}
    controllers = {name: config.model_copy(update={"host": hosts[name]}) for name, config in fleet.controllers.items()}
    path = folder / "demo.fleet.json"
    path.write_bytes(fleet.model_copy(update={"controllers": controllers}).to_json())
    return path


class RunningHost:
    """`tutti host right --sim` beside a fleet."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.state = folder / "right"
        self.said = folder / "host.out"
        command = [*COMMAND, "host", "right", "--fleet", "demo", "--connect", endpoint, "--sim", "--state"]
        with self.said.open("w") as out:
            self.process = subprocess.Popen(
                [*command, str(self.state)], stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
            )

    def end(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.wait(LIMIT_S)


def test_two_hosts_do_a_job_and_stop_with_each_other(tmp_path: Path) -> None:
    fleet = RunningFleet(tmp_path, write_fleet(tmp_path), "--host", "left")
    host = None
    try:
        wait_until(lambda: "is up" in fleet.output() or fleet.up.poll() is not None, "the fleet is up")
        assert "stage not reached yet" in fleet.output()
        host = RunningHost(tmp_path, fleet.endpoint)
        wait_until(lambda: "drives stage" in host.said.read_text(), "the host has started")
        fleet.bring_back()

        again = run_tutti(
            "host", "right", "--fleet", "demo", "--connect", fleet.endpoint, "--state", str(tmp_path / "x")
        )
        assert again.returncode == 1 and "stage is served already" in again.stderr

        job_id = fleet.submit(SLOW)
        wait_until(lambda: fleet.status()["gantry"].mode == "moving", "it moves")
        assert host.end() == 0
        report = fleet.wait(job_id)
        assert report.state in ("failed", "aborted") and "stage" in report.reason
        wait_until(lambda: not any(axis.moving for axis in fleet.status()["gantry"].axes.values()), "it is at rest")
        assert fleet.end(signal.SIGINT) == 0
    finally:
        if host is not None:
            host.end()
        fleet.close()


def test_a_host_that_the_fleet_does_not_have_is_named_with_those_it_has(tmp_path: Path) -> None:
    refused = run_tutti("up", str(write_fleet(tmp_path)), "--host", "middle")
    assert refused.returncode == 2
    assert "no controller has `host: middle`; its hosts: left, right" in refused.stderr
