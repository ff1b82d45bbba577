"""Short power cuts while a motion is commanded. Every make and link, at many moments of each kind of motion."""

import pytest
from adapter_worlds import CASES

from orchestrator.conformance.power_cuts import COMMANDED, CUT_MOMENTS_NS, check_power_cuts


@pytest.mark.parametrize(
    "moments_ns",
    [
        CUT_MOMENTS_NS[::4],
        *(pytest.param(CUT_MOMENTS_NS[first::4], marks=pytest.mark.nightly) for first in (1, 2, 3)),
    ],
    ids=["", "more", "still more", "all others"],
)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("act", COMMANDED)
def test_a_short_power_cut_while_a_motion_is_commanded(name: str, act: str, moments_ns: list[int]) -> None:
    check_power_cuts(CASES[name], COMMANDED[act], moments_ns)
