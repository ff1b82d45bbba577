"""The adapter's representation of a drive: tasks that wait for its messages."""

import asyncio

from adapters.cia402.canopen.bus import Cia402Bus
from adapters.cia402.canopen.node import BusDrive
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual

WAITING = 50


def test_waiting_tasks_continue_in_the_order_of_their_requests_in_every_run() -> None:
    async def main(clock: VirtualClock) -> list[int]:
        node = BusDrive(Cia402Bus(clock, 1_000_000), 1, "a", NS_PER_S, outputs=False)
        order: list[int] = []

        async def wait(number: int) -> None:
            assert await node.wait_until(lambda: node.loaded, NS_PER_S)
            order.append(number)

        tasks = [asyncio.get_running_loop().create_task(wait(number)) for number in range(WAITING)]
        await asyncio.sleep(0.1)
        node.loaded = True
        node.wake_waiting()
        await asyncio.gather(*tasks)
        return order

    assert run_virtual(main) == list(range(WAITING))
