"""Settling in closed loop, recovery from errors and from an emergency stop, and positions registered in the
controller."""

from typing import Any

import pytest
from unit.adapters.test_shrc203_driver import Bench, controller, run

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.errors import Refusal

CLOSED: dict[str, Any] = {"scales": True}
LOOP = {"loop": "closed"}


async def moved(bench: Bench, targets: dict[str, int]) -> str:
    await bench.start(targets)
    await bench.driver.slots.present.wait_for_start()
    return (await bench.driver.slots.present.wait_for_end()).state


@pytest.mark.parametrize("settle_ms", [0, 60, 500])
def test_a_move_is_done_when_it_has_settled_and_ended_when_its_profile_has(settle_ms: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 20_000})
        await bench.driver.slots.present.wait_for_start()
        outcome = await bench.driver.slots.present.wait_for_end()
        (motion,) = bench.moved()
        assert motion.end_ns is not None
        settled_ms = (bench.clock.now_ns() - motion.end_ns) / NS_PER_MS
        assert settle_ms <= settled_ms < settle_ms + 120
        assert outcome.ended["x"].earliest_ns <= motion.end_ns <= outcome.ended["x"].latest_ns
        assert outcome.ended["x"].latest_ns - motion.end_ns < 10 * NS_PER_MS  # regardless of the settling time
        assert not (await bench.driver.poll()).axes["x"].moving

    run(case, simulate={**CLOSED, "settle_ms": settle_ms}, options=LOOP)


def test_a_stage_that_does_not_follow_is_reported_and_freed_by_a_reset() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_stalled("1", stalled=True)
        await bench.start({"x": 4000})
        await bench.driver.slots.present.wait_for_start()
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "fault" and "does not settle" in outcome.reason
        reading = await bench.driver.poll()
        assert reading.axes["x"].moving and reading.axes["x"].actual_counts == 0
        bench.unit.set_stalled("1", stalled=False)
        await bench.driver.clear_faults()
        await sleep_ns(bench.clock, 200 * NS_PER_MS)
        assert not (await bench.driver.poll()).axes["x"].moving
        assert await moved(bench, {"x": 1000}) == "done"

    run(case, simulate=CLOSED, options=LOOP)


def test_an_overflow_is_cleared_by_a_reset() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_stalled("1", stalled=True)
        await bench.start({"x": 60_000})
        await bench.driver.slots.present.wait_for_start()
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "fault" and "S4" in outcome.reason
        assert "overflow" in {fault.code for fault in (await bench.driver.poll()).faults}
        with pytest.raises(Refusal):
            await bench.arm({"x": 0})
        await bench.driver.slots.unload()
        bench.unit.set_stalled("1", stalled=False)
        await bench.driver.clear_faults()
        await bench.driver.set_enabled(["x"], on=True)
        assert not (await bench.driver.poll()).faults
        assert await moved(bench, {"x": 100}) == "done"

    run(case, simulate=CLOSED, options=LOOP)


def test_a_limit_error_stays_until_its_cause_is_gone_and_it_is_reset() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_limit("2", "both")
        reading = await bench.driver.poll()
        assert "limit-error" in {fault.code for fault in reading.faults} and reading.axes["y"].limit == "both"
        bench.unit.set_limit("2", "none")
        assert (await bench.driver.poll()).faults
        await bench.driver.clear_faults()
        assert not (await bench.driver.poll()).faults
        assert await moved(bench, {"y": 1000}) == "done"

    run(case)


@pytest.mark.parametrize("excitation_off", [True, False])
def test_after_an_emergency_stop_in_motion_reset_and_enable_recover(excitation_off: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 80_000, "y": 60_000})
        await bench.driver.slots.present.wait_for_start()
        await sleep_ns(bench.clock, 300 * NS_PER_MS)
        await bench.driver.stop(abort=True)
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "fault" and "emergency stop" in outcome.reason
        with pytest.raises(Refusal):
            await bench.arm({"x": 0})
        await bench.driver.slots.unload()
        await bench.driver.clear_faults()
        reading = await bench.driver.poll()
        assert not reading.faults and reading.axes["x"].enabled != excitation_off
        await bench.driver.set_enabled(["x", "y", "z"], on=True)
        assert await moved(bench, {"x": 0, "y": 0}) == "done"

    run(case, simulate={"emergency_excitation_off": excitation_off})


def test_registered_positions_are_read() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert await bench.driver.read_registered("place") == await bench.driver.read_registered("coordinates") == {}
        assert await moved(bench, {"x": 3000, "z": -500}) == "done"
        for line in ("PIT:SET,3", "PAV:SET,20"):
            assert await bench.driver.send_raw(line) == "OK"
        assert await moved(bench, {"x": 100, "y": 7}) == "done"
        assert await bench.driver.send_raw("PIT:SET,1") == "OK"
        assert await bench.driver.read_registered("place") == {
            3: {"x": 3000, "y": 0, "z": -500},
            1: {"x": 100, "y": 7, "z": -500},
        }
        assert await bench.driver.read_registered("coordinates") == {20: {"x": 3000, "y": 0, "z": -500}}
        await bench.start({"x": 0})
        with pytest.raises(Refusal, match="at rest"):
            await bench.driver.read_registered("place")
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case)


def test_registered_positions_are_those_of_the_fleet_files_axes() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.send_raw("PAV:SET,2")
        assert await bench.driver.read_registered("coordinates") == {2: {"y": 0}}

    run(case, config=controller("y"))
