"""How an SHRC-203 executes random moves, as `python -m benches lowering --make shrc203` measures it."""

from benches.makes.lowering_steppers import bench_stepper


def test_durations_are_kept_to_a_fifth_of_a_millisecond_where_one_command_alone_could_not() -> None:
    found = bench_stepper("shrc203", 120, seed=2)
    figures = {each.what: each for each in found.figures}
    assert figures["all, lowered-planned"].max <= 0.2
    assert figures["all, lowered-planned by one command"].p99 > 100
    executed = figures["all, real-lowered"]
    assert executed.n >= 20 and executed.met
    assert sum(each.ways.get("several commands", 0) for each in found.chosen) > 5
