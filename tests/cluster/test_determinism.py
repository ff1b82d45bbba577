"""One seed gives one log, byte for byte, with any hash seed of the process."""

import json
import os
import subprocess
import sys

from orchestrator.campaign.scenario import FaultCell, run_scenario

SCRIPT = """
import json
from cluster.test_determinism import write_log
print(json.dumps(write_log()))
"""


def write_log() -> list[str]:
    """What a seed leaves behind: a host that is killed while arming, and a garbled link at the start."""
    broken = (("arm", "host-killed"), ("go", "garbage"))
    story = run_scenario(3, [FaultCell(stage, fault, "shrc203") for stage, fault in broken])
    return [*story.lines, *story.events, *story.violations]


def test_one_seed_one_log() -> None:
    """This process has a hash seed of its own, at random unless one is set, and a history of other tests."""
    here = write_log()
    assert len(here) > 40 and any(here)
    other = "31337" if os.environ.get("PYTHONHASHSEED") != "31337" else "0"
    path = os.pathsep.join(each for each in sys.path if each)
    environment = os.environ | {"PYTHONHASHSEED": other, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, timeout=100, check=True
    )
    assert json.loads(done.stdout) == here
