"""How far a program goes, beside the soft limits of its axes."""

from dataclasses import replace

import numpy as np
import pytest
from cluster.worlds import changed, demo_fleet

from orchestrator.gateway.program_drawing import list_extents
from orchestrator.plan.path.traces import PathTrace


def trace(*points: tuple[float, float]) -> PathTrace:
    numbers = np.zeros(len(points), dtype=np.int64)
    return PathTrace(np.array(points), numbers, np.zeros(len(points), dtype=np.bool_), numbers, numbers, numbers + 0.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_limits_and_what_is_beyond_them_hold_for_both_directions_of_a_motor(sign: int) -> None:
    fleet = changed(demo_fleet(), gantry={"axes": {"x": {"sign": sign}}})
    path = trace((0.0, 0.0), (40.0, 20.0))
    x, _ = list_extents([path], ["gantry.x", "gantry.y"], fleet, {})
    assert (x["limits"], x["over"]) == ([-10.0, 400.0], 0)
    beyond, _ = list_extents([replace(path, points=path.points * 11)], ["gantry.x", "gantry.y"], fleet, {})
    assert beyond["over"] == pytest.approx(40)
