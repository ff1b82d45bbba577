"""The order of tests."""

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Live tests first: they wait most of their time, and other workers have enough to compute meanwhile."""
    items.sort(key=lambda item: item.get_closest_marker("live") is None)
