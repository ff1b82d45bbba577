"""The command blocks of the tutorials and how-to pages, run unchanged against a simulated fleet."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from children import wait_until
from fleet import RunningFleet
from pages import ECOSYSTEM_PAGES, OWN_PAGES, commands, programs

from orchestrator.model.report import FINISHED_STATES

pytestmark = [pytest.mark.live, pytest.mark.nightly]

ROOT = Path(__file__).parents[2]
PAGE_S = 240.0
# In reading order: each page finds the fleet as the previous one of its half left it.
FIRST_HALF = (
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
SECOND_HALF = (
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
# They wait for motion most of the time, so `make test-docs` runs both halves side by side, each with a fleet.
PAGES = [
    pytest.param(page, marks=pytest.mark.xdist_group(name))
    for name, half in (("first", FIRST_HALF), ("second", SECOND_HALF))
    for page in half
]


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


def test_every_page_with_commands_is_run() -> None:
    pages = [*(ROOT / "docs" / "tutorial").glob("*.md"), *(ROOT / "docs" / "how-to").glob("*.md")]
    with_commands = {str(page.relative_to(ROOT / "docs")) for page in pages if commands(page) or programs(page)}
    assert with_commands == {*FIRST_HALF, *SECOND_HALF, *ECOSYSTEM_PAGES, *OWN_PAGES}


def is_idle(fleet: RunningFleet) -> bool:
    """Whether no job of the page before is under way."""
    queue = fleet.ask(lambda tutti: tutti.list_jobs())
    return all(job.state in FINISHED_STATES or (job.state == "queued" and not job.ready) for job in queue.jobs)


@pytest.mark.timeout(PAGE_S + 60)
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_work(fleet: RunningFleet, page: str) -> None:
    script = "\n".join(["set -eu", *commands(ROOT / "docs" / page), *programs(ROOT / "docs" / page)])
    if "curl " in script and shutil.which("curl") is None:
        pytest.skip("needs the command curl")
    script = script.replace("tcp/127.0.0.1:7447", fleet.endpoint)
    script = script.replace("127.0.0.1:8080", find_gateway(fleet))
    # Both halves of the pages run at the same time, and some name the same file there.
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
    done = subprocess.run(
        ["bash", "-x", "-c", script], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=PAGE_S
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
