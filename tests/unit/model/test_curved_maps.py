"""Curved virtual axes: named forms against published figures, code of users, and what is refused of it."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import pytest

from orchestrator.model import virtual_maps
from orchestrator.model.curved_map import CrystalEnergy, SineBar
from orchestrator.model.fleet import Fleet
from orchestrator.model.linear_map import MapError
from orchestrator.runtime.simulated_fleets import make_smc4000
from tutti.kinematics import Kinematics, check_kinematics


class Polar:
    """A stage on a turntable: a radius and an angle."""

    of = ("mm", "deg")
    axes: Mapping[str, str] = {"x": "mm", "y": "mm"}

    def to_virtual(self, real: Sequence[float]) -> Sequence[float]:
        angle = math.radians(real[1])
        return real[0] * math.cos(angle), real[0] * math.sin(angle)

    def to_real(self, virtual: Sequence[float]) -> Sequence[float]:
        return math.hypot(*virtual), math.degrees(math.atan2(virtual[1], virtual[0]))


RANGES = [(10.0, 50.0), (-80.0, 80.0)]


def answer_with(name: str, answer: Callable[[Sequence[float]], Sequence[float]]) -> Kinematics:
    """Polar kinematics, one function of which is another one."""
    return type("Changed", (Polar,), {name: lambda _, values: answer(values)})()


def slow(values: Sequence[float]) -> Sequence[float]:
    time.sleep(0.005)
    return Polar().to_virtual(values)


def failing(values: Sequence[float]) -> Sequence[float]:
    raise KeyError(values[0])


class Bent(Polar):
    """Its radius is geared differently beyond a corner."""

    def to_virtual(self, real: Sequence[float]) -> Sequence[float]:
        return super().to_virtual((real[0] + 0.2 * abs(real[0] - CORNER), real[1]))

    def to_real(self, virtual: Sequence[float]) -> Sequence[float]:
        radius, angle = super().to_real(virtual)
        return CORNER + (radius - CORNER) / (1.2 if radius > CORNER else 0.8), angle


CORNER = 27.3


@pytest.mark.parametrize(
    ("kinematics", "ranges"),
    [
        (Polar(), RANGES),
        (SineBar(250.0, 0.0), [(-100.0, 100.0)]),
        (SineBar(250.0, 0.2), [(-40.0, 40.0)]),
        (CrystalEnergy(3.1356e-7, 0.0, with_exit=False), [(0.1, 0.8)]),
        (CrystalEnergy(3.1356e-7, 0.1, with_exit=True), [(0.0, 0.8), (5.0, 12.0)]),
    ],
)
def test_forms_and_good_code_pass(kinematics: Kinematics, ranges: list[tuple[float, float]]) -> None:
    check_kinematics(kinematics, ranges)


@pytest.mark.parametrize(
    ("kinematics", "text"),
    [
        (answer_with("to_real", lambda values: [values[0], values[1]]), "not its own inverse"),
        (answer_with("to_virtual", lambda values: [math.nan, values[1]]), "expected 2 numbers"),
        (answer_with("to_virtual", lambda values: values[:1]), "expected 2 numbers"),
        (answer_with("to_virtual", failing), "its code failed with KeyError"),
        (answer_with("to_virtual", slow), "ms for an answer"),
        (answer_with("to_virtual", lambda _: [1.0, 2.0]), "not its own inverse"),
    ],
)
def test_code_that_cannot_be_used_is_refused(kinematics: Kinematics, text: str) -> None:
    with pytest.raises(MapError, match=text):
        check_kinematics(kinematics, RANGES)


def test_a_map_with_a_corner_is_refused_with_its_place() -> None:
    with pytest.raises(MapError, match=r"not smooth: its derivative jumps at \(27\.2\d*|27\.3\d*, 0"):
        check_kinematics(Bent(), RANGES)


def test_units_and_numbers_of_axes_are_checked() -> None:
    with pytest.raises(MapError, match="unit 'furlong', which is not known"):
        check_kinematics(type("Other", (Polar,), {"of": ("furlong", "deg")})(), RANGES)
    with pytest.raises(MapError, match="1 ranges of 2 real axes"):
        check_kinematics(Polar(), RANGES[:1])


@pytest.mark.parametrize(
    ("spacing_nm", "theta_deg", "energy_ev"),
    [
        # Si(111), d = 0.31356 nm: 14.31 deg for 8 keV (X-ray data booklet, section 4.1, by 12.39842 / (2 d sin theta)).
        (0.3135602, 14.3095, 7999.1),
        (0.3135602, 90 - 1e-4, 1977.05),
    ],
)
def test_energies_of_silicon_follow_braggs_law(spacing_nm: float, theta_deg: float, energy_ev: float) -> None:
    crystal = CrystalEnergy(spacing_nm * 1e-6, 0.0, with_exit=False)
    assert crystal.to_virtual([math.radians(theta_deg)])[0] == pytest.approx(energy_ev, rel=1e-3)


def test_known_derivatives_are_those_that_differences_give() -> None:
    crystal = CrystalEnergy(3.1356e-7, 0.1, with_exit=True)
    plain = type("Plain", (), {name: getattr(crystal, name) for name in ("of", "axes", "to_virtual", "to_real")})()
    ones = (1.0, 1.0)
    maps = [
        virtual_maps.CurvedMap(("a", "b"), ("e", "x"), kinematics, ones, ones, "test")
        for kinematics in (crystal, plain)
    ]
    known_rows, rows = (each.find_rows([0.3, 8.0]) for each in maps)
    for known_row, row in zip(known_rows, rows, strict=True):
        assert known_row == pytest.approx(row, rel=1e-6, abs=1e-6)


def make_fleet(group: dict[str, Any], unit: str = "deg") -> Fleet:
    """One SMC-4000 with an axis `bragg`, and a group `mono` of it."""
    config = make_smc4000(1)
    axis = config["axes"]["x"]
    config["axes"] = {"bragg": {**axis, "unit": unit, "soft_limits": {"min": 5, "max": 60}}}
    plain = {"schema": "tutti.fleet/1", "fleet": "mono", "controllers": {"gonio": config}, "virtual": {"mono": group}}
    return Fleet.model_validate(plain)


ENERGY = {"kind": "energy", "of": ["gonio.bragg"], "spacing": "0.3135602 nm", "axes": {"energy": {"unit": "keV"}}}


def test_units_are_converted_from_and_to_those_of_the_file() -> None:
    energy = make_fleet(ENERGY).virtual_axes.maps["mono"]
    assert energy.observe([14.3095])[0] == pytest.approx(8.0, rel=1e-3)
    (angle,) = energy.to_real([Fraction(8)])
    assert energy.observe([float(angle)])[0] == pytest.approx(8.0, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"spacing": None}, "`kind: energy` needs `spacing`"),
        ({"spacing": 0}, "it must be above 0"),
        ({"matrix": {"energy": [1]}}, "`kind: energy` has no `matrix`"),
        ({"offset": {"energy": 1}}, "`kind: energy` has no `offset`"),
        ({"axes": {"energy": {"unit": "mm"}}}, "eV"),
        ({"angle": 20}, None),
        ({"angle": 90}, "theta is"),
        ({"kind": "code", "spacing": None, "kinematics": "tripod"}, "no kinematics 'tripod'"),
    ],
)
def test_mistakes_in_a_fleet_file_are_named(change: dict[str, Any], text: str | None) -> None:
    group = {key: value for key, value in (ENERGY | change).items() if value is not None}
    if text is None:
        make_fleet(group)
        return
    with pytest.raises(ValueError, match=text):
        make_fleet(group)
