"""Write `docs/reference/licences.md`: the licences of what Tutti needs to run, and of what is built into its page.

The former are in the metadata of what is installed, the latter in the page's lock. `--check` fails if the page of
licences is not current.
"""

import json
import re
import sys
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference" / "licences.md"
LOCK = ROOT / "requirements/run.lock"
PAGE_LOCK = ROOT / "orchestrator" / "gateway" / "page" / "package-lock.json"
HEAD = """# Licences of dependencies

Written by `tools/licences.py` from `requirements/run.lock` and the metadata of the installed packages. Each package is
used as it is published, unchanged; the sources of Tutti contain no code of theirs.

"""
TABLE = "| package | version | licence, as the package states it |\n|---|---|---|\n"
PAGE_HEAD = """
## In the operators' page

The page that `make page` builds, and that is in the wheel, contains:

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


def list_page_packages() -> list[str]:
    """Rows of the packages that are built into the operators' page."""
    packages = json.loads(PAGE_LOCK.read_text(encoding="utf-8"))["packages"]
    return [
        f"| {place.removeprefix('node_modules/')} | {each['version']} | {each.get('license', 'not stated')} |"
        for place, each in packages.items()
        if place and not each.get("dev") and not each.get("optional") and not each.get("peer")
    ]


def make_page() -> str:
    """The text of the page. Raises `PackageNotFoundError` for a package that is not installed."""
    rows = [f"| {name} | {', '.join(each)} | {find_licence(name)} |" for name, each in locked_versions().items()]
    text = HEAD + TABLE + "\n".join(rows) + "\n"
    return text + PAGE_HEAD + TABLE + "\n".join(list_page_packages()) + "\n"


if __name__ == "__main__":
    page = make_page()
    if "--check" not in sys.argv:
        PAGE.write_text(page, encoding="utf-8")
    elif PAGE.read_text(encoding="utf-8") != page:
        raise SystemExit(f"{PAGE.relative_to(ROOT)} is not current; run tools/licences.py")
