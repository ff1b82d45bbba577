"""Paths are planned beside the event loop: planning may take seconds, and heartbeats go on meanwhile."""

from collections.abc import Callable
from typing import Any, TypeVar

from cluster.test_paths import ALONE, circle, gantries, prepare
from cluster.worlds import outcome, run_fleet

from orchestrator.clock.executor import run_inline
from orchestrator.coordinator.jobs.check import check_job
from orchestrator.model.steps.order import StepOrder
from orchestrator.plan.path_step import plan_path_step
from orchestrator.runtime.virtual.fleet import VirtualFleet

T = TypeVar("T")


class NotedCalls:
    """An executor that notes what it runs."""

    def __init__(self) -> None:
        self.functions: list[Callable[..., Any]] = []

    async def __call__(self, function: Callable[..., T], *values: Any) -> T:
        self.functions.append(function)
        return await run_inline(function, *values)


def test_a_path_is_planned_by_the_executor_for_that() -> None:
    noted = NotedCalls()

    async def main(fleet: VirtualFleet) -> None:
        motion = fleet.coordinators["first"][1].scheduler._services.motion  # pyright: ignore[reportPrivateUsage]
        object.__setattr__(motion, "plan", noted)
        await outcome(fleet, prepare(fleet.fleet, ALONE))
        assert not noted.functions  # moves are planned at once
        report = await outcome(fleet, circle(ALONE, 1))
        assert report.state == "done", report.reason
        assert plan_path_step in noted.functions and len(noted.functions) >= 3  # and checked, twice

    run_fleet(main, gantries())


def test_a_job_is_checked_by_that_executor_only_where_it_has_a_path() -> None:
    noted, fleet = NotedCalls(), gantries()

    async def main(_: VirtualFleet) -> None:
        await check_job(fleet, StepOrder(prepare(fleet, ALONE).steps, 1).list_remaining(), noted, run_inline)
        assert not noted.functions
        await check_job(fleet, StepOrder(circle(ALONE, 1).steps, 1).list_remaining(), noted, run_inline)
        assert noted.functions

    run_fleet(main, fleet)
