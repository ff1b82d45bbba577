"""Run the tests of a user's project outside the checkout: `python tools/wheel_project.py PATH/TO/python`.

The project is `deploy/examples/headless-tests`. The interpreter is that of an environment with the wheel; pytest is
installed there from the lock, with its hashes. Also measures how long a virtual minute of the demo fleet takes.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 240
TOOLS = ("pytest", "iniconfig", "packaging", "pluggy", "pygments")  # pytest, and what it needs
MOST_CPU_S = 4.0  # twice the figure that is published: the machine may be busy

# A minute of a fleet at work: it is homed, and runs the demo job again and again, with pauses as between samples.
MINUTE = """
import sys, time
from tutti import load_job
from tutti.testing import virtual_fleet

job, path = load_job(sys.argv[2]), sys.argv[1]
for _ in range(2):  # the second one: everything is loaded
    begun_s = time.process_time()
    with virtual_fleet(path) as fleet:
        while fleet.now_s < 60:
            fleet.tutti.run(job)
            fleet.advance("3 s")
    taken_s = time.process_time() - begun_s
print(f"{taken_s:.2f}")
"""


def read_locked(lock: str) -> str:
    """The blocks of a lock that pin `TOOLS`, with their hashes."""
    blocks = re.split(r"\n(?=[a-z0-9])", lock)
    return "\n".join(each for each in blocks if re.split("[=<>; ]", each)[0] in TOOLS)


def run_project(python: Path) -> str:
    """Return what is wrong; empty if nothing is."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as elsewhere:
        folder = Path(elsewhere) / "project"
        shutil.copytree(ROOT / "deploy" / "examples" / "headless-tests", folder)
        lock = Path(elsewhere) / "tools.lock"
        lock.write_text(read_locked((ROOT / "requirements/dev.lock").read_text(encoding="utf-8")), encoding="utf-8")

        def run(*arguments: str | Path) -> "subprocess.CompletedProcess[str]":
            return subprocess.run(
                [python, *arguments],
                cwd=folder,
                env=environment,
                capture_output=True,
                text=True,
                timeout=LIMIT_S,
                check=False,
            )

        options = ("--disable-pip-version-check", "--quiet", "--require-hashes", "--no-deps")
        installed = run("-m", "pip", "install", *options, "-r", lock)
        place = run("-c", "import tutti.testing; print(tutti.testing.__file__)").stdout.strip()
        if installed.returncode or not place or Path(place).is_relative_to(ROOT / "tutti"):
            return f"{installed.stderr}the package is at {place!r}"
        tests = run("-m", "pytest", "-q")
        if tests.returncode:
            return tests.stdout + tests.stderr
        print(tests.stdout.strip().splitlines()[-1])
        examples = ROOT / "deploy" / "examples"
        minute = run("-c", MINUTE, examples / "demo.fleet.yaml", examples / "demo.job.yaml")
        if minute.returncode:
            return minute.stderr
    print(f"a virtual minute of the demo fleet: {float(minute.stdout):.2f} s of CPU")
    return "" if float(minute.stdout) < MOST_CPU_S else f"that is more than {MOST_CPU_S:g} s"


if __name__ == "__main__":
    problem = run_project(Path(sys.argv[1]).absolute())
    print(problem or "the tests of a user's project pass with the installed wheel")
    raise SystemExit(bool(problem))
