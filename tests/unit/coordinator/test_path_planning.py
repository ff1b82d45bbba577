"""Paths are planned beside the event loop: planning may take seconds, and heartbeats go on meanwhile."""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import pytest
from cluster.test_paths import ALONE, circle, gantries, prepare
from cluster.worlds import job, outcome, run_fleet

from orchestrator.clock.executor import run_inline
from orchestrator.coordinator.jobs.check import check_job, forecast_at_once
from orchestrator.model.paths.packed import PART_ITEMS
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


@pytest.mark.parametrize("pieces", [PART_ITEMS, PART_ITEMS + 1])
def test_only_a_path_of_many_pieces_is_planned_by_the_process_for_that(pieces: int) -> None:
    planning, checking = NotedCalls(), NotedCalls()
    ways = [math.tau * number / pieces for number in range(1, pieces + 1)]
    is_long = pieces > PART_ITEMS
    lines = ", ".join(
        f"{{piece: line, to: [{30 + 20 * math.cos(way):.6f}, {30 + 20 * math.sin(way):.6f}]}}" for way in ways
    )
    move = f"{{do: move, to: {{{ALONE[0]}: 50, {ALONE[1]}: 30}}}}"
    path = f"{{do: path, axes: [{', '.join(ALONE)}], start: [50, 30], speed: 50 mm/s, tolerance: 1 mm"
    path += f", corner: {{within: 0.1 mm}}, pieces: [{lines}]}}"

    async def main(fleet: VirtualFleet) -> None:
        services = fleet.coordinators["first"][1].scheduler._services  # pyright: ignore[reportPrivateUsage]
        object.__setattr__(services.motion, "plan_long", planning)
        object.__setattr__(services, "check", checking)
        await outcome(fleet, prepare(fleet.fleet, ALONE))
        forecast = await fleet.make_client().dry_run(job(f"[{move}, {path}]"))
        assert not forecast.problems and forecast.steps[1].least_s > 1
        assert checking.functions == ([forecast_at_once] if is_long else [])
        report = await outcome(fleet, job(f"[{move}, {path}]"))
        assert report.state == "done", report.reason
        assert planning.functions == ([plan_path_step] if is_long else [])

    run_fleet(main, gantries())
