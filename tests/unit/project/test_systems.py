"""What only some operating systems have is imported and asked for in few places, so that the rest runs on each."""

import ast
from pathlib import Path

from unit.project.test_rules import modules

ROOT = Path(__file__).parents[3]
LISTS = ROOT / "tests" / "without_unix"

# Modules that Windows, or all others, lack, and where they are imported.
IMPORTED = {
    "orchestrator/cli/base/terminal.py": {"termios", "tty"},
    "orchestrator/cli/base/windows_console.py": {"msvcrt"},
    "orchestrator/clock/process_limits.py": {"resource"},
    "orchestrator/model/files/locks.py": {"fcntl", "msvcrt"},
    "orchestrator/runtime/live/terminal_process.py": {"fcntl", "termios"},  # pseudo-terminals of benchmarks and tests
    "sim/link/pty.py": {"tty"},  # pseudo-terminals of simulated serial lines
}
SIGNALS = "orchestrator/clock/signals.py"


def list_modules() -> set[str]:
    lines = (LISTS / "windows_lacks.txt").read_text(encoding="utf-8").splitlines()
    return {"msvcrt", "winreg", *(line for line in lines if line.isidentifier())}


def find_imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(str(node.module))
    return names


def test_modules_that_not_every_system_has_are_imported_in_few_places() -> None:
    wanted = list_modules()
    perhaps = [path for path in modules() if any(name in path.read_text(encoding="utf-8") for name in wanted)]
    imported = {str(path.relative_to(ROOT)): find_imports(path) & wanted for path in perhaps}
    assert {path: names for path, names in imported.items() if names} == IMPORTED


def test_signals_are_taken_in_one_place() -> None:
    text = {
        str(path.relative_to(ROOT)) for path in modules() if ".add_signal_handler(" in path.read_text(encoding="utf-8")
    }
    assert text == {SIGNALS}
