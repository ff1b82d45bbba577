"""The pytest plugin of Tutti: the fixtures `virtual_fleet` and `live_fleet`.

Each is called with a fleet file, or a `Fleet`, and returns a fleet that runs. At the end of the test it is checked,
and a violated invariant is a failure of the test; then it is ended. A test that fails has the event log in its report.
"""

import sys
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from orchestrator.testing.live import LiveTestbed
    from orchestrator.testing.open_fleets import OpenFleet
    from orchestrator.testing.virtual import VirtualTestbed

LOG_LINES = 200  # of the event log in a report, the last ones

_FLEETS = pytest.StashKey["list[VirtualTestbed | LiveTestbed]"]()


def _fleets_of(item: pytest.Item) -> "list[VirtualTestbed | LiveTestbed]":
    """The fleets that the fixtures have started for a test."""
    return item.stash.setdefault(_FLEETS, [])


def _make_fleets(item: pytest.Item, make: Callable[..., Any]) -> Generator[Callable[..., Any]]:
    """A function that starts fleets, which end with the test."""
    own_fleets = _fleets_of(item)

    def start_fleet(*arguments: Any, **options: Any) -> Any:
        fleet = make(*arguments, **options)
        own_fleets.append(fleet)
        return fleet.__enter__()

    yield start_fleet
    for fleet in own_fleets:
        fleet.close()


@pytest.fixture
def virtual_fleet(request: pytest.FixtureRequest) -> "Generator[Callable[..., VirtualTestbed]]":
    """Start fleets in virtual time: `fleet = virtual_fleet("lab.fleet.yaml", seed=1)`; see `tutti.testing`."""
    from tutti import testing

    yield from _make_fleets(request.node, testing.virtual_fleet)


@pytest.fixture
def live_fleet(request: pytest.FixtureRequest) -> "Generator[Callable[..., LiveTestbed]]":
    """Start fleets of processes on this computer: `fleet = live_fleet("lab.fleet.yaml")`; see `tutti.testing`."""
    from tutti import testing

    yield from _make_fleets(request.node, testing.live_fleet)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    """Check the fleets of a test when it has passed; end those that it has left running, and say so."""
    fleets_before = _list_running()
    try:
        result = yield
        for fleet in _fleets_of(item):
            fleet.check_and_close()
    except BaseException:
        _add_logs(item)
        raise
    finally:
        new_fleets = [
            fleet for fleet in _list_running() if fleet not in fleets_before and fleet not in _fleets_of(item)
        ]
        for fleet in new_fleets:
            fleet.close()
    if new_fleets:
        pytest.fail(
            f"the test has left {', '.join(map(repr, new_fleets))} running, which is ended now; "
            "use it as a context (`with …`), or the fixture",
            pytrace=False,
        )
    return result


def _list_running() -> "list[OpenFleet]":
    """The fleets of this process, without importing anything in a run that has none."""
    module = sys.modules.get("orchestrator.testing.open_fleets")
    return [] if module is None else module.list_running()


def _add_logs(item: pytest.Item) -> None:
    """Add the event logs of the fleets to the report of the test."""
    for fleet in _fleets_of(item):
        lines = fleet.log
        head = f"{fleet!r}" + (f", the last {LOG_LINES} of {len(lines)} lines" if len(lines) > LOG_LINES else "")
        item.add_report_section("call", "tutti", "\n".join([head, *lines[-LOG_LINES:]]))
