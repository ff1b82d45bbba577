"""The tutorials, and the how-to pages about fleets, jobs and motion."""

import pytest
from documents import LIMITED, MOTION, OPERATION, ROOT, fleet, run_page
from fleet import RunningFleet
from pages import ECOSYSTEM_PAGES, OWN_PAGES, commands, programs

__all__ = ["fleet"]  # a simulated fleet of this module

pytestmark = [pytest.mark.live, pytest.mark.nightly]


def test_every_page_with_commands_is_run() -> None:
    pages = [*(ROOT / "docs" / "tutorial").glob("*.md"), *(ROOT / "docs" / "how-to").glob("*.md")]
    with_commands = {str(page.relative_to(ROOT / "docs")) for page in pages if commands(page) or programs(page)}
    assert with_commands == {*MOTION, *OPERATION, *ECOSYSTEM_PAGES, *OWN_PAGES}


@LIMITED
@pytest.mark.parametrize("page", MOTION)
def test_the_commands_of_a_page_work(fleet: RunningFleet, page: str) -> None:
    run_page(fleet, page)
