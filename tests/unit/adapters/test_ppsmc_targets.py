"""Steps of one speed behind one another: only the target buffer of a pp-electronic SMC is loaded."""

import pytest
from unit.adapters.ppsmc_bench import Bench, run

from adapters.contract import LoadPlace
from adapters.ppsmc.loading import COMPARED_NS
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal


async def load_behind(bench: Bench, to: int, factor: float = 1.1, place: LoadPlace = "at once") -> str:
    """Load a step behind one that has ended; return what was sent."""
    lowered = await bench.lowered({"x": to}, factor=factor)
    sent: list[bytes] = []

    def record(data: bytes) -> bytes:
        sent.append(bytes(data))
        return data

    bench.wire.to_far = record
    try:
        await bench.driver.slots.present.load(lowered, bench.clock.now_ns() + NS_PER_S, None, place)
    finally:
        bench.wire.to_far = None
    return b"".join(sent).decode()


async def move_soon(bench: Bench, to: int) -> None:
    """A step that starts as soon as it is loaded."""
    slot, lowered = bench.driver.slots.present, await bench.lowered({"x": to})
    t0_ns = bench.clock.now_ns() + lowered.costs.arm_ns + NS_PER_S
    await slot.load(lowered, t0_ns, None)
    await slot.release(advance_ns=t0_ns - bench.clock.now_ns() - (lowered.release_ns or 0))
    assert (await bench.followed())[1].state == "done"


def test_only_the_target_buffer_is_loaded_and_read_back() -> None:
    async def main(bench: Bench) -> None:
        await bench.ready()
        await move_soon(bench, 400)
        sent = await load_behind(bench, 0)
        assert "tbs1:a0" in sent and "?tb" in sent and "?s" in sent and "?p" in sent
        assert "ffast" not in sent and "?conf" not in sent
        await bench.driver.slots.present.release()
        assert (await bench.followed())[1].state == "done"
        assert bench.steps("x") == 0

    run(main)


@pytest.mark.parametrize("why", ["speed", "time", "at rest"])
def test_everything_is_loaded_where_something_may_differ(why: str) -> None:
    async def main(bench: Bench) -> None:
        await bench.ready()
        await move_soon(bench, 400)
        if why == "time":
            await sleep_ns(bench.clock, COMPARED_NS)
        place: LoadPlace = "at rest" if why == "at rest" else "at once"
        sent = await load_behind(bench, 0, 2.0 if why == "speed" else 1.1, place)
        assert "ffast1:" in sent and "?conf" in sent

    run(main)


def test_a_restart_before_loading_is_found() -> None:
    async def main(bench: Bench) -> None:
        await bench.ready()
        await move_soon(bench, 400)
        lowered = await bench.lowered({"x": 0})
        bench.unit.set_power(on=False)
        await sleep_ns(bench.clock, NS_PER_S // 50)
        bench.unit.set_power(on=True)
        with pytest.raises((Refusal, ControllerFault, LinkClosed)) as caught:
            await bench.driver.slots.present.load(lowered, bench.clock.now_ns() + NS_PER_S, None, "at once")
        if isinstance(caught.value, Refusal):
            assert caught.value.code in ("not-loaded", "other-start")
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moving

    run(main)
