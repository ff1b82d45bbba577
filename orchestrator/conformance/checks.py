"""A check of the contract suite: a run of a driver with its simulated controller, with what it needs."""

import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from orchestrator.conformance.findings import NotApplicable, require
from orchestrator.conformance.worlds import Case, World, run_case
from orchestrator.model.errors import ControllerFault, Refusal

CheckBody = Callable[[World], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class ContractCheck:
    """One check: what holds if it passes, and its variant. ppm: rate error of the controller's crystal.

    is_long: one of the variants that only a long run adds."""

    title: str
    body: CheckBody
    variant: str = ""
    seed: int = 0
    ppm: float = 40.0
    is_long: bool = False

    @property
    def name(self) -> str:
        """The title with the variant."""
        return f"{self.title} ({self.variant})" if self.variant else self.title

    def run(self, case: Case) -> None:
        """Run it. Raises `ContractBroken`, `NotApplicable`, or what the driver raises."""
        run_case(case, self.body, self.seed, self.ppm)


def require_line_start(world: World) -> None:
    """Raise `NotApplicable` for a make that cannot wait for a trigger line."""
    if "line" not in world.driver.capabilities.start_classes:
        raise NotApplicable("this make cannot wait for an input")
    if "line" not in world.hit.config.inputs:
        raise NotApplicable("the make's example names no input")


async def follow_to_end(world: World) -> None:
    """Wait for the start and the end of a motion that is stopped, as every caller that has started one does."""
    with contextlib.suppress(ControllerFault, Refusal):
        await world.driver.slots.present.wait_for_start()
        outcome = await world.driver.slots.present.wait_for_end()
        require(outcome.state != "done", "a move that was stopped is reported as done")


async def require_step(world: World, factor: float = 1.0) -> None:
    """Run a step, which must be done."""
    _, _, outcome, _, _ = await world.move(world.targets(factor))
    require(outcome.state == "done", f"a step ended as {outcome.state}: {outcome.reason}")
