"""What outputs did is read while their step moves, and stays as it was given out."""

import asyncio
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import pytest

from adapters.contract import HostInterval, SwitchedOutput
from adapters.controller.slots.triggers import TriggerCollection
from adapters.controller.state.armed_step import ArmedStep, StepPhase
from orchestrator.clock.fleet import FleetScale
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import TakeTriggers

SCALE = FleetScale("s", 0)
FIELDS: dict[str, Any] = {"request_id": "r", "actor": "a", "epoch": 1, "coordinator": "k", "job": "j", "step": 0}


class EndDriver:
    """A driver that states at the end what its output did. bound: of each edge, ns."""

    def __init__(self) -> None:
        self.instants = [1000, 2000, 3000]
        self.bound = 10

    async def take_triggers(self) -> Mapping[str, SwitchedOutput]:
        return {"lamp": SwitchedOutput([HostInterval(at - self.bound, at + self.bound) for at in self.instants])}


class ShowingDriver(EndDriver):
    """The same for one that states it while it moves. asked: the numbers of edges that were known."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[int] = []

    async def read_triggers(self, known: Mapping[str, int]) -> Mapping[str, SwitchedOutput]:
        first = known.get("lamp", 0)
        self.asked.append(first)
        await asyncio.sleep(0.001)
        return {"lamp": SwitchedOutput((await self.take_triggers())["lamp"].edges[first:])}


class Desk:
    """The triggers of a controller whose step 0 of job j moves."""

    def __init__(self, clock: VirtualClock, driver: EndDriver) -> None:
        self.step = ArmedStep("j", 0, 0, 0, ("x",), SCALE, can_advance=False, phase=StepPhase.MOVING)
        self.steps = SimpleNamespace(present=self.step, has_step=False)
        context = SimpleNamespace(driver=driver, clock=clock, require_scale=lambda: SCALE)
        status = SimpleNamespace(require_online=lambda: SimpleNamespace(axes={}))
        self.triggers = TriggerCollection(*cast(tuple[Any, Any, Any], (context, status, self.steps)))

    async def take(self, first: int = 0, *, moving: bool = True) -> list[tuple[int, int]]:
        """The edges from a number on."""
        reply = await self.triggers.take(TakeTriggers(**FIELDS, first=first, moving=moving))
        edges = reply.outputs["lamp"]
        return list(zip(edges.earliest_ns, edges.latest_ns, strict=True))


def test_edges_are_read_once_and_stay_as_they_were_given_out() -> None:
    async def main(clock: VirtualClock) -> None:
        driver = ShowingDriver()
        desk = Desk(clock, driver)
        driver.instants = [1000]
        assert await desk.take() == [(990, 1010)]
        driver.instants, driver.bound = [1000, 2000, 3000], 5
        first, second = await asyncio.gather(desk.take(1), desk.take(1))
        assert first == second == [(1995, 2005), (2995, 3005)] and driver.asked == [0, 1, 3]
        driver.instants, driver.bound = [1000, 2000, 3000, 4000], 1
        assert await desk.take(moving=False) == [(990, 1010), (1995, 2005), (2995, 3005), (3999, 4001)]
        # Nothing of that is known of another step.
        driver.instants = [101_000]
        assert await desk.take(moving=False) == [(100_999, 101_001)]

    run_virtual(main)


def test_what_cannot_be_read_while_it_moves_is_refused() -> None:
    async def main(clock: VirtualClock) -> None:
        desk = Desk(clock, EndDriver())
        with pytest.raises(Refusal) as refusal:
            await desk.take()
        assert refusal.value.code == "not-shown"
        assert len(await desk.take(moving=False)) == 3
        desk = Desk(clock, ShowingDriver())
        for present in (None, ArmedStep("j", 1, 0, 0, ("x",), SCALE, can_advance=False, phase=StepPhase.MOVING)):
            desk.steps.present = present
            with pytest.raises(Refusal) as refusal:
                await desk.take()
            assert refusal.value.code == "not-moving"

    run_virtual(main)
