"""Units are exact, and profiles describe their motion."""

import math
import random
from fractions import Fraction
from typing import Literal

import pytest

from orchestrator.model.axis_units import SoftLimits
from orchestrator.model.fleet import Axis, AxisLimits
from orchestrator.model.profile import Profile
from orchestrator.model.units import Unit, UnitError, find_si_size, parse_quantity
from orchestrator.plan.targets import explain_beyond_limits


def test_quantities_are_exact() -> None:
    assert parse_quantity("12.5 um", Unit.MM) == Fraction(125, 10_000)
    assert parse_quantity(0.1, Unit.MM) == Fraction(1, 10)
    assert parse_quantity("1 in", Unit.MM) == Fraction(254, 10)
    assert parse_quantity("-.5rev", Unit.DEG) == -180
    with pytest.raises(UnitError, match="use one of: m, cm, mm, um, nm, in"):
        parse_quantity("1 deg", Unit.MM)
    with pytest.raises(UnitError, match="unknown unit 'parsec'"):
        parse_quantity("1 parsec", Unit.MM)


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        (Unit.M, 1.0),
        (Unit.UM, 1e-6),
        (Unit.INCH, 0.0254),
        (Unit.RAD, 1.0),
        (Unit.DEG, math.pi / 180),
        (Unit.REV, 2 * math.pi),
        (Unit.COUNTS, None),
        (Unit.KEV, None),
    ],
)
def test_units_of_lengths_and_angles_in_metres_and_radians(unit: Unit, size: float | None) -> None:
    assert find_si_size(unit) == size


def test_soft_limits_round_inwards_whatever_the_sign() -> None:
    axis = Axis(
        motors=["X"],
        unit=Unit.MM,
        scale=Fraction(10, 3),
        sign=-1,
        limits=AxisLimits(velocity=1, acceleration=1),
        soft_limits=SoftLimits(min=0, max=1),
    )
    assert axis.soft_limits_counts == (-3, 0)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_target_that_is_a_soft_limit_is_inside(sign: Literal[1, -1]) -> None:
    """78.74 counts a millimetre: -0.1 mm is 7.874 counts."""
    axis = Axis(
        motors=["X"],
        unit=Unit.MM,
        scale=Fraction("78.74"),
        sign=sign,
        limits=AxisLimits(velocity=1, acceleration=1),
        soft_limits=SoftLimits(min=-0.1, max=0.1),
    )
    assert axis.soft_limits_counts == (-7, 7)
    for end in ("-0.1", "0.1", "0.095"):
        target = Fraction(end)
        assert abs(axis.to_target_counts(target)) == 7
        assert explain_beyond_limits("gantry.x", axis, target, Fraction(0)) is None
    assert abs(axis.to_target_counts(Fraction("0.1001"))) == 8
    assert explain_beyond_limits("gantry.x", axis, Fraction("0.1001"), Fraction(0)) is not None
    assert abs(axis.to_target_counts(Fraction("0.05"))) == 4


def test_profile_reaches_its_extremes() -> None:
    """A profile that turns back inside a segment shows its true extent and peaks."""
    draw = random.Random(3)
    for _ in range(100):
        t = [draw.uniform(0.1, 1) for _ in range(4)]
        a = [draw.uniform(-5, 5) for _ in range(4)]
        j = [draw.uniform(-20, 20) for _ in range(4)]
        profile = Profile(100, 100, draw.choice([-3.0, 7.0]), t, a, j)
        at = profile.make_evaluator()
        seen = [at(k * profile.duration_s / 2000) for k in range(2000)]
        low, high = profile.extent_counts
        assert min(p.position for p in seen) + 100 >= low - 1e-9
        assert max(p.position for p in seen) + 100 <= high + 1e-9
        assert abs(max(abs(p.velocity) for p in seen) - profile.peak_velocity) < 0.01 * profile.peak_velocity
        assert max(abs(p.acceleration) for p in seen) <= profile.peak_acceleration + 1e-9
