"""One seed gives one log, byte for byte, with any hash seed of the process."""

import hashlib
import os
import subprocess
import sys

SCRIPT = """
import hashlib
from orchestrator.campaign.scenario import FaultCell, run_scenario
broken = (("arm", "host-killed"), ("go", "garbage"))
story = run_scenario(3, [FaultCell(stage, fault, "shrc203") for stage, fault in broken])
lines = [*story.lines, *story.events, *story.violations]
print(len(lines), hashlib.sha256("\\n".join(lines).encode()).hexdigest())
"""


def run_with(hash_seed: str) -> str:
    path = os.pathsep.join(each for each in sys.path if each)
    environment = os.environ | {"PYTHONHASHSEED": hash_seed, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, timeout=100, check=True
    )
    return done.stdout


def test_one_seed_one_log() -> None:
    first = run_with("0")
    assert int(first.split()[0]) > 40
    assert first.split()[1] != hashlib.sha256(b"").hexdigest()
    assert run_with("31337") == first
