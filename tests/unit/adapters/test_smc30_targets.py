"""Steps of one speed behind one another: the SMC30 takes the target from a register, the rest stays loaded."""

import pytest
from unit.adapters.test_smc30_bench import HOST, World, run

from adapters.smc30.driver import Smc30Driver
from adapters.smc30.lowering import REGISTER_MAX, TARGET_REGISTER, Smc30Lowered
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.plan.step import AxisMove, plan_step

BEHIND = HOST.model_copy(update={"follows": True, "at_once": True})


def lower(driver: Smc30Driver, start: int, end: int, velocity: float = 4000) -> Smc30Lowered:
    plan = plan_step([AxisMove("x", start, end, velocity, 20_000)])
    return driver.lower_profiles(dict(plan.profiles), BEHIND, None)


async def load_behind(world: World, lowered: Smc30Lowered) -> list[bytes]:
    """Load a step behind one that has ended; return what was sent."""
    driver, _ = world.one
    sent: list[bytes] = []

    def record(data: bytes) -> bytes:
        sent.append(bytes(data))
        return data

    world.wire.to_far = record
    try:
        await driver.slots.present.load(lowered, world.clock.now_ns() + NS_PER_S, None, "at once")
    finally:
        world.wire.to_far = None
    return sent


async def move(world: World, lowered: Smc30Lowered) -> str:
    driver, _ = world.one
    await driver.slots.present.load(lowered, world.t0(lowered), None)
    await driver.slots.present.verify()
    await driver.slots.present.release()
    await driver.slots.present.wait_for_start()
    return (await driver.slots.present.wait_for_end()).state


def test_only_the_target_is_loaded_and_read_back() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        assert await move(world, lower(driver, 0, 2000)) == "done"
        back = lower(driver, 2000, 0)
        assert back.program == lower(driver, 0, 2000).program and back.by_register
        sent = b"".join(await load_behind(world, back))
        assert sent.count(b"\r") == 2
        assert sent.startswith(b"R509=R510-7") and f"VR{TARGET_REGISTER}".encode() in sent
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        assert (await driver.slots.present.wait_for_end()).state == "done"
        assert unit.position("1") == 0

    run(main)


@pytest.mark.parametrize(("end", "velocity"), [(3000, 2000.0), (-500, 4000.0), (REGISTER_MAX + 1, 4000.0)])
def test_another_speed_or_a_target_beyond_the_register_is_a_program_of_its_own(end: int, velocity: float) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        assert await move(world, lower(driver, 0, 2000)) == "done"
        lowered = lower(driver, 2000, end, velocity)
        sent = b"".join(await load_behind(world, lowered))
        assert b"PO" in sent and b"PX" in sent and b"Q" in sent
        assert (b"G+(R509)" in sent) is lowered.by_register is (0 <= end <= REGISTER_MAX)
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        assert (await driver.slots.present.wait_for_end()).state == "done"
        assert unit.position("1") == end

    run(main)


@pytest.mark.parametrize("target", [0, 7, 2000])
def test_a_restart_before_loading_is_found_by_the_target_itself(target: int) -> None:
    """After a restart the register that the target is computed from is empty."""

    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        start = 1000
        assert await move(world, lower(driver, 0, start)) == "done"
        lowered = lower(driver, start, target)
        await world.power_cycle(unit, 20)
        await world.sleep(50)
        count = len(unit.commanded_motions)
        with pytest.raises(Refusal) as caught:
            await load_behind(world, lowered)
        assert caught.value.code in ("not-loaded", "refused", "other-start")
        await world.sleep(1000)
        assert len(unit.commanded_motions) == count

    run(main)
