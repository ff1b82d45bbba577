"""The import contracts refuse what they are there for: an import is planted in each part, and has to be seen."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
PACKAGES = ("tutti", "orchestrator", "adapters", "sim", "integrations", "benches")

# Where a library may be imported; everywhere else it is refused.
ALLOWED = {
    "zenoh": "orchestrator/bus/zenoh",
    "ruckig": "orchestrator/plan/shape.py",
    "sqlite3": "orchestrator/coordinator/journal/sqlite",
    "psycopg": "orchestrator/coordinator/journal/postgres",
    "cryptography": "orchestrator/keys",
    "serial": "adapters/link",
    "can": "adapters/link",
}


def list_parts() -> list[Path]:
    """The folders that are parts of their own, relative to the root."""
    parts = [Path(package) for package in PACKAGES]
    parts += [path.parent.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).glob("*/__init__.py")]
    return sorted(parts)


def test_an_import_that_is_planted_in_any_part_is_refused(tmp_path: Path) -> None:
    for package in PACKAGES:
        ignored = shutil.ignore_patterns("__pycache__", "node_modules", "static")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    planted: set[tuple[str, str]] = set()
    for part in list_parts():
        libraries = [library for library, place in ALLOWED.items() if part != Path(place)]
        module = tmp_path / part / "planted_imports.py"
        module.write_text("".join(f"import {library}\n" for library in libraries), encoding="utf-8")
        planted |= {(".".join((*part.parts, "planted_imports")), library) for library in libraries}
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache", "--verbose"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 1, done.stdout + done.stderr
    refused = set(re.findall(r"(\S+\.planted_imports) -> (\w+)", done.stdout))
    assert refused == planted
