"""Run `tutti demo` of an installation outside the checkout: `python tools/wheel_demo.py PATH/TO/bin/tutti`.

Also builds, installs and checks the example make `acme` and a new one. Fails if the job is not done, if a check fails,
or if anything of the checkout is used.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 240
NAMES = ("adapters", "orchestrator", "sim")
PLACES = "import adapters, orchestrator, sim; print(adapters.__file__, orchestrator.__file__, sim.__file__)"


def run_demo(tutti: Path) -> str:
    """Return what is wrong; empty if nothing is."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as elsewhere:

        def run(*command: str) -> "subprocess.CompletedProcess[str]":
            return subprocess.run(
                command, cwd=elsewhere, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
            )

        places = run(str(tutti.with_name("python")), "-c", PLACES).stdout.split()
        if len(places) != 3 or any(Path(each).is_relative_to(ROOT / name) for each in places for name in NAMES):
            return f"modules are not of the installation: {places}"
        for command in (
            ["fleet", "init", "--make", "smc4000", "--out", "new.fleet.yaml"],
            ["fleet", "check", "new.fleet.yaml"],
        ):
            done = run(str(tutti), *command)
            if done.returncode:
                return f"{' '.join(command)}: {done.stderr}"
        demo = run(str(tutti), "demo", "--headless", "--json")
        script = run(str(tutti.with_name("python")), "-c", find_first_script())
        if script.returncode or "verdict" not in script.stdout:
            return f"the lines of README.md: {script.stdout}{script.stderr}"
        problem = check_makes(tutti, Path(elsewhere), environment)
        if problem:
            return problem
    try:
        report = json.loads(demo.stdout)
    except ValueError:
        return demo.stderr or demo.stdout
    # Whether the start skew is guaranteed depends on how busy this machine is.
    return "" if report.get("state") == "done" else demo.stdout


def find_first_script() -> str:
    """The lines that README.md shows first."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return text.partition("```python\n")[2].partition("```")[0]


def check_makes(tutti: Path, elsewhere: Path, environment: dict[str, str]) -> str:
    """Return what is wrong with the makes outside the tree; empty if nothing is."""
    site = elsewhere / "site"
    around = {**environment, "PYTHONPATH": str(site)}
    shutil.copytree(ROOT / "deploy" / "examples" / "adapter-acme", elsewhere / "adapter-acme")
    install = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", str(site)]
    python = str(tutti.with_name("python"))
    for command in (
        [str(tutti), "adapter", "new", "mc2000"],
        [python, *install, "./adapter-acme", "./mc2000"],
        [str(tutti), "adapter", "check", "tutti-acme"],
        [str(tutti), "adapter", "check", "mc2000"],
        [str(tutti), "adapter", "ls"],
    ):
        done = subprocess.run(
            command, cwd=elsewhere, env=around, capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
        if done.returncode:
            return f"{' '.join(command)}: {done.stdout}{done.stderr}"
    return ""


if __name__ == "__main__":
    problem = run_demo(Path(sys.argv[1]).absolute())
    print(problem or "the demo of the installed wheel is done")
    raise SystemExit(bool(problem))
