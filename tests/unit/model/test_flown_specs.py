"""Specs of scanspec with `Fly`: flown, or refused by name; never stepped."""

from typing import Any

import numpy as np
import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.scans.spec_lines import place_flown_spec
from orchestrator.model.steps.scan import Scan
from orchestrator.model.units import Unit

specs = pytest.importorskip("scanspec.specs")
X, Y, Z = "gantry.x", "gantry.y", "lift.z"


def flown(spec: Any, **fields: Any) -> Scan:
    return place_flown_spec(Scan(scanspec=spec.serialize(), **fields))


def line(points: int = 5) -> Any:
    return specs.Linspace(X, 0, 10, points)


def outer() -> Any:
    return specs.Linspace(Y, 0, 1, 3)


@pytest.mark.parametrize(
    "spec",
    [
        specs.Fly(0.02 @ line()),
        specs.Fly(0.02 @ (outer() * ~line())),
        0.02 @ specs.Fly(outer() * ~line()),
        outer() * specs.Fly(~(0.02 @ line())),
        specs.Fly(~(0.02 @ (outer() * line(4)))),
        specs.Linspace(Y, 3, 3, 1) * specs.Fly(0.02 @ line()),
        specs.Fly(0.02 @ line(3).zip(outer())),
        specs.Fly(0.02 @ (specs.Linspace(Z, 0, 4, 3) * ~outer().zip(line(3)))),
        specs.Fly(0.02 @ specs.Spiral(X, 0, 10, 1, Y, 0, 10)),
        specs.Fly(0.02 @ (specs.Linspace(Z, 0, 1, 2) * ~specs.Spiral(X, 0, 10, 1, Y, 0, 10))),
        specs.Fly(0.02 @ specs.Spiral(X, 0, 10, 1, Y, 0, 10).zip(specs.Linspace(Z, 0, 1, 79))),
        specs.Fly((specs.Linspace(Z, 0, 4, 2) * line(3)).zip(0.02 @ outer())),
    ],
)
def test_lines_with_a_duration_are_flown_through_the_points_of_the_spec(spec: Any) -> None:
    scan = flown(spec, name="field", speed=0.5)
    assert scan.scanspec is None and scan.fly is not None and scan.fly.duration == 20_000_000
    assert (scan.name, scan.speed) == ("field", 0.5)
    from scanspec.core import Path

    midpoints = Path(spec.calculate(bounds=False)).consume().midpoints
    points = scan.grid
    for column, name in enumerate(scan.axes):
        found = [float(points.find_position(k, [Unit("mm")] * len(scan.axes))[column]) for k in range(points.count)]
        assert np.allclose(found, midpoints[name])


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        (specs.Fly(line()), "`Fly` without a duration"),
        (specs.Fly(0.0 @ line()), "duration of 0 s"),
        (specs.Fly(1e-5 @ line()), "the least is 1 ms"),
        (specs.Fly(0.1 @ line(1)), "has one point"),
        (specs.Fly(0.1 @ (specs.Spiral(X, 0, 10, 1, Y, 0, 10) * line())), "gantry.y, gantry.x together outside"),
        (specs.Fly(0.1 @ specs.Ellipse(X, 0, 10, 1, Y, 0, 10, 1)), "Ellipse"),
        (specs.Fly(0.1 @ specs.Spiral(X, 0, 10, 1, Y, 0, 10).zip(specs.Linspace(Z, 0, 1, 5))), "79 points"),
        (specs.Fly(0.1 @ outer().zip(line(4))), "gantry.y with 3 points and gantry.x with 4 points"),
        (specs.Fly(0.1 @ outer().zip(~line(3))), "gantry.x with 3 points, in a Snake"),
        (specs.Fly(0.1 @ outer().zip(outer())), "axis gantry.y twice"),
        (specs.Fly(0.1 @ (outer().zip(line(3)) * specs.Linspace(Z, 0, 1, 5))), "gantry.y, gantry.x together outside"),
        (specs.Fly(0.1 @ (outer() * line()).zip(specs.Linspace(Z, 0, 1, 3) * line())), "Zip of several levels"),
        (specs.Fly(0.1 @ specs.Static(X, 0, 3)), "Static"),
        (specs.Fly(0.1 @ specs.Range(X, 0, 1, 0.1)), "Range"),
        (specs.Fly(0.1 @ line().concat(specs.Linspace(X, 20, 30, 5))), "Concat"),
        (specs.Fly(outer()) * line(), "not around the innermost axis"),
        (3 * specs.Fly(0.1 @ line()), "`Fly`, 3 times"),
        (line() * specs.Fly(specs.ConstantDuration(0.1, None)), "a duration alone"),
    ],
)
def test_what_has_fly_and_cannot_be_flown_is_refused_by_name(spec: Any, words: str) -> None:
    with pytest.raises(Refusal) as refused:
        flown(spec)
    assert refused.value.code == "bad-scanspec" and words in refused.value.text and refused.value.remedy


def test_steps_at_each_point_do_not_go_with_fly() -> None:
    with pytest.raises(Refusal, match="nothing runs in `at_each`"):
        flown(specs.Fly(0.1 @ line()), at_each=[{"do": "dwell", "duration": "1 ms"}])


def test_a_spec_without_fly_stays_one() -> None:
    scan = Scan(scanspec=line().serialize())
    assert place_flown_spec(scan) is scan
