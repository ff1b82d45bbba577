"""Local time of a place with summer time, for fixtures."""

import time
from collections.abc import Iterator

import pytest


def use_berlin_time(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Central European time, until the fixture ends."""
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()
