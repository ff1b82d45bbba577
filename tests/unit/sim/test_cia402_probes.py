"""Touch probes of the simulated CiA 402 drive: objects 60B8h to 60BDh."""

import pytest
from unit.sim.cia402_bench import Aborted, CanBench

FUNCTION, STATUS, RISE_1, FALL_1, RISE_2, FALL_2 = range(0x60B8, 0x60BE)


def at(bench: CanBench, counts: int, number: int, *, level: bool) -> None:
    bench.drive.push_axis("1", counts - round(bench.drive.position("1")))
    bench.drive.set_input(number, level=level)


def test_an_edge_is_taken_once_until_the_probe_is_switched_on_again() -> None:
    bench = CanBench()
    at(bench, 10, 1, level=True)
    at(bench, 20, 1, level=False)
    assert bench.read(STATUS) == 0  # it was off
    bench.write(FUNCTION, 0, 0x11, 2)
    assert bench.read(STATUS) == 0x01
    at(bench, -30, 1, level=True)
    at(bench, 40, 1, level=False)
    at(bench, 50, 1, level=True)
    assert (bench.read(STATUS), bench.read(RISE_1, signed=True), bench.read(FALL_1)) == (0x03, -30, 0)
    bench.write(FUNCTION, 0, 0x11, 2)  # no change, so it is not taken again
    at(bench, 60, 1, level=False)
    at(bench, 70, 1, level=True)
    assert bench.read(RISE_1, signed=True) == -30
    bench.write(FUNCTION, 0, 0, 2)
    assert (bench.read(STATUS), bench.read(RISE_1, signed=True)) == (0, -30)
    bench.write(FUNCTION, 0, 0x31, 2)
    at(bench, 80, 1, level=False)
    at(bench, 90, 1, level=True)
    assert (bench.read(STATUS), bench.read(RISE_1), bench.read(FALL_1)) == (0x07, 90, 80)
    bench.write(FUNCTION, 0, 0x21, 2)  # the rising edge is no longer asked for
    assert bench.read(STATUS) == 0x05


def test_two_probes_and_continuous_capture() -> None:
    bench = CanBench(options={"probe_inputs": [4, 3]})
    bench.write(FUNCTION, 0, 0x2311, 2)
    for position, number, level in ((1, 3, True), (2, 3, False), (3, 4, True), (4, 3, True), (5, 3, False)):
        at(bench, position, number, level=level)
    assert bench.read(STATUS) == 0x0503
    assert [bench.read(index) for index in (RISE_1, FALL_1, RISE_2, FALL_2)] == [3, 0, 0, 5]
    bench.write(FUNCTION, 0, 0x2300, 2)
    assert bench.read(STATUS) == 0x0500


def test_a_capture_is_sent_in_a_pdo_and_a_restart_forgets_it() -> None:
    bench = CanBench()
    identifier = bench.map(False, 4, [0x60B9_0010, 0x60BA_0020], 255)
    bench.start()
    bench.write(FUNCTION, 0, 0x11, 2)
    at(bench, 1234, 1, level=True)
    bench.wait(1)
    assert bench.heard(identifier)[-1] == bytes([3, 0]) + (1234).to_bytes(4, "little")
    bench.drive.set_power(on=False)
    bench.drive.set_power(on=True)
    bench.wait(300)
    assert [bench.read(index) for index in (FUNCTION, STATUS, RISE_1)] == [0, 0, 0]


@pytest.mark.parametrize("word", [0x05, 0x19, 0x1D, 0x0500, 0x1100])
def test_a_source_that_is_not_there_is_refused(word: int) -> None:
    bench = CanBench(options={"probe_inputs": [1]})
    with pytest.raises(Aborted, match="0x06090030"):
        bench.write(FUNCTION, 0, word, 2)
    assert bench.read(FUNCTION) == bench.read(STATUS) == 0
    with pytest.raises(Aborted, match="0x06010002"):
        bench.write(RISE_1, 0, 5, 4)
