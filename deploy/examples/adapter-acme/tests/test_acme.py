"""The make acme against the contract of Tutti."""

import pytest

from tutti.adapter.checks import MakeCheck, NotApplicable, list_checks


@pytest.mark.parametrize("check", list_checks("acme"), ids=lambda check: check.name)
def test_the_contract(check: MakeCheck) -> None:
    try:
        check.run()
    except NotApplicable as reason:
        pytest.skip(str(reason))
