"""Tests with third-party clients: `make test-thirdparty`, in an environment of its own.

Elsewhere they are not collected. There a skipped test is a failed one: the client is installed, or nothing is
tested.
"""

import os
import sys
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

LIVE = Path(__file__).parents[1] / "live"
sys.path.insert(0, str(LIVE))

from children import Children  # noqa: E402

collect_ignore_glob = [] if "TUTTI_THIRDPARTY" in os.environ else ["test_*.py"]


@pytest.fixture
def children(tmp_path: Path) -> Iterator[Children]:
    started = Children(tmp_path)
    yield started
    started.close()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.skipped:
        report.outcome = "failed"
        report.longrepr = f"skipped, which counts as failed here: {report.longrepr}"
    return report
