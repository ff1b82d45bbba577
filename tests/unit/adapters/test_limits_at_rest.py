"""Limit switches of axes at rest are shown by a poll."""

from collections.abc import Callable
from typing import Any

import pytest
from unit.adapters import ppsmc_bench
from unit.adapters import test_shrc203_driver as shrc203

RUNS = {"ppsmc": ppsmc_bench.run, "shrc203": shrc203.run}


@pytest.mark.parametrize("run", RUNS.values(), ids=RUNS)
def test_limit_switches_are_shown_at_rest(run: Callable[[Any], object]) -> None:
    async def case(bench: Any) -> None:
        await bench.ready()
        for limit in ("forward", "reverse", "both", "none"):
            for motor, name in (("1", "x"), ("2", "y"), ("3", "z")):
                bench.unit.set_limit(motor, limit)
                axis = (await bench.driver.poll()).axes[name]
                assert (axis.limit, axis.moving, axis.velocity_counts_s) == (limit, False, 0.0)

    run(case)
