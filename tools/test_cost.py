"""What the tests of `make test` and `make test-slow` cost: `test_cost.py` runs them and writes `tests/COST.md`.

Processor and wall seconds by folder and of the hundred dearest tests, with the processes that they start. What no test
waited for (collection, fleets of a session, fork servers) is a row of its own.
"""

import json
import os
import resource
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "tests" / "COST.md"
PARTS = {"virtual": "test-fast", "live": "test-live", "slow": "test-slow"}
"""Each part of the suite, and the target of the Makefile that runs it."""
DEAREST = 100


@dataclass(slots=True)
class Cost:
    """Seconds: cpu_s with children, wall_s from the begin to the end of each test, added up."""

    tests: int = 0
    cpu_s: float = 0.0
    wall_s: float = 0.0

    def add(self, cpu_s: float, wall_s: float) -> None:
        self.tests += 1
        self.cpu_s += cpu_s
        self.wall_s += wall_s

    def format_row(self, name: str) -> str:
        return f"| {name} | {self.tests} | {self.cpu_s:.1f} | {self.wall_s:.1f} |"


@dataclass(slots=True)
class PartRun:
    """One part of the suite. lines: a record of each test. cpu_s: of all processes; wall_s: of the command."""

    name: str
    lines: list[dict[str, float | str]]
    cpu_s: float
    wall_s: float
    code: int


def run_part(name: str) -> PartRun:
    """Run a part of the suite by the Makefile, and read what its tests cost."""
    with tempfile.TemporaryDirectory() as folder:
        plugin = {"TUTTI_TEST_COST": folder, "PYTHONPATH": str(ROOT / "tests"), "PYTEST_ADDOPTS": "-p cost_plugin"}
        began_s, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        code = subprocess.run(["make", PARTS[name]], cwd=ROOT, env={**os.environ, **plugin}, check=False).returncode
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        texts = [path.read_text(encoding="utf-8") for path in sorted(Path(folder).glob("*.jsonl"))]
    lines = [json.loads(line) for text in texts for line in text.splitlines()]
    return PartRun(name, lines, cpu_s, time.perf_counter() - began_s, code)


def tabulate_folders(runs: Iterable[PartRun]) -> list[str]:
    """A row for each folder of tests, and for what no test waited for."""
    rows = ["| folder | tests | processor, s | wall, s |", "|---|---|---|---|"]
    for run in runs:
        folders: defaultdict[str, Cost] = defaultdict(Cost)
        for line in run.lines:
            folder = str(PurePosixPath(str(line["test"]).partition("::")[0]).parent)
            folders[folder].add(float(line["cpu_s"]) + float(line["children_s"]), float(line["wall_s"]))
        ranked = sorted(folders.items(), key=lambda item: -item[1].cpu_s)
        rows += [cost.format_row(f"`{folder}`, {run.name}") for folder, cost in ranked]
        rest_s = run.cpu_s - sum(cost.cpu_s for cost in folders.values())
        rows.append(f"| {run.name}: in no test | | {rest_s:.1f} | |")
        rows.append(f"| **{run.name} part** | {len(run.lines)} | {run.cpu_s:.1f} | {run.wall_s:.1f} |")
    return rows


def tabulate_dearest(runs: Iterable[PartRun]) -> list[str]:
    """The dearest tests by processor time, children included."""
    lines = [line for run in runs for line in run.lines]
    lines.sort(key=lambda line: -float(line["cpu_s"]) - float(line["children_s"]))
    rows = ["| test | processor, s | of children | wall, s |", "|---|---|---|---|"]
    for line in lines[:DEAREST]:
        name = str(line["test"]).removeprefix("tests/").replace("|", "\\|")
        cpu_s, children_s = float(line["cpu_s"]), float(line["children_s"])
        rows.append(f"| `{name}` | {cpu_s + children_s:.2f} | {children_s:.2f} | {float(line['wall_s']):.2f} |")
    return rows


def main() -> int:
    """Run all parts and write the table; the exit code of make where a test failed."""
    runs = [run_part(name) for name in PARTS]
    sections = [
        "# What the tests cost",
        "Written by `make test-cost`, on two processors; another machine gives other numbers. Wall times of tests add\n"
        "up to those of two workers.",
        "\n".join(tabulate_folders(runs)),
        f"## The {DEAREST} dearest tests",
        "\n".join(tabulate_dearest(runs)),
    ]
    TABLE.write_text("\n\n".join(sections) + "\n", encoding="utf-8")
    print(f"written: {TABLE.relative_to(ROOT)}")
    return max(run.code for run in runs)


if __name__ == "__main__":
    raise SystemExit(main())
