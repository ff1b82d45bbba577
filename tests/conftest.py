"""What holds for all tests."""

import pytest
from processes import give_children_default_signals

# Live tests are handed out by file; these take 10 s and more. They begin first, so that no process is left with one.
LONG_FILES = (
    "test_fleet.py",
    "test_guardian.py",
    "test_hosts.py",
    "test_standby.py",
    "test_testbed.py",
    "test_up_and_down.py",
    "test_gateway.py",
    "test_bus.py",
    "test_recorder.py",
)

give_children_default_signals()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    places = {name: place for place, name in enumerate(LONG_FILES)}
    items.sort(key=lambda item: places.get(item.path.name, len(places)))
