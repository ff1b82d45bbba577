"""Folders by idea: none of one module, no module beside a folder of nearly the same name, no module of a few lines."""

from pathlib import Path

ROOT = Path(__file__).parents[3]
PACKAGES = ("orchestrator", "adapters", "sim", "tutti", "integrations", "benches")

# Folders of one module, and why each is one.
ONE_MODULE = {
    "adapters/compat": "it goes with the release that no longer loads contract version 1",
    "adapters/yaskawa/smc4000": "a make and model has a folder, by contract",
    "tutti/testing": "the entry point of a pytest plug-in: `-p tutti.testing.plugin`",
}
# Modules of under 15 lines, and why each is one.
SHORT = {
    "benches/__main__.py": "what `python -m benches` runs, and nothing else",
    "orchestrator/campaign/injection/repairs.py": "what faults and stages share, without importing each other",
    "orchestrator/cli/base/codes.py": "exit codes, which the quick commands import without anything else",
    "orchestrator/cli/entry.py": "what the command runs: it imports nothing before it can be interrupted",
    "orchestrator/coordinator/steps/dwell.py": "a kind of step is one module",
    "orchestrator/model/steps/numbers.py": "how steps are counted, which commands import without anything else",
    "orchestrator/monitor/open_bus.py": "a text of several parts that import nothing of each other",
    "orchestrator/plan/forecast/dwell.py": "a kind of step is one module",
    "orchestrator/plan/path/errors.py": "an error of all modules of paths",
    "sim/yaskawa/machine/model.py": "a record of both simulated models",
    "sim/yaskawa/motion/codes.py": "codes of the manual that motion and commands share",
    "tutti/adapter/checks.py": "a public name for plug-ins",
}
LEAST_LINES = 15


def list_folders() -> list[Path]:
    """All packages but those of tests and tools."""
    return [path.parent for package in PACKAGES for path in sorted((ROOT / package).rglob("__init__.py"))]


def list_modules(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.glob("*.py")) if path.name != "__init__.py"]


def test_a_folder_has_more_than_one_module() -> None:
    single = {
        str(folder.relative_to(ROOT))
        for folder in list_folders()
        if len(list_modules(folder)) == 1 and not list(folder.glob("*/__init__.py"))
    }
    assert single == ONE_MODULE.keys()


def test_no_module_stands_beside_a_folder_of_nearly_the_same_name() -> None:
    twins = [
        str(path.relative_to(ROOT))
        for folder in list_folders()
        for path in list_modules(folder)
        for name in (path.stem, f"{path.stem}s", path.stem.removesuffix("s"))
        if (folder / name / "__init__.py").exists()
    ]
    assert not twins


def test_a_module_of_a_few_lines_has_a_reason() -> None:
    short = {
        str(path.relative_to(ROOT))
        for folder in list_folders()
        for path in list_modules(folder)
        if len(path.read_text(encoding="utf-8").splitlines()) < LEAST_LINES
    }
    assert short == SHORT.keys()
