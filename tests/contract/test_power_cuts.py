"""Short power cuts while a motion is commanded. Every make and link, at many moments of each kind of motion."""

import pytest
from adapter_worlds import CASES

from orchestrator.conformance.power_cuts import COMMANDED, CUT_MOMENTS_NS, check_power_cuts

MORE = ("smc2000 in a chain of three", "cia402, four on one bus")  # of a make with a chain, a bus, of fewer units


@pytest.mark.parametrize(
    "moments_ns",
    [
        CUT_MOMENTS_NS[::6],
        *(pytest.param(CUT_MOMENTS_NS[first::6], marks=pytest.mark.nightly) for first in range(1, 6)),
    ],
    ids=["", *(f"more, {first} of 5" for first in range(1, 6))],
)
@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=[pytest.mark.nightly] if each in MORE else []) for each in CASES]
)
@pytest.mark.parametrize("act", COMMANDED)
def test_a_short_power_cut_while_a_motion_is_commanded(name: str, act: str, moments_ns: list[int]) -> None:
    check_power_cuts(CASES[name], COMMANDED[act], moments_ns)
