"""What holds for all tests."""

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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.nodeid.removeprefix("tests/").startswith(PYTHON):
            item.add_marker(pytest.mark.python)
