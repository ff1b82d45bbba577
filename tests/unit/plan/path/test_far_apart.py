"""Numbers far apart in one path: 1 nm to 1 km, 1 µm/s to 10 m/s, without a warning of numpy."""

import warnings

import pytest

from orchestrator.model.paths.spec import PathSpec
from orchestrator.model.units import Unit
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.plan import PathPlan, plan_path
from orchestrator.plan.path.run import LONGEST_S

LENGTHS_MM = [1e-6, 1e-3, 1.0, 20.0, 1e3, 1e6]
SPEEDS_MM_S = [1e-3, 3e-3, 1.0, 1e3, 1e4]
RAMPS_S = 1.5  # of the axes below, from rest to rest, with their jerk


def plan(length_mm: float, speed_mm_s: float, *, corner: bool) -> PathPlan:
    axes = [
        PathAxis(axis=f"gantry.{name}", unit=Unit.MM, velocity=1e4, acceleration=2e4, jerk=2e5, soft_limits=None)
        for name in "xy"
    ]
    pieces = [{"piece": "line", "to": [length_mm, 0]}, {"piece": "line", "to": [length_mm, length_mm]}]
    spec = {"axes": ["gantry.x", "gantry.y"], "start": [0, 0], "pieces": pieces[: 1 + corner]}
    return plan_path(PathSpec.model_validate({**spec, "speed": f"{speed_mm_s} mm/s"}), axes, {})


@pytest.mark.parametrize("corner", [False, True])
@pytest.mark.parametrize("length_mm", LENGTHS_MM)
@pytest.mark.parametrize("speed_mm_s", SPEEDS_MM_S)
def test_a_path_takes_its_length_by_its_speed(length_mm: float, speed_mm_s: float, corner: bool) -> None:
    least_s = length_mm * (1 + corner) / speed_mm_s
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if least_s > LONGEST_S:
            with pytest.raises(PathRefusal, match="at most 50000 s can be planned"):
                plan(length_mm, speed_mm_s, corner=corner)
            return
        planned = plan(length_mm, speed_mm_s, corner=corner)
    assert least_s * 0.999 <= planned.duration_s <= least_s * 1.001 + RAMPS_S
