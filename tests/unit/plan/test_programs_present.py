"""Whether axes stand where a program begins."""

from fractions import Fraction

import pytest
from cluster.worlds import changed, demo_fleet

from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.plan.programs.present import stand_at


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("counts", [-2, -1, 1, 2])
def test_axes_stand_at_a_place_to_a_count(sign: int, counts: int) -> None:
    fleet = changed(demo_fleet(), gantry={"axes": {"x": {"sign": sign}}})
    axes = {"gantry.x": AxisForecast(motor=Fraction(5) + Fraction(counts, 1000), known=True, offset=Fraction(7))}
    assert stand_at({"gantry.x": "12 mm"}, axes, fleet) == (abs(counts) == 1)
