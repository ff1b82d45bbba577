"""Pauses between attempts to reach a controller, by how long it is away."""

import pytest

from adapters.controller.attempt_pauses import FIRST_NS, LONGEST_NS, AttemptPauses
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual


def list_pauses(away_s: float, *, is_defect: bool = False) -> list[int]:
    """The pauses between attempts that fail at once, after a connection that lasted ten minutes."""

    async def main(clock: VirtualClock) -> list[int]:
        pauses = AttemptPauses(clock)
        await sleep_ns(clock, 600 * NS_PER_S)
        pauses.note_lost()
        until_ns, taken = clock.now_ns() + round(away_s * NS_PER_S), list[int]()
        while clock.now_ns() < until_ns:
            taken.append(pauses.pause_ns)
            await sleep_ns(clock, max(pauses.pause_ns, FIRST_NS))
            pauses.prolong_pause(is_defect=is_defect)
        return taken

    return run_virtual(main)


@pytest.mark.parametrize(("away_s", "longest_s"), [(3, 0.4), (16, 2.0), (600, 5.0)])
def test_a_pause_is_a_small_part_of_the_outage(away_s: float, longest_s: float) -> None:
    pauses = list_pauses(away_s)
    assert pauses[0] == 0 and sorted(pauses) == pauses
    assert FIRST_NS <= pauses[-1] <= longest_s * NS_PER_S
    assert away_s < 600 or pauses[-1] == LONGEST_NS


def test_a_defect_of_the_adapter_is_tried_more_seldom() -> None:
    assert list_pauses(3, is_defect=True) == [0, FIRST_NS, 2 * FIRST_NS, 4 * FIRST_NS, 8 * FIRST_NS]
