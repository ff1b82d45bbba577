"""The contract of adapters, over every make and link: the guarantees of a driver, judged by the simulator's ground
truth. The checks are those that `tutti adapter check` runs."""

import pytest
from adapter_worlds import CASES
from live.fake_make import FakeDriver

from orchestrator.conformance.checks import ContractCheck
from orchestrator.conformance.findings import NotApplicable
from orchestrator.conformance.signatures import check_signatures, find_wrong_signatures
from orchestrator.conformance.suite import CONTRACT_CHECKS

# What not all of our makes offer. Everything else must be checked, not skipped.
MORE_OF_A_MAKE = (
    "cia402, four on one bus",
    "cia402, two on two buses",
    "smc30, seven on a bus with checksum",
    "smc2000 in a chain of three",
    "smc2000 in a chain of two",
    "shrc203 behind a TCP bridge",
    "galil dmc21x3",
)
"""Worlds of a make that has a smaller or a nearer one; run nightly."""
OPTIONAL = ("start sooner", "its line", "an active line")


@pytest.mark.parametrize(
    "check",
    [pytest.param(each, id=each.name, marks=[pytest.mark.nightly] if each.is_long else []) for each in CONTRACT_CHECKS],
)
@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=[pytest.mark.nightly] if each in MORE_OF_A_MAKE else []) for each in CASES]
)
def test_contract(name: str, check: ContractCheck) -> None:
    try:
        check.run(CASES[name])
    except NotApplicable as reason:
        assert any(each in check.title for each in OPTIONAL), reason
        pytest.skip(str(reason))


@pytest.mark.parametrize("name", CASES)
def test_methods_have_the_parameters_of_the_contract(name: str) -> None:
    check_signatures(CASES[name])


def test_the_make_of_the_live_tests_has_them_too() -> None:
    assert find_wrong_signatures(FakeDriver) == []


def test_a_parameter_that_is_missing_or_required_is_found() -> None:
    class Contract:
        async def go(self, start_tolerance_ns: int = 0, advance_ns: int = 0) -> None: ...

    class Older(FakeDriver):
        async def go(self, start_tolerance_ns: int) -> None:
            raise NotImplementedError

        async def stop(self) -> None:  # type: ignore[override]
            raise NotImplementedError

        async def jog_axis(self, axis: str) -> None:  # type: ignore[override]
            raise NotImplementedError

    assert find_wrong_signatures(Older) == ["stop has no parameter abort", "jog_axis has no parameter move"]
    assert find_wrong_signatures(Older, [Contract]) == [
        "go requires start_tolerance_ns, which callers may leave out",
        "go has no parameter advance_ns",
    ]


def test_each_title_says_what_holds() -> None:
    names = [each.name for each in CONTRACT_CHECKS]
    assert len(set(names)) == len(names)
