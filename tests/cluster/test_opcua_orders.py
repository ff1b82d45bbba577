"""The receiver of job orders on a virtual fleet, without the protocol's library."""

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from cluster.worlds import EXAMPLES

from integrations.opcua.orders import OrderParameter, OrderRequest
from integrations.opcua.receiver import MAX_ORDERS, REFRESH_S, OrderReceiver
from integrations.opcua.states import ABORTED, ENDED, HELD
from integrations.opcua.work_masters import load_work_masters
from integrations.whole_fleet import refreshing
from tutti import Refusal, Tutti
from tutti.testing import virtual_fleet

SHIFT = """
schema: tutti.job/1
name: shift
parameters:
  way: {type: quantity, unit: mm, default: 20 mm, max: 300 mm}
steps:
  - {do: move, by: {gantry.x: "${way}"}}
  - {do: dwell, duration: 1 s}
  - {do: move, by: {gantry.x: "-${way}"}}
"""

Main = Callable[[Tutti, OrderReceiver], Awaitable[None]]


def run(folder: Path, main: Main) -> None:
    """Run `main` with a receiver that follows its orders."""
    (folder / "shift.job.yaml").write_text(SHIFT)

    async def serve(tutti: Tutti) -> None:
        receiver = OrderReceiver(tutti, load_work_masters(folder))
        async with refreshing(receiver.refresh, REFRESH_S):
            await main(tutti, receiver)

    with virtual_fleet(EXAMPLES / "demo.fleet.yaml") as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        fleet.run(serve)


def order(order_id: str, way: float = 20.0) -> OrderRequest:
    return OrderRequest(order_id, ("shift",), (OrderParameter("way", way),))


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.01)


def test_a_stopped_order_ends_behind_its_step_and_an_aborted_one_at_once(tmp_path: Path) -> None:
    async def main(tutti: Tutti, receiver: OrderReceiver) -> None:
        start = await tutti.position("gantry.x")
        await receiver.store(order("a"), "", held=False)
        await until(lambda: receiver.orders["a"].state.name == "Running")
        await receiver.stop("a", "")
        await until(lambda: receiver.orders["a"].state.is_ended)
        assert receiver.orders["a"].state == ENDED
        assert await tutti.position("gantry.x") == pytest.approx(start + 20, abs=0.01)
        report = receiver.orders["a"].report
        assert report is not None and report.state == "cancelled"
        await receiver.store(order("b", 300.0), "", held=False)
        await until(lambda: receiver.orders["b"].state.name == "Running")
        await receiver.abort("b", "")
        await until(lambda: receiver.orders["b"].state.is_ended)
        assert receiver.orders["b"].state == ABORTED
        assert start + 20 < await tutti.position("gantry.x") < start + 300

    run(tmp_path, main)


def test_an_order_that_begins_meanwhile_is_neither_cancelled_nor_updated(tmp_path: Path) -> None:
    async def main(tutti: Tutti, receiver: OrderReceiver) -> None:
        await receiver.store(order("a"), "", held=True)
        held = receiver.orders["a"]
        await receiver.update(order("a", 10.0), "")
        assert receiver.orders["a"].job_id != held.job_id and receiver.orders["a"].state == HELD
        assert [entry.id for entry in await tutti.list_jobs(state="queued")] == [receiver.orders["a"].job_id]
        await tutti.release_jobs(receiver.orders["a"].job_id)  # by another client
        await until(lambda: receiver.orders["a"].state.name == "Running")
        for act in (receiver.cancel("a", ""), receiver.update(order("a", 5.0), "")):
            with pytest.raises(Refusal, match="is Running and cannot"):
                await act
        await until(lambda: receiver.orders["a"].state == ENDED)

    run(tmp_path, main)


def test_orders_are_found_again_and_the_list_is_bounded(tmp_path: Path) -> None:
    async def main(tutti: Tutti, receiver: OrderReceiver) -> None:
        await receiver.store(order("ended"), "", held=False)
        await until(lambda: receiver.orders["ended"].state == ENDED)
        for number in range(MAX_ORDERS - 1):
            await receiver.store(order(f"held {number}"), "", held=True)
        await receiver.store(order("one more"), "", held=True)  # in place of the one that has ended
        assert "ended" not in receiver.orders
        with pytest.raises(Refusal, match="100 job orders wait or run already"):
            await receiver.store(order("too many"), "", held=True)
        await receiver.cancel("one more", "")
        again = OrderReceiver(tutti, receiver.templates)
        await again.restore()
        names = {order_id for order_id, found in again.orders.items() if found.state == HELD}
        assert names == {f"held {number}" for number in range(MAX_ORDERS - 1)}

    run(tmp_path, main)
