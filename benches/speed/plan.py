"""The duration of planning, compared with the bare Ruckig call in the same run."""

import statistics
import time
from collections.abc import Callable
from random import Random
from typing import Any, NamedTuple

from orchestrator.plan.shape import get_workspace
from orchestrator.plan.step import AxisMove, plan_step

SIZES = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024)
SEED = 7


class PlanRow(NamedTuple):
    """One size of step. Medians, in µs; ratio: of the two."""

    axes: int
    plan_us: float
    ruckig_us: float
    ratio: float


def bench_plan(order: int, rounds: int) -> list[PlanRow]:
    """Plan random jerk-limited (order 3) or trapezoid (order 2) steps of every size, `rounds` times each.

    A plan includes everything: soft limits, Ruckig, checks of every result, exported profiles. The bare call is
    `Ruckig.calculate` with the same input as the plan's, prepared beforehand.
    """
    draw = Random(SEED)
    rows: list[PlanRow] = []
    for axes in SIZES:
        moves = [_draw_move(f"bench.a{k}", draw, order) for k in range(axes)]
        solver, trajectory, question = get_workspace(axes)
        plan_us: list[float] = []
        bare_us: list[float] = []
        for _ in range(rounds):
            # Alternating, so that other load on the machine affects both.
            plan_us.append(_measure_call(lambda moves=moves: plan_step(moves)))
            bare_us.append(_measure_call(lambda s=solver, q=question, t=trajectory: s.calculate(q, t)))
        plan, bare = statistics.median(plan_us), statistics.median(bare_us)
        rows.append(PlanRow(axes, round(plan, 2), round(bare, 2), round(plan / bare, 2)))
    return rows


def _draw_move(axis: str, draw: Random, order: int) -> AxisMove:
    return AxisMove(
        axis=axis,
        start_counts=0,
        target_counts=draw.randrange(1_000, 100_000),
        velocity=draw.uniform(1e4, 1e5),
        acceleration=draw.uniform(1e5, 1e6),
        jerk=1e7,
        order=3 if order == 3 else 2,
        soft_limits=(-1_000_000, 1_000_000),
    )


def _measure_call(call: Callable[[], Any]) -> float:
    began_ns = time.perf_counter_ns()
    call()
    return (time.perf_counter_ns() - began_ns) / 1000
