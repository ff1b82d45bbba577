"""Tests with clients of other projects that drive the demo fleet by our integrations: `make test-ecosystem`, in an
environment of its own.

Elsewhere they are not collected. There a skipped test is a failed one, unless the program that it needs is a package of
the system (a message broker, a store of queues).
"""

import os
from collections.abc import Generator, Iterator

import pytest

from tutti.testing import LiveTestbed, find_example, live_fleet

HAS_CLIENTS = "TUTTI_ECOSYSTEM" in os.environ
SYSTEM_PACKAGE = "the system's package"  # begins the reason of a skip that is none of ours
collect_ignore_glob = [] if HAS_CLIENTS else ["test_*.py"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "ecosystem" in item.path.parts:
            item.add_marker(pytest.mark.ecosystem)
            item.add_marker(pytest.mark.filterwarnings("default"))  # libraries warn of each other


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.skipped and SYSTEM_PACKAGE not in str(report.longrepr):
        report.outcome = "failed"
        report.longrepr = f"skipped, which counts as failed here: {report.longrepr}"
    return report


@pytest.fixture(scope="session")
def demo_fleet() -> Iterator[LiveTestbed]:
    """The demo fleet as processes, homed; all tests share it, one after the other."""
    with live_fleet(find_example("demo.fleet.yaml"), check=False) as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        yield fleet


@pytest.fixture(autouse=True)
def ready_fleet(request: pytest.FixtureRequest) -> None:
    """The queue is started, and all axes are referenced, whatever a test before has stopped."""
    if "demo_fleet" not in request.fixturenames:
        return
    tutti = request.getfixturevalue("demo_fleet").tutti
    tutti.start_queue()
    lost_axes = [name for name, axis in tutti.axes().items() if not axis.referenced]
    if lost_axes:
        tutti.enable(wait=True)
        tutti.home(*lost_axes)
