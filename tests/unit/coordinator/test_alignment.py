"""The start at which ticks fall closest together: against trying every instant."""

from random import Random

import pytest

from orchestrator.coordinator.motion.alignment import CLOSE_ENOUGH, TickGrid, find_closest_ticks

TICK_NS = 976_562.5


def spread_about(grids: list[TickGrid], instant_ns: int) -> float:
    """How far the ticks next to an instant are apart."""
    off = [(grid.at_ns - instant_ns + grid.tick_ns / 2) % grid.tick_ns - grid.tick_ns / 2 for grid in grids]
    return max(off) - min(off)


def some_grids(draw: Random, count: int, ppm: float = 50.0) -> list[TickGrid]:
    return [TickGrid(draw.randrange(10**12), TICK_NS * (1 + draw.uniform(-ppm, ppm) * 1e-6)) for _ in range(count)]


@pytest.mark.parametrize("count", [1, 2, 3, 8, 64])
def test_the_instant_is_as_good_as_any_within_a_tick(count: int) -> None:
    draw = Random(count)
    for _ in range(20):
        grids, from_ns = some_grids(draw, count), draw.randrange(10**13)
        found_ns, spread_ns = find_closest_ticks(grids, from_ns, 0)
        assert from_ns <= found_ns <= from_ns + 2.5 * TICK_NS
        assert spread_about(grids, found_ns) == pytest.approx(spread_ns, abs=200)
        tried = min(spread_about(grids, from_ns + round(k * TICK_NS / 500)) for k in range(500))
        assert spread_ns <= tried + 300


def test_the_phases_of_two_crystals_align_within_the_predicted_time() -> None:
    slow, fast = TickGrid(0, TICK_NS), TickGrid(300_000, TICK_NS * (1 - 50e-6))
    at_once, apart_ns = find_closest_ticks([slow, fast], 10**10, 0)
    later, meet_ns = find_closest_ticks([slow, fast], 10**10, 25 * 10**9)
    assert at_once < later <= 10**10 + 25 * 10**9 + 2 * TICK_NS
    assert meet_ns <= CLOSE_ENOUGH * TICK_NS < apart_ns
    assert spread_about([slow, fast], later) < meet_ns + 200
    # They coincide again after a tick's worth of drift, and no step waits for that.
    much_later, again_ns = find_closest_ticks([slow, fast], 10**10, 300 * 10**9)
    assert (much_later, again_ns) == (later, meet_ns)


def test_without_ticks_the_first_instant_is_taken() -> None:
    assert find_closest_ticks([], 5, 10**9) == (5, 0)
