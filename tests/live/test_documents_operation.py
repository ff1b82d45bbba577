"""The how-to pages about positions, the queue, records, alarms, users and clients."""

import pytest
from documents import LIMITED, OPERATION, fleet, run_page
from fleet import RunningFleet

__all__ = ["fleet"]  # a simulated fleet of this module

pytestmark = [pytest.mark.live, pytest.mark.nightly]


@LIMITED
@pytest.mark.parametrize("page", OPERATION)
def test_the_commands_of_a_page_work(fleet: RunningFleet, page: str) -> None:
    run_page(fleet, page)
