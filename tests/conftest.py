"""What holds for all tests."""

from pathlib import Path

import pytest
from processes import give_children_default_signals

give_children_default_signals()

PYTHON = (
    "unit/bus",
    "unit/clock",
    "unit/client",
    "unit/coordinator",
    "unit/journal",
    "unit/link",
    "unit/model",
    "unit/runtime",
    "contract/test_bus",
    "contract/test_vectors.py",
    "cluster/test_campaign.py::test_no_directed_seed_violates_an_invariant[0]",
    "cluster/test_determinism.py",
    "cluster/test_jobs.py",
    "cluster/test_queue.py",
    "unit/project/test_imports.py",
)
"""Tests that another version of Python could change, by the begin of their names below this folder."""


LISTS = {"slow": "slow.txt", "nightly": "nightly.txt"}
"""Markers of tests that `make test` leaves out, and the file beside this one that names them, a line each: the name below
this folder."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    names = {item.nodeid.removeprefix("tests/"): item for item in items}
    for name, item in names.items():
        if name.startswith(PYTHON):
            item.add_marker(pytest.mark.python)
    for marker, file_name in LISTS.items():
        listed = _read_names(Path(__file__).with_name(file_name))
        for name in listed & names.keys():
            names[name].add_marker(marker)
        if any("::" in argument for argument in config.args):
            continue  # not all tests of a file are here
        files = {name.partition("::")[0] for name in names}
        lost_names = sorted(name for name in listed - names.keys() if name.partition("::")[0] in files)
        if lost_names:
            raise pytest.UsageError(f"tests/{file_name} names what is no test: {', '.join(lost_names)}")


def _read_names(path: Path) -> set[str]:
    return {line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")}
