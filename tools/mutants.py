"""Change the safety core in one place at a time, and print which tests notice: `mutants.py [--count 60] [--seeds 10]
[--jobs 2]`.

A change that no test notices is a rule without a test. Places are drawn from the syntax tree of the modules of `AREAS`,
always the same ones: a comparison turned round, + for -, a constant times ten, a stop left out, a condition negated.
Each change is made in a copy of the tree. There the directed tests of its area run until the first one fails, then the
campaign seeds, until one has a violation; a change that makes them hang is noticed too.
"""

import argparse
import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from pathlib import Path
from queue import SimpleQueue
from random import Random
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
COPIED = ("adapters", "deploy", "docs", "orchestrator", "sim", "tests", "tools", "tutti", "pyproject.toml")
DRAW = 1  # of the places: the same ones each time
FIRST_SEED = 7_000_000  # of the campaign: not among those that other tests run
TESTS_S, SEED_S = 300, 60  # longest duration; beyond it the change has made something hang

HOSTS = ("tests/cluster/test_authority.py", "tests/cluster/test_hosts.py", "tests/cluster/test_heartbeat.py")
STEPS = (
    "tests/unit/adapters/test_member.py",
    "tests/unit/adapters/test_next_step.py",
    "tests/cluster/test_late_starts.py",
    "tests/cluster/test_faults.py",
)
STARTS = ("tests/cluster/test_start_times.py", "tests/cluster/test_lines.py")
STOPS = (
    "tests/unit/adapters/test_mode.py",
    "tests/cluster/test_jog_faults.py",
    "tests/cluster/test_estop_reset.py",
    "tests/cluster/test_flapping_links.py",
)
LINES = ("tests/contract/test_ascii.py", "tests/contract/test_galil.py", "tests/unit/adapters/test_line_move.py")

AREAS: dict[str, tuple[str, ...]] = {
    "orchestrator/coordinator/motion/start.py": (*STEPS, *STARTS),
    "orchestrator/coordinator/motion/watch.py": STEPS,
    "orchestrator/coordinator/fleet/leases.py": (*STEPS, *STARTS, "tests/cluster/test_by_hand.py"),
    "adapters/controller/slots/participant.py": STEPS,
    "adapters/controller/slots/step_checks.py": STEPS,
    "adapters/controller/slots/withdrawal.py": STEPS,
    "adapters/controller/state/fencing.py": (*HOSTS, *STOPS),
    "adapters/controller/state/leases.py": (*STEPS, "tests/cluster/test_by_hand.py"),
    "adapters/controller/pending_stop.py": STOPS,
    "adapters/controller/stops.py": STOPS,
    "adapters/controller/supervisor.py": STOPS,
    "adapters/toolkit/lines/mover.py": LINES,
    "adapters/host/host.py": HOSTS,
    "adapters/host/guardian.py": HOSTS,
    "adapters/host/leader_watch.py": HOSTS,
}
"""The modules of the safety core, and the tests that state what each has to do."""

TURNED: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.GtE(),
    ast.LtE: ast.Gt(),
    ast.Gt: ast.LtE(),
    ast.GtE: ast.Lt(),
    ast.Eq: ast.NotEq(),
    ast.NotEq: ast.Eq(),
    ast.Is: ast.IsNot(),
    ast.IsNot: ast.Is(),
}
STOPPING = ("stop", "brake", "abort", "withdraw", "latch", "require")
"""Parts of the names of calls that stop, or that refuse what must not begin."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: `old` at a character offset of a file, replaced by `new`. line: from 1."""

    path: str
    line: int
    offset: int
    old: str
    new: str
    kind: str


@dataclass(frozen=True, slots=True)
class Finding:
    """What noticed a mutant: a directed test, "" if none, and how many of the seeds."""

    test: str
    seeds: int

    @property
    def is_unnoticed(self) -> bool:
        """Whether nothing noticed it."""
        return not (self.test or self.seeds)


def list_mutants(path: str, source: str) -> list[Mutant]:
    """List every change of a module, by place. path: as it is printed."""
    lines = source.splitlines(keepends=True)
    line_starts = list(accumulate(map(len, lines), initial=0))

    def find_offset(line: int, column: int) -> int:
        # Columns of the syntax tree count bytes, those of the text characters.
        return line_starts[line - 1] + len(lines[line - 1].encode()[:column].decode())

    mutants: list[Mutant] = []
    for node in ast.walk(ast.parse(source)):
        for target, new, kind in _change_node(node):
            assert target.end_lineno is not None
            assert target.end_col_offset is not None
            offset = find_offset(target.lineno, target.col_offset)
            old = source[offset : find_offset(target.end_lineno, target.end_col_offset)]
            mutants.append(Mutant(path, target.lineno, offset, old, new, kind))
    return sorted(mutants, key=lambda mutant: (mutant.offset, mutant.kind))


def _change_node(node: ast.AST) -> Iterator[tuple[ast.expr | ast.stmt, str, str]]:
    """Yield the part of a node that is replaced, its replacement, and the kind of the change."""
    match node:
        case ast.Compare(left, [operator], comparators) if type(operator) in TURNED:
            turned_node = ast.Compare(left, [TURNED[type(operator)]], comparators)
            yield node, f"({ast.unparse(turned_node)})", "comparison turned round"
        case ast.BinOp(left, ast.Add(), right) if not _is_text(left) and not _is_text(right):
            yield node, f"({ast.unparse(ast.BinOp(left, ast.Sub(), right))})", "- for +"
        case ast.Assign([ast.Name(name)], ast.Constant(int()) | ast.BinOp() as value) if name.isupper():
            yield value, f"10 * ({ast.unparse(value)})", "constant times ten"
        case ast.Expr(ast.Call() | ast.Await(ast.Call())) if _stops(node):
            yield node, "pass", "call left out"
        case ast.If(test) | ast.While(test) if not isinstance(test, ast.Compare | ast.Constant):
            yield test, f"(not ({ast.unparse(test)}))", "condition negated"
        case _:
            pass


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
    )


def _stops(statement: ast.Expr) -> bool:
    call = statement.value.value if isinstance(statement.value, ast.Await) else statement.value
    assert isinstance(call, ast.Call)
    name = ast.unparse(call.func).rpartition(".")[2]
    return any(part in name for part in STOPPING)


def draw_mutants(count: int, root: Path = ROOT) -> list[Mutant]:
    """Draw changes from the whole safety core; a larger count begins with those of a smaller one."""
    mutants = [mutant for path in AREAS for mutant in list_mutants(path, (root / path).read_text(encoding="utf-8"))]
    return Random(DRAW).sample(mutants, len(mutants))[:count]


def apply_mutant(mutant: Mutant, source: str) -> str:
    """Return a module's text with the change."""
    end = mutant.offset + len(mutant.old)
    return source[: mutant.offset] + mutant.new + source[end:]


def try_mutant(mutant: Mutant, tree: Path, seeds: int) -> Finding:
    """Run tests and seeds with the change in a copy of the tree, which is as before afterwards."""
    module = tree / mutant.path
    source = module.read_text(encoding="utf-8")
    module.write_text(apply_mutant(mutant, source), encoding="utf-8")
    try:
        return Finding(_find_test(tree, AREAS[mutant.path]), sum(_violates(tree, FIRST_SEED + n) for n in range(seeds)))
    finally:
        module.write_text(source, encoding="utf-8")


def _find_test(tree: Path, tests: tuple[str, ...]) -> str:
    """Return the first directed test that fails, "" if none does."""
    selection = "not nightly and not live and not browser"
    command = ("-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", selection, *tests)
    result = _run_python(tree, TESTS_S, command)
    if result is None:
        return "hangs"
    if result.returncode == 0:
        return ""
    failed_lines = [line for line in result.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    if not failed_lines:
        return "not loaded"
    test_file, _, test_name = failed_lines[0].partition(" ")[2].partition(" - ")[0].partition("::")
    return f"{Path(test_file).name}::{test_name}"


def _violates(tree: Path, seed: int) -> bool:
    """Return whether a campaign seed has a violation, fails or hangs."""
    program = "from orchestrator.cli.entry import main; main()"
    result = _run_python(tree, SEED_S, ("-c", program, "sim", "campaign", "--seed", str(seed)))
    return result is None or result.returncode != 0


def _run_python(tree: Path, seconds: float, arguments: tuple[str, ...]) -> subprocess.CompletedProcess[str] | None:
    """Run Python with the copy's packages; None: it did not end in time."""
    environment = {**os.environ, "PYTHONPATH": f"{tree}{os.pathsep}{tree / 'tests'}", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        return subprocess.run(
            (sys.executable, *arguments),
            cwd=tree,
            env=environment,
            timeout=seconds,
            capture_output=True,
            text=True,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None


def _copy_tree(tree: Path) -> Path:
    tree.mkdir()
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__", "node_modules"))
        else:
            shutil.copy(ROOT / name, tree / name)
    return tree


def describe_finding(mutant: Mutant, finding: Finding, seeds: int) -> str:
    """Return a row of the table: place, change, the test that noticed it, and how many seeds did."""
    change = f"{mutant.kind}: {mutant.old}".replace("|", "\\|").splitlines()[0][:70]
    return f"| {mutant.path}:{mutant.line} | {change} | {finding.test or '–'} | {finding.seeds} of {seeds} |"


def main() -> None:
    """Print the table. Exit 1 when nothing noticed a change."""
    parser = argparse.ArgumentParser(description="Change the safety core in single places; print which tests notice.")
    parser.add_argument("--count", type=int, default=60, help="number of changes")
    parser.add_argument("--seeds", type=int, default=10, help="campaign seeds for each change")
    parser.add_argument("--jobs", type=int, default=2, help="number of copies that are tested at the same time")
    options = parser.parse_args()
    mutants, unnoticed = draw_mutants(options.count), 0
    print(f"{len(mutants)} changes, {options.seeds} campaign seeds each, from {FIRST_SEED}:\n")
    print("| place | change | noticed by | seeds |\n|---|---|---|---|", flush=True)
    with TemporaryDirectory(prefix="tutti-mutants-") as folder, ThreadPoolExecutor(options.jobs) as pool:
        trees: SimpleQueue[Path] = SimpleQueue()
        for number in range(options.jobs):
            trees.put(_copy_tree(Path(folder) / str(number)))
        _require_green(Path(folder) / "0", options.seeds)
        for mutant, finding in zip(mutants, pool.map(partial(_try_free, trees, options.seeds), mutants), strict=True):
            print(describe_finding(mutant, finding, options.seeds), flush=True)
            unnoticed += finding.is_unnoticed
    print(f"\n{unnoticed} of {len(mutants)} unnoticed")
    sys.exit(1 if unnoticed else 0)


def _require_green(tree: Path, seeds: int) -> None:
    """End the program if tests or seeds fail without a change: they would notice everything."""
    failed_test = _find_test(tree, tuple(dict.fromkeys(test for tests in AREAS.values() for test in tests)))
    failed_seeds = [str(FIRST_SEED + n) for n in range(seeds) if _violates(tree, FIRST_SEED + n)]
    if failed_test or failed_seeds:
        sys.exit(f"these fail without a change: {' '.join([failed_test, *failed_seeds])}; mend them first")


def _try_free(trees: "SimpleQueue[Path]", seeds: int, mutant: Mutant) -> Finding:
    tree = trees.get()
    try:
        return try_mutant(mutant, tree, seeds)
    finally:
        trees.put(tree)


if __name__ == "__main__":
    main()
