"""A kind of step has one home: a sample kind, kept as a patch, touches few files and is used everywhere."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
PATCH = HERE / "mark_step.patch"
PRODUCT = ("orchestrator", "adapters", "sim", "tutti")
MOST_FILES = 8  # of the product, for a kind that only records an instant

# Where a step's class is asked for outside the kinds: files, and why the step cannot answer itself.
ASKED_FOR_CLASSES = {
    "orchestrator/campaign/jobs.py": "the campaign adds triggers to its own moves",
    "orchestrator/campaign/paths.py": "the checker knows the geometry of the campaign's own paths",
    "orchestrator/cli/manual/one_step.py": "`tutti axis` checks the words of its command before there is a job",
    "orchestrator/cli/paths/path.py": "`tutti path plot` draws paths",
    "orchestrator/coordinator/motion/planning.py": "the planner of paths and that of moves are two",
    "orchestrator/gateway/stream/targets.py": "the page draws the targets of moves",
}
MOST_TESTS = 15


def find_kinds() -> set[str]:
    """The names of all step classes."""
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "orchestrator/model/steps").glob("*.py")]
    classes = [node for source in sources for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef)]
    names = {"Step"}
    while more := {node.name for node in classes if {ast.unparse(base) for base in node.bases} & names} - names:
        names |= more
    return names


def list_class_tests(kinds: set[str]) -> list[str]:
    """The files outside the kinds that test for a step's class, once for each test."""
    files: list[str] = []
    for package in PRODUCT:
        for path in sorted((ROOT / package).rglob("*.py")):
            if path.parent == ROOT / "orchestrator/model/steps":
                continue
            text = path.read_text(encoding="utf-8")
            if "isinstance(" not in text and "match " not in text:
                continue
            for node in ast.walk(ast.parse(text)):
                tested: ast.AST | None = None
                if isinstance(node, ast.Call) and ast.unparse(node.func) in ("isinstance", "issubclass"):
                    tested = node.args[1]
                elif isinstance(node, ast.MatchClass):
                    tested = node.cls
                if tested is not None and {n.id for n in ast.walk(tested) if isinstance(n, ast.Name)} & kinds:
                    files.append(str(path.relative_to(ROOT)))
    return files


def test_steps_are_asked_not_classified() -> None:
    files = list_class_tests(find_kinds())
    assert set(files) <= set(ASKED_FOR_CLASSES), "ask the step (orchestrator/model/steps/base.py), or state the reason"
    assert set(ASKED_FOR_CLASSES) <= set(files), "remove what is not true any more"
    assert len(files) <= MOST_TESTS


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
