"""A crystal's time against true time, both ways."""

from random import Random

from sim.core.oscillator import Oscillator

SECOND_NS = 1_000_000_000


def test_the_true_instant_is_the_first_that_shows_the_device_time_at_the_edges_of_a_second_too() -> None:
    draw = Random(4)
    for seed in range(100):
        drift_ppm, wander_ppm = draw.uniform(-200, 200), draw.choice((0.05, 5.0, 200.0))
        crystal = Oscillator(draw.randrange(600 * SECOND_NS), drift_ppm, wander_ppm, seed)
        for _ in range(30):
            near_ns = draw.choice((draw.randrange(30 * SECOND_NS), draw.randrange(1, 30) * SECOND_NS))
            wanted_ns = crystal.device_ns(near_ns) + draw.randrange(-2, 3)
            found_ns = crystal.true_ns(wanted_ns)
            assert crystal.device_ns(found_ns) >= wanted_ns
            assert not found_ns or crystal.device_ns(found_ns - 1) < wanted_ns


def test_the_last_query_does_not_affect_another_instant() -> None:
    crystal, fresh = Oscillator(5, 50.0, 1.0, 3), Oscillator(5, 50.0, 1.0, 3)
    instants = (0, 7, 7, 3 * SECOND_NS, 7, 2 * SECOND_NS + 1, 3 * SECOND_NS)
    expected = {each: fresh.device_ns(each) for each in sorted(set(instants))}
    assert [crystal.device_ns(each) for each in instants] == [expected[each] for each in instants]
