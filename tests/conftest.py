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


NIGHTLY = Path(__file__).with_name("nightly.txt")
"""Tests that run nightly only, a line each: the name below this folder."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    nightly = {line for line in NIGHTLY.read_text(encoding="utf-8").splitlines() if not line.startswith("#")}
    names = {item.nodeid.removeprefix("tests/"): item for item in items}
    for name, item in names.items():
        if name.startswith(PYTHON):
            item.add_marker(pytest.mark.python)
        if name in nightly:
            item.add_marker(pytest.mark.nightly)
    if any("::" in argument for argument in config.args):
        return  # not all tests of a file are here
    files = {name.partition("::")[0] for name in names}
    lost_names = sorted(name for name in nightly - names.keys() if name.partition("::")[0] in files)
    if lost_names:
        raise pytest.UsageError(f"tests/nightly.txt names what is no test: {', '.join(lost_names)}")
