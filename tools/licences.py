"""Write `docs/reference/licences.md`: the licences of what Tutti needs to run, from the metadata of what is installed.

`--check` fails if the page is not current.
"""

import re
import sys
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference" / "licences.md"
LOCK = ROOT / "requirements.lock"
HEAD = """# Licences of dependencies

Written by `tools/licences.py` from `requirements.lock` and the metadata of the installed packages. Each package is
used as it is published, unchanged; Tutti contains no code of theirs.

| package | version | licence, as the package states it |
|---|---|---|
"""


def locked_versions() -> dict[str, list[str]]:
    """The locked versions of each package; several where they depend on the version of Python."""
    found: dict[str, list[str]] = {}
    for name, version in re.findall(r"^([\w.-]+)==([^\s;\\]+)", LOCK.read_text(encoding="utf-8"), re.MULTILINE):
        found.setdefault(name, []).append(version)
    return found


def find_licence(name: str) -> str:
    """The licence of an installed package: its expression, else its classifiers, else the first line of its text."""
    about = metadata.metadata(name)
    if about["License-Expression"]:
        return about["License-Expression"]
    classified = [each.rpartition(" :: ")[2] for each in about.get_all("Classifier") or [] if "License ::" in each]
    return ", ".join(classified) or (about["License"] or "not stated").strip().splitlines()[0]


def make_page() -> str:
    """The text of the page. Raises `PackageNotFoundError` for a package that is not installed."""
    rows = [f"| {name} | {', '.join(each)} | {find_licence(name)} |" for name, each in locked_versions().items()]
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    page = make_page()
    if "--check" not in sys.argv:
        PAGE.write_text(page, encoding="utf-8")
    elif PAGE.read_text(encoding="utf-8") != page:
        raise SystemExit(f"{PAGE.relative_to(ROOT)} is not current; run tools/licences.py")
