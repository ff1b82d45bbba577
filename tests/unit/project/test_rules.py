"""Rules of the project that no linter checks."""

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner

from orchestrator.cli.main import main

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))
import figures  # noqa: E402

PACKAGES = ("orchestrator", "adapters", "sim", "integrations", "benches")

# What runs in virtual time reads no clock, starts no thread, and draws nothing without a seed. Exempt are the live
# ends, each for the reason that stands in its docstring, and benchmarks that measure real time.
LIVE = re.compile(
    r"(process|live|guardian|workers|executor|parent|input_thread)\.py$|/link/|^orchestrator/(cli|bus/zenoh)/"
    r"|^orchestrator/bench/|^orchestrator/coordinator/journal/postgres/|^integrations/"
    r"|^benches/(page/|speed/|paths/planning)|^orchestrator/client/(connection|worker)"
)
BANNED_CALLS = {"monotonic", "perf_counter", "run_in_executor", "to_thread"}
BANNED = {"time", "threading", "concurrent.futures", "uuid", "multiprocessing", "secrets"}
# A text without any of these needs no parsing: one module in twenty has one.
PERHAPS_BANNED = re.compile(
    rf"\b(?:import|from)\b.*\b(?:{'|'.join(map(re.escape, sorted(BANNED)))})\b"
    rf"|\brandom\s*\.|\b(?:{'|'.join(sorted(BANNED_CALLS))})\b"
)


def modules() -> list[Path]:
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


@cache
def outline_file(path: Path) -> ast.Module:
    """The imports and classes of a module, wherever they stand in it, without their bodies. The whole trees of a thousand
    modules would be gone through by the garbage collector again and again."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom | ast.ClassDef)]
    for node in nodes:
        if isinstance(node, ast.ClassDef):
            node.body = []
    return ast.Module(list[ast.stmt](nodes), [])


@pytest.fixture
def outlines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each module is parsed once for all figures of imports and classes, which take in the benches."""
    monkeypatch.setattr(figures, "parse_file", outline_file)
    monkeypatch.setattr(figures, "PACKAGES", PACKAGES)


def find_other_sources(path: Path) -> Iterator[str]:
    """What a module uses of real time, threads, and random numbers without a seed."""
    text = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)) if PERHAPS_BANNED.search(text) else ():
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        if BANNED & set(names):
            yield f"{path} imports {names}"
        if not isinstance(node, ast.Attribute):
            continue
        if isinstance(node.value, ast.Name) and node.value.id == "random" and node.attr != "Random":
            yield f"{path}:{node.lineno} draws from the unseeded generator"
        if node.attr in BANNED_CALLS:
            yield f"{path}:{node.lineno} uses {node.attr}"


def test_virtual_code_has_no_other_time_and_no_other_random_source() -> None:
    checked = [path for path in modules() if not LIVE.search(str(path.relative_to(ROOT)))]
    found = [line for path in checked for line in find_other_sources(path)]
    assert len(checked) > 300 and not found, "\n".join(found)


@pytest.mark.structure
@pytest.mark.usefixtures("outlines")
def test_imports_have_no_circles() -> None:
    """None across packages, and none of more than two files inside one."""
    graph = figures.import_graph()
    assert figures.find_circles(figures.folder_graph(graph)) == []
    assert [circle for circle in figures.find_circles(graph) if len(circle) > 2] == []


@pytest.mark.structure
@pytest.mark.usefixtures("outlines")
def test_all_errors_are_in_one_tree() -> None:
    assert figures.exceptions_outside_tree() == []


@pytest.mark.usefixtures("outlines")
def test_folders_stay_readable() -> None:
    assert figures.files_per_folder() and max(figures.files_per_folder().values()) <= 30


# Words of an old dialect, in which processes were people. Each is followed by what to write instead.
OLD_WORDS = {
    r"who|whom|whoever": "the process, the controller, the client",
    r"nobody|somebody|everybody|anybody": "no client, another holder, all processes",
    r"hears?|heard": "receives",
    r"owes?|owed": "pending",
    r"(is|are|was|were) told": "receives a command, is notified",
    r"reigns?|reigned|reigning|throne|deposed": "leads, leadership, leadership lost",
    r"can not": "cannot",
    r"bring it about": "satisfy it",
    r"in hand": "under manual control",
    r"meets?|met anew": "connects, reconnects",
}
ANY_OLD_WORD = re.compile(rf"\b(?:{'|'.join(OLD_WORDS)})\b")


def test_product_code_is_in_the_words_of_the_field() -> None:
    found: list[str] = []
    for path in modules():
        text = path.read_text(encoding="utf-8")
        if path.name == "schema.py" and path.parent.name == "sqlite":
            continue  # it converts the old codes of existing journals
        if not ANY_OLD_WORD.search(text.lower()):
            continue
        for words, instead in OLD_WORDS.items():
            for match in re.finditer(rf"(?<![\w`{{.(])({words})(?![\w}}])", text, re.IGNORECASE):
                number = text.count("\n", 0, match.start()) + 1
                found.append(f"{path.relative_to(ROOT)}:{number}: {match.group(0)!r}: write {instead}")
    assert not found, "\n".join(found)


def test_locks_name_no_download_address() -> None:
    for lock in ROOT.glob("requirements*.lock"):
        assert "://" not in lock.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("orchestrator.cli.main", ["zenoh", "numpy", "ruckig", "pydantic", "rich", "asyncio"]),
        # What an e-stop from a shell waits for.
        (
            "orchestrator.cli.main, orchestrator.cli.view.fleet, orchestrator.bus.estop, orchestrator.bus.zenoh.bus",
            ["numpy", "ruckig", "pydantic", "yaml"],
        ),
    ],
)
def test_quick_commands_import_nothing_heavy(modules: str, heavy: list[str]) -> None:
    code = f"import sys, {modules}; print(sorted(m for m in sys.modules if '.' not in m))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60).stdout
    assert [name for name in heavy if f"'{name}'" in loaded] == []


def test_every_command_has_help_with_an_example() -> None:
    runner = CliRunner()

    def walk(words: list[str]) -> None:
        shown = runner.invoke(main, [*words, "--help"])
        assert shown.exit_code == 0, shown.output
        assert "Example" in shown.output, words
        command = main
        for word in words:
            command = command.get_command(None, word)  # type: ignore[attr-defined, arg-type]
        for name in getattr(command, "commands", {}) or (command.list_commands(None) if not words else []):  # type: ignore[arg-type]
            walk([*words, name])

    walk([])


@pytest.mark.parametrize("kind", ["fleet", "job"])
def test_schemas_are_json_schemas(kind: str) -> None:
    shown = CliRunner().invoke(main, ["schema", kind])
    schema = json.loads(shown.output)
    assert schema["type"] == "object"
    assert "schema" in schema["properties"]


def test_live_tests_are_where_they_are_collected() -> None:
    marked = {path.parent.name for path in (ROOT / "tests").rglob("test_*.py") if "mark.live" in path.read_text()}
    assert marked - {"project"} == {"live", "contract"}
    (command,) = (line for line in (ROOT / "Makefile").read_text().splitlines() if '-m "live and not nightly' in line)
    assert command.endswith(" tests/live tests/contract")
