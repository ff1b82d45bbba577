"""A kind of step has one home: a sample kind, kept as a patch, touches few files and is used everywhere."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
sys.path.insert(0, str(ROOT / "tools"))
import figures  # noqa: E402

PATCH = HERE / "mark_step.patch"
PRODUCT = ("orchestrator", "adapters", "sim", "tutti", "integrations")
MOST_FILES = 8  # of the product, for a kind that only records an instant

# Where a step's class is asked for outside the kinds: files, and why the step cannot answer itself.
ASKED_FOR_CLASSES = {
    "orchestrator/campaign/stages/flown_scans.py": "the checker knows the lines of the campaign's own scans",
    "orchestrator/campaign/jobs.py": "the campaign adds triggers to its own moves",
    "orchestrator/campaign/paths.py": "the checker knows the geometry of the campaign's own paths",
    "orchestrator/campaign/stages/probes.py": "the checker knows the probes of the campaign",
    "orchestrator/campaign/stages/virtual_moves.py": "the checker knows the targets of the campaign's own moves",
    "orchestrator/cli/manual/one_step.py": "`tutti axis` checks the words of its command before there is a job",
    "orchestrator/cli/paths/path.py": "`tutti path plot` draws paths",
    "orchestrator/coordinator/motion/planning.py": "the planner of paths and that of moves are two",
    "orchestrator/coordinator/motion/retarget.py": "a move can have other targets, a path has not",
    "orchestrator/gateway/stream/targets.py": "the page draws the targets of moves",
}
MOST_TESTS = 15


@pytest.mark.structure
def test_steps_are_asked_not_classified() -> None:
    files = figures.list_class_tests()
    assert set(files) <= set(ASKED_FOR_CLASSES), "ask the step (orchestrator/model/steps/base.py), or state the reason"
    assert set(ASKED_FOR_CLASSES) <= set(files), "remove what is not true any more"
    assert len(files) <= MOST_TESTS


@pytest.mark.structure
def test_a_sample_kind_touches_few_files_and_works(tmp_path: Path) -> None:
    changed = re.findall(r"^\+\+\+ b/(\S+)", PATCH.read_text(encoding="utf-8"), re.MULTILINE)
    assert len([name for name in changed if name.startswith(PRODUCT)]) == len(changed) <= MOST_FILES
    for package in (*PRODUCT, "tests/cluster", "deploy/examples"):
        ignored = shutil.ignore_patterns("__pycache__", "node_modules", "static")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
    applied = subprocess.run(
        ["git", "apply", str(PATCH)], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60
    )
    assert applied.returncode == 0, f"make {PATCH.name} anew for the present tree:\n{applied.stderr}"
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{tmp_path / 'tests'}"}
    done = subprocess.run(
        [sys.executable, str(HERE / "mark_kind.py"), str(tmp_path)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
