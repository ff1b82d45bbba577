"""Fixtures of live tests."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from children import Children
from fleet import RunningFleet


@pytest.fixture
def children(tmp_path: Path) -> Iterator[Children]:
    started = Children(tmp_path)
    yield started
    started.close()


@pytest.fixture(scope="session")
def demo_fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningFleet]:
    """The demo fleet with all that it may have, started once in each test process."""
    fleet = RunningFleet(tmp_path_factory.mktemp("shared"), recorded=True, web=True)
    try:
        yield fleet.started()
    finally:
        fleet.close()


@pytest.fixture
def shared(demo_fleet: RunningFleet) -> RunningFleet:
    """The demo fleet for all tests that leave it working. Its queue is started: the test before may have stopped it."""
    demo_fleet.ask(lambda tutti: tutti.start_queue())
    return demo_fleet
