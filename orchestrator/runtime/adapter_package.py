"""A new package for a make, written from the example make `acme`."""

import keyword
import re
import sys
from pathlib import Path

from adapters.host.makes import known_makes
from orchestrator.model.errors import TuttiError
from orchestrator.model.plugins import plugin_names
from orchestrator.runtime.examples import find_example

_FOLDER = "adapter-acme"
_SUFFIXES = {".py", ".toml", ".md", ".jsonl"}
_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


class BadPackage(TuttiError, ValueError):
    """A package that cannot be written. remedy: what to do."""

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(text)
        self.remedy = remedy


def require_free_name(name: str) -> None:
    """Raise `BadPackage` for a name that no new make can have."""
    if _NAME.fullmatch(name) is None or keyword.iskeyword(name):
        raise BadPackage(
            f"{name[:80]!r} cannot be the name of a make",
            "1 to 40 lower-case letters, digits and _, beginning with a letter, e.g. `mc2000`",
        )
    if name in {*known_makes(), *plugin_names("tutti.simulators")}:
        raise BadPackage(f"the make {name} exists already", "choose another name; `tutti adapter ls` lists all")
    if name in sys.stdlib_module_names:
        raise BadPackage(f"{name} is a module of Python itself", "choose another name")


def write_package(name: str, folder: Path) -> list[Path]:
    """Write the package of the make `name` into the new `folder`; return its files.

    Raises `BadPackage`, `ExamplesMissing`.
    """
    require_free_name(name)
    source = find_example(_FOLDER)
    written_paths: list[Path] = []
    try:
        folder.mkdir(parents=True)
        for file in sorted(source.rglob("*")):
            if file.suffix not in _SUFFIXES or _is_build_product(file.relative_to(source)):
                continue
            goal = folder / _rename(str(file.relative_to(source)), name)
            goal.parent.mkdir(parents=True, exist_ok=True)
            goal.write_text(_rename(file.read_text(encoding="utf-8"), name), encoding="utf-8")
            written_paths.append(goal)
    except FileExistsError:
        raise BadPackage(f"{folder} exists already", "give another folder with --into") from None
    except OSError as error:
        raise BadPackage(f"{folder} cannot be written: {error.strerror}", "give another folder with --into") from None
    return written_paths


def _is_build_product(file: Path) -> bool:
    return any(part == "build" or part.endswith(".egg-info") or part.startswith((".", "__py")) for part in file.parts)


def _rename(text: str, name: str) -> str:
    """Replace the example's name: `acme` in modules, `Acme` in classes, `ACME` in constants and in the made-up
    language."""
    capitals = "".join(part.capitalize() for part in name.split("_"))
    return text.replace("acme", name).replace("Acme", capitals).replace("ACME", name.upper())
