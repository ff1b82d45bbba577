"""The plan of a job with many steps is made in parts: other work has its turn between them."""

import asyncio
from types import SimpleNamespace
from typing import Any, cast

from cluster.worlds import demo_fleet, job

from orchestrator.coordinator.jobs.job_plan import STEPS_AT_ONCE, PlannedJob, make_plan, resolve_job

PARTS = 5


def test_other_work_has_its_turn_while_a_long_job_is_planned() -> None:
    dwells = job("[" + ", ".join(["{do: dwell, duration: 1 s}"] * (PARTS * STEPS_AT_ONCE)) + "]")
    resolver = SimpleNamespace(resolve_step=lambda step: step, used={})
    view = SimpleNamespace(fleet=demo_fleet())

    async def main() -> None:
        turns = 0

        async def work() -> None:
            nonlocal turns
            while True:
                turns += 1
                await asyncio.sleep(0)

        task = asyncio.get_running_loop().create_task(work())
        planned = await resolve_job(dwells, 1, 0, cast(Any, resolver))
        assert isinstance(planned, PlannedJob) and turns == PARTS
        await make_plan(cast(Any, view), planned)
        # What the steps use, and their digest. The query of no state takes a turn.
        assert 3 * PARTS <= turns <= 3 * PARTS + 2
        task.cancel()

    asyncio.run(main())
