"""Moves of virtual axes, checked offline: targets of their real axes, what is not known, and what is refused."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.forecast import JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.move import Move
from orchestrator.plan.forecast.job import JobForecaster, forecast_job
from orchestrator.plan.virtual_moves import find_virtual_targets

READY = (
    "{do: enable, axes: [table, slit]}, {do: home, axes: [table, slit]}, {do: move, to: {slit.gap: 0, slit.centre: 0}}"
)


def make_fleet() -> Fleet:
    plain = load_fleet(Path(__file__).parents[3] / "deploy" / "examples" / "table.fleet.yaml").to_plain()
    plain["controllers"]["front"]["outputs"] = {"lamp": {"number": 1}}
    return Fleet.model_validate(plain)


FLEET = make_fleet()


def forecast(steps: str, ready: str = READY) -> JobForecast:
    text = f"schema: tutti.job/1\nname: test\nsteps: [{ready}, {steps}]\n"
    return forecast_job(FLEET, parse_document(text, Job, "test").steps)


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ("{do: move, to: {slit.gap: 11}}", "slit.gap: target 11 mm is beyond its soft limits 0 to 10 mm"),
        ("{do: move, by: {slit.gap: -1 um}}", "slit.gap: target -0.001 mm is beyond its soft limits"),
        ("{do: move, to: {table.height: 0, table.pitch: 80, table.roll: 0}}", "front.jack: target 24 mm is beyond"),
        ("{do: move, to: {slit.gap: 1, front.upper: 1}}", "front.upper would be moved by slit and by front.upper"),
        ("{do: move, to: {slit.gap: 1}, sync: none}", "`sync: none` would move slit.gap"),
        ("{do: move, to: {slit.gap: 1 mrad}}", "slit.gap: mrad is a unit of angle"),
        ("{do: move, to: {slit.gab: 1}}", "no axis slit.gab; did you mean slit.gap?"),
        ("{do: move, to: {slit.gap: 1}, speed: {slit.gap: 0.5}}", "a virtual axis has no limit of its own"),
        ("{do: move, to: {slit.gap: 9}, speed: 900 mm/s}", "times its velocity limit"),
        ("{do: set-position, axes: {slit.gap: 1}}", "slit.gap is a virtual axis"),
        (
            "{do: move, to: {slit.gap: 1}, triggers: [{output: front.lamp, of: slit.gap, every: 1 mm, pulse: 1 ms}]}",
            "slit.gap is a virtual axis, and triggers count positions of real ones",
        ),
        ("{do: scan, axes: {slit.gap: {from: 1, to: 3, points: 3}}, fly: {duration: 9 ms}}", "only real axes fly"),
    ],
)
def test_what_virtual_axes_cannot_do_is_refused_by_name(step: str, text: str) -> None:
    problems = forecast(step).problems
    assert len(problems) == 1 and text in problems[0].text, problems


def test_a_refused_target_has_the_place_of_the_virtual_axis() -> None:
    (problem,) = forecast("{do: move, to: {table.height: 0, table.pitch: 80, table.roll: 0}}").problems
    assert problem.place == ["steps", 3, "to", "table.height"]


def test_axes_that_a_step_does_not_name_keep_their_positions() -> None:
    move = Move(to={"table.pitch": "2 mrad"}, by={"table.height": 1})
    assert find_virtual_targets(FLEET, move, "table", [Fraction(3)] * 3) == {
        "front.jack": Fraction(4) + Fraction(6, 10),
        "left.jack": Fraction(4) - Fraction(3, 10),
        "right.jack": Fraction(4) - Fraction(3, 10),
    }


def test_what_depends_on_where_axes_stand_is_a_condition_and_loses_their_positions() -> None:
    result = forecast(
        "{do: move, to: {table.pitch: 2}}, {do: move, by: {front.jack: 39}}", "{do: enable, axes: [table]}"
    )
    assert "the targets of front.jack, left.jack, right.jack in step 2 depend on where they stand" in result.conditions
    assert not result.problems and result.steps[1].most_s is None
    assert find_virtual_targets(FLEET, Move(to={"table.pitch": 2}), "table", None) is None


def test_a_speed_of_a_virtual_axis_is_kept_by_its_real_ones() -> None:
    steps = parse_document(
        f"schema: tutti.job/1\nname: test\nsteps: [{READY}, {{do: move, to: {{slit.gap: 8}}, speed: 2 mm/s}}]",
        Job,
        "test",
    ).steps
    forecaster = JobForecaster(FLEET)
    for number, step in enumerate(steps):
        forecaster.take(number, step)
    assert forecaster.motion is not None
    profiles = forecaster.motion.plan.profiles
    assert {axis: round(profile.peak_velocity / 10_000, 6) for axis, profile in profiles.items()} == {
        "front.upper": 1.0,
        "front.lower": 1.0,
    }


def change_group(**fields: Any) -> Fleet:
    plain = FLEET.to_plain()
    group = {"kind": "linear", "of": ["front.upper", "front.lower"], "axes": {"a": {"unit": "mm"}, "b": {"unit": "mm"}}}
    plain["virtual"] = {"pair": group | {"matrix": {"a": [1, 0], "b": [0, 1]}} | fields}
    plain["positions"] = {}
    return Fleet.model_validate(plain)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"matrix": {"a": [1, 2], "b": [2, 4]}}, "different positions of its real axes give the same virtual ones"),
        ({"matrix": {"a": [1, 1], "b": [1, "1.0000001"]}}, "condition"),
        ({"matrix": {"a": [1, 2], "b": [1]}}, "matrix.b has 1 numbers for 2 real axes"),
        ({"matrix": {"a": [1, 2]}}, "`matrix` has no row for b"),
        ({"matrix": None}, "`kind: linear` needs `matrix`"),
        ({"of": ["front.upper"]}, "2 virtual axes of 1 real ones"),
        ({"of": ["front.upper", "front.upper"]}, "front.upper is in `of` twice"),
        ({"of": ["front.upper", "front.uper"]}, "did you mean front.upper?"),
        ({"kind": "slit", "matrix": None}, "`kind: slit` has the axes gap, centre; `axes` has a, b"),
        ({"kind": "slit"}, "`kind: slit` has the axes"),
        ({"offset": {"c": 1}}, "`offset` names c"),
        ({"offset": {"a": "1 mrad"}}, "mrad is a unit of angle"),
        ({"axes": {"a": {"unit": "counts"}, "b": {"unit": "mm"}}}, "a virtual axis has no counts"),
        ({"axes": {"a": {"unit": "mm", "soft_limits": {"min": 2, "max": 1}}, "b": {"unit": "mm"}}}, "is not below max"),
    ],
)
def test_a_group_that_cannot_be_is_refused_where_it_stands(fields: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match="virtual") as refusal:
        change_group(**fields)
    assert text in str(refusal.value)


def test_a_group_has_a_name_of_its_own_and_jacks_stand_apart() -> None:
    plain = FLEET.to_plain()
    plain["virtual"]["front"] = plain["virtual"].pop("slit")
    plain["positions"] = {}
    with pytest.raises(ValueError, match="have the name of a controller"):
        Fleet.model_validate(plain)
    plain = FLEET.to_plain()
    plain["virtual"]["table"]["places"] = [[0, 0], [1, 1], [2, 2]]
    with pytest.raises(ValueError, match="stand on one line"):
        Fleet.model_validate(plain)


@pytest.mark.parametrize("group", ["table", "slit"])
def test_a_map_and_its_inverse_are_exact(group: str) -> None:
    virtual_map = FLEET.virtual_axes.maps[group]
    positions = [Fraction(number, 7) for number in range(1, len(virtual_map.real) + 1)]
    assert list(virtual_map.to_real(virtual_map.to_virtual(positions))) == positions


def test_units_of_named_forms_are_converted() -> None:
    plain = FLEET.to_plain()
    plain["virtual"]["slit"]["axes"]["centre"] = {"unit": "um"}
    plain["positions"] = {}
    virtual_map = Fleet.model_validate(plain).virtual_axes.maps["slit"]
    assert virtual_map.to_virtual([Fraction(3), Fraction(1)]) == (2, 2000)


def test_a_step_that_names_a_real_axis_twice_is_refused_before_it_moves() -> None:
    from orchestrator.plan.virtual_moves import require_apart

    with pytest.raises(Refusal, match="would be moved by"):
        require_apart(FLEET, Move(to={"slit.gap": 1, "front.lower": 1}))


HALVES = {"kind": "rotation", "angle": 30, "axes": {"u": {"unit": "mm"}, "v": {"unit": "mm"}}}


def make_nested_fleet(of: list[str], **group: Any) -> Fleet:
    """The example fleet, with a group whose axes stand for others."""
    plain = make_fleet().to_plain()
    plain["virtual"]["outer"] = HALVES | {"of": of} | group
    return Fleet.model_validate(plain)


def test_virtual_axes_of_virtual_axes_go_through_both_maps() -> None:
    fleet = make_nested_fleet(["slit.centre", "slit.gap"])
    outer, slit = fleet.virtual_axes.maps["outer"], fleet.virtual_axes.maps["slit"]
    assert fleet.expand_name("outer.u") == ["front.upper", "front.lower"] == list(outer.real)
    real = [Fraction(7, 3), Fraction(2, 7)]
    gap, centre = slit.to_virtual(real)
    cosine, sine = Fraction("0.866025403784439"), Fraction(1, 2)
    assert outer.to_virtual(real) == (cosine * centre + sine * gap, -sine * centre + cosine * gap)
    assert list(outer.to_real(outer.to_virtual(real))) == real
    step = Move(to={"outer.u": 3})
    targets = find_virtual_targets(fleet, step, "outer", real)
    assert targets is not None
    assert outer.to_virtual(list(targets.values())) == (3, outer.to_virtual(real)[1])


@pytest.mark.parametrize(
    ("of", "group", "text"),
    [
        (["slit.gap", "left.jack"], {}, "but not for slit.centre; name all of them"),
        (["slit.gap", "slit.gab"], {}, "no axis slit.gab; did you mean slit.gap?"),
        (["outer.u", "outer.v"], {}, "outer stands for axes of outer"),
        (["slit.gap", "slit.centre", "front.upper"], {"kind": "linear", "angle": None}, "stands for front.upper twice"),
    ],
)
def test_nested_virtual_axes_that_cannot_be_are_refused(of: list[str], group: dict[str, Any], text: str) -> None:
    if "kind" in group:
        names = ("u", "v", "w")
        group["axes"] = {name: {"unit": "mm"} for name in names}
        group["matrix"] = {name: [int(name == column) for column in names] for name in names}
    with pytest.raises(ValueError, match=text.replace("?", "[?]")):
        make_nested_fleet(of, **group)


def test_a_third_level_is_refused_by_name() -> None:
    plain = make_nested_fleet(["slit.gap", "slit.centre"]).to_plain()
    plain["virtual"]["third"] = HALVES | {"of": ["outer.u", "outer.v"]}
    with pytest.raises(ValueError, match="third stands for axes of outer, and that for axes of slit"):
        Fleet.model_validate(plain)
