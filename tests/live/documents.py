"""The command blocks of the tutorials and how-to pages, run unchanged against a simulated fleet.

They wait for motion half of the time, so `make test-docs` runs the two modules that have them side by side, each with a
fleet. Within a module they run in reading order: each page finds the fleet as the page before has left it.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from children import wait_until
from fleet import RunningFleet
from pages import commands, programs

from orchestrator.model.report import FINISHED_STATES

MOTION = (
    "tutorial/first-quarter-hour.md",
    "tutorial/first-day.md",
    "tutorial/first-script.md",
    "how-to/write-a-fleet.md",
    "how-to/write-a-job.md",
    "how-to/scan-points.md",
    "how-to/scan-without-stopping.md",
    "how-to/think-in-other-axes.md",
    "how-to/probe.md",
    "how-to/compensate.md",
    "how-to/drive-a-gantry-pair.md",
    "how-to/move-along-a-path.md",
    "how-to/run-a-program-from-cam.md",
    "how-to/use-templates.md",
)
OPERATION = (
    "how-to/name-positions.md",
    "how-to/work-with-the-queue.md",
    "how-to/record-and-export.md",
    "how-to/watch-metrics.md",
    "how-to/handle-alarms.md",
    "how-to/look-at-a-run.md",
    "how-to/use-python.md",
    "how-to/drive-move-by-move.md",
    "how-to/read-states.md",
    "how-to/arm-and-go.md",
    "how-to/test-your-jobs.md",
    "how-to/manage-users-and-roles.md",
    "how-to/keep-axes-apart.md",
    "how-to/use-http.md",
)

ROOT = Path(__file__).parents[2]
PAGE_S = 240.0
LIMITED = pytest.mark.timeout(PAGE_S + 60)


def find_gateway(fleet: RunningFleet) -> str:
    """Host and port under which the gateway serves."""
    return re.findall(r"page on http://([\d.:]+)/", fleet.output())[0]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningFleet]:
    fleet = RunningFleet(tmp_path_factory.mktemp("documents"), recorded=True, web=True)
    try:
        yield fleet.started()
    finally:
        fleet.end()


def is_idle(fleet: RunningFleet) -> bool:
    """Whether no job of the page before is under way."""
    queue = fleet.ask(lambda tutti: tutti.list_jobs())
    return all(job.state in FINISHED_STATES or (job.state == "queued" and not job.ready) for job in queue.jobs)


def run_page(fleet: RunningFleet, page: str) -> None:
    """Run all commands of a page, one after the other."""
    script = "\n".join(["set -eu", *commands(ROOT / "docs" / page), *programs(ROOT / "docs" / page)])
    if "curl " in script and shutil.which("curl") is None:
        pytest.skip("needs the command curl")
    script = script.replace("tcp/127.0.0.1:7447", fleet.endpoint)
    script = script.replace("127.0.0.1:8080", find_gateway(fleet))
    # Other pages run at the same time, and some name the same file there.
    own_folder = fleet.folder / "tmp"
    own_folder.mkdir(exist_ok=True)
    script = re.sub(r"/tmp\b", str(own_folder), script)
    # The fleet is where `tutti up` without --state would have put it.
    state_home = fleet.folder / "state-home"
    place = state_home / "tutti" / "demo"
    if not place.exists():
        place.parent.mkdir(parents=True)
        place.symlink_to(fleet.state)
    wait_until(lambda: is_idle(fleet), "the jobs of the page before have ended")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {
        "PATH": path,
        "TMPDIR": str(own_folder),
        "TUTTI_CONNECT": fleet.endpoint,
        "XDG_STATE_HOME": str(state_home),
    }
    words = ["bash", "-x", "-c", script]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, cwd=ROOT, env=environment, start_new_session=True, **pipes) as process:
        try:
            out, errors = process.communicate(timeout=PAGE_S)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # a command that waits would outlive its shell
    assert process.returncode == 0, out[-3000:] + errors[-3000:]
