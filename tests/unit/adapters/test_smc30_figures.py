"""Requirements of the SMC30's figures, on few rounds of the benchmarks that measure them."""

from benches.makes.lowering_steppers import bench_stepper
from benches.makes.smc30_bus import ASKED_LINE_MS, ASKED_SLOTS_MS, bench_smc30_bus


def test_seven_controllers_start_together_by_slots_and_by_a_trigger_line() -> None:
    one_by_one, slots, line = bench_smc30_bus(12, seed=5)
    assert one_by_one.p50_ms > 30  # five characters and a decoding for each of six
    assert slots.max_ms <= ASKED_SLOTS_MS
    assert slots.max_ms < one_by_one.p50_ms / 10
    assert line.max_ms <= ASKED_LINE_MS


def test_moves_take_the_planned_and_the_predicted_time() -> None:
    found = bench_stepper("smc30", 150, seed=2)
    by_name = {each.what: each for each in found.figures}
    assert by_name["all, lowered-planned"].met
    assert by_name["all, real-lowered"].n == 20
    assert by_name["all, real-lowered"].met
    slow = next(each for each in found.chosen if each.cruise == "16-33")
    assert slow.ways["several commands"] > 0
