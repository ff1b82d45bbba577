"""A job with a long path is checked by another process, with the same result."""

import asyncio
import math
from collections.abc import Callable
from typing import Any

import pytest
from unit.coordinator.test_path_planning import NotedCalls

from orchestrator.clock.executor import run_inline
from orchestrator.coordinator.jobs.check import check_at_once, check_job
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.paths.packed import PART_ITEMS
from orchestrator.model.steps.order import RemainingStep, StepOrder
from orchestrator.runtime.examples import find_example


def make_steps(pieces: int, far: float = 0.0) -> list[RemainingStep]:
    angles = [number / pieces for number in range(1, pieces + 1)]
    points = [[round(50 * math.cos(angle), 4), round(50 * math.sin(angle), 4)] for angle in angles]
    lines = [{"piece": "line", "to": point} for point in points[:-1]]
    last = {"piece": "line", "to": [points[-1][0] + far, points[-1][1]]}
    path = {"do": "path", "axes": ["gantry.x", "gantry.y"], "start": [50, 0], "pieces": [*lines, last]}
    path |= {"tolerance": "0.1 mm", "corner": {"within": "0.05 mm"}}
    job = Job.model_validate(
        {"schema": "tutti.job/1", "name": "p", "steps": [path, {"do": "dwell", "duration": "1 s"}]}
    )
    return StepOrder(job.steps).list_remaining()


@pytest.mark.parametrize(("pieces", "calls"), [(PART_ITEMS, []), (PART_ITEMS + 1, [check_at_once])])
def test_only_long_paths_are_checked_elsewhere(pieces: int, calls: list[Callable[..., Any]]) -> None:
    fleet, check = load_fleet(find_example("demo.fleet.yaml")), NotedCalls()
    least_s = asyncio.run(check_job(fleet, make_steps(pieces), run_inline, check))
    assert check.functions == calls
    assert least_s == check_at_once(fleet, make_steps(pieces)) > 2.0


@pytest.mark.parametrize("pieces", [PART_ITEMS, PART_ITEMS + 1])
def test_a_problem_is_the_same(pieces: int) -> None:
    fleet = load_fleet(find_example("demo.fleet.yaml"))
    with pytest.raises(Refusal, match=r"steps\[0\] \(path\): .*gantry\.x") as refused:
        asyncio.run(check_job(fleet, make_steps(pieces, far=1e6), run_inline, run_inline))
    assert refused.value.remedy
