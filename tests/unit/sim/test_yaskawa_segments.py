"""Segments without length, which the manuals' own programs contain (SMC-4000: L13076, L13225; SMC-2000: L2181)."""

import pytest
from unit.sim.desk import Desk

PROGRAM = ("SHX", "DP 0", "LMX", "LI 4000 <4000 >1000", "LI 1000 <4000 >1000")


def test_a_segment_without_length_is_skipped() -> None:
    desk = Desk()
    desk.ask(*PROGRAM)
    assert desk.ask("LI 0 <4000 >1000") == ":"
    desk.ask("LE", "BGS")
    desk.rest()
    assert desk.unit.position("X") == 5000


@pytest.mark.parametrize("command", ["LI 0", "LI 0,0"])
def test_a_segment_without_length_is_refused_where_the_option_says_so(command: str) -> None:
    desk = Desk(zero_segments=False)
    desk.ask("SHXY", "LMXY", "LI 1000,1000")
    assert desk.ask(command) == "?"
    assert desk.ask("TC").strip().startswith("030")


def test_a_sequence_of_nothing_but_segments_without_length_does_not_move() -> None:
    desk = Desk()
    desk.ask("SHX", "LMX", "LI 0", "LE", "BGS")
    desk.wait(1)
    assert desk.unit.at_rest()
    assert desk.unit.position("X") == 0


def test_the_example_of_the_manual_runs_at_the_default_speed() -> None:
    """L13219 to 13270, cut to the size of the buffer: segments of 14 counts, where a sample is 25 counts."""
    desk = Desk()
    desk.ask("SHXY", "DP 0,0", "LMXY")
    count = 400
    for number in range(count):
        assert desk.ask(f"LI {number * 10 % 500},{number * 10 % 500}") == ":", number
    desk.ask("LE", "BGS")
    desk.rest()
    distance = sum(number * 10 % 500 for number in range(count))
    assert (desk.unit.position("X"), desk.unit.position("Y")) == (distance, distance)


def test_an_arc_shorter_than_a_sample_is_refused() -> None:
    desk = Desk()
    desk.ask("SHXY", "VMXY")
    assert desk.ask("CR 10,0,5") == "?"
    assert desk.ask("TC").strip().startswith("030")
