"""Zones of a fleet file: what is refused, with place, value and remedy."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "zones.fleet.yaml"


def read_zones(change: dict[str, Any]) -> Fleet:
    """The example with other zones. change: by `bodies`, `rules` and `ranges`, what is added or replaced."""
    plain = load_fleet(EXAMPLE).to_plain()
    for block, entries in change.items():
        plain["zones"][block] = {**plain["zones"].get(block, {}), **entries}
    return Fleet.model_validate(plain)


BALL = {"sphere": 5}


def carried(**carrier: Any) -> dict[str, Any]:
    return {"bodies": {"ball": {**BALL, "on": [carrier]}}}


def polygon(*corners: list[float]) -> dict[str, Any]:
    return {"bodies": {"plate": {"polygon": {"corners": list(corners), "height": 5}}}}


@pytest.mark.parametrize(
    ("change", "place", "words"),
    [
        (carried(axis="gantry.q", along="x"), "zones.bodies.ball.on.0.axis", "has no axis gantry.q; did you mean"),
        (carried(axis="gantry.x", about="x"), "zones.bodies.ball.on.0.axis", "`about` needs an axis of angle"),
        (carried(axis="stage.phi", along="x"), "zones.bodies.ball.on.0.axis", "`along` needs an axis of length"),
        (carried(axis="gantry.x"), "zones.bodies.ball.on.0", "needs either `along` or `about`"),
        (carried(axis="gantry.x", along=[0, 0, 0]), "zones.bodies.ball.on.0", "is no direction"),
        (carried(axis="gantry.x", along="x", through=[0, 0, 1]), "zones.bodies.ball.on.0", "has no `through`"),
        (carried(body="sample", along="x"), "zones.bodies.ball.on.0", "rides on the body sample as that moves"),
        (carried(body="arm"), "zones.bodies.ball.on.0.body", "there is no body arm; bodies: detector, carriage"),
        (carried(body="ball"), "zones.bodies.ball.on.0.body", "body ball rides on itself"),
        (
            {"bodies": {"a": {**BALL, "on": [{"body": "b"}]}, "b": {**BALL, "on": [{"body": "a"}]}}},
            "zones.bodies.a.on.0.body",
            "body a rides on itself; remove one `body`",
        ),
        (
            {"bodies": {"a": {**BALL, "on": [{"axis": "gantry.x", "along": "x"}, {"body": "sample"}]}}},
            "zones.bodies.a",
            "only the first entry can be a body",
        ),
        ({"bodies": {"a": {}}}, "zones.bodies.a", "it has none; state exactly one of box"),
        ({"bodies": {"a": {**BALL, "box": [1, 1, 1]}}}, "zones.bodies.a", "it has box and sphere"),
        ({"bodies": {"a": {"sphere": "3 deg"}}}, "zones.bodies.a.sphere", "deg is a unit of angle"),
        ({"bodies": {"a": {"sphere": 0}}}, "zones.bodies.a.sphere", "must be above 0"),
        ({"bodies": {"a": {"box": [1, -1, 1]}}}, "zones.bodies.a.box.1", "-1 is no size"),
        (polygon([0, 0], [10, 0], [2, 2], [0, 10]), "zones.bodies.plate.polygon", "not convex at corner 3"),
        (polygon([0, 0], [10, 10], [10, 0], [0, 10]), "zones.bodies.plate.polygon", "or crosses itself"),
        (polygon([0, 0], [5, 0], [10, 0], [0, 10]), "zones.bodies.plate.polygon", "corner 2 is on a line"),
        (
            # a star with five points, each of which is passed in one sense
            polygon([0, 10], [6, -8], [-10, 3], [10, 3], [-6, -8]),
            "zones.bodies.plate.polygon",
            "goes around more than once",
        ),
        ({"rules": {"r": {"apart": {"bodies": ["sample", "sample"]}}}}, "zones.rules.r.apart", "sample is both bodies"),
        ({"rules": {"r": {"apart": {"bodies": ["sample", "arm"]}}}}, "zones.rules.r.apart.bodies.1", "no body arm"),
        ({"rules": {"r": {"keep_out": {"body": "arm", "region": BALL}}}}, "zones.rules.r.keep_out.body", "no body arm"),
        (
            {"rules": {"r": {"apart": {"bodies": ["sample", "detector"], "distance": "-1 mm"}}}},
            "zones.rules.r",
            "distance is -1 mm; it must not be below 0",
        ),
        ({"rules": {"r": {}}}, "zones.rules.r", "state exactly one of `apart`, `keep_out`, and `when` with `forbid`"),
        ({"rules": {"r": {"when": "gantry.x < 5 mm"}}}, "zones.rules.r", "`when` with `forbid`"),
        (
            {"rules": {"r": {"when": "gantry.x = 5 mm", "forbid": "gantry.z < 1"}}},
            "zones.rules.r",
            "when is 'gantry.x = 5 mm'; write an axis, < or >, and a position",
        ),
        (
            {"rules": {"r": {"when": "gantry.x < 5 deg", "forbid": "gantry.z < 1"}}},
            "zones.rules.r.when",
            "deg is a unit of angle",
        ),
        (
            {"rules": {"r": {"when": "gantry.q < 5", "forbid": "gantry.z < 1"}}},
            "zones.rules.r.when",
            "has no axis gantry.q",
        ),
        (
            {"rules": {"r": {"when": "gantry.x < 5", "forbid": "gantry.z < 1", "hysteresis": "-1 mm"}}},
            "zones.rules.r.hysteresis",
            "must not be below 0",
        ),
        ({"ranges": {"gantry.q": [0, 1]}}, "zones.ranges.gantry.q", "has no axis gantry.q"),
        ({"ranges": {"gantry.x": [2, 1]}}, "zones.ranges.gantry.x", "2 is not below 1; swap them"),
    ],
)
def test_a_wrong_zone_is_refused_with_place_and_remedy(change: dict[str, Any], place: str, words: str) -> None:
    with pytest.raises(ValidationError) as failure:
        read_zones(change)
    errors = {".".join(map(str, error["loc"])): error["msg"] for error in failure.value.errors()}
    matching = [text for at, text in errors.items() if at.startswith(place)]
    assert matching and words in matching[0], errors


def test_an_axis_without_limits_needs_a_range_where_a_rule_depends_on_it() -> None:
    plain = load_fleet(EXAMPLE).to_plain()
    plain["controllers"]["gantry"]["axes"]["x"]["soft_limits"] = None
    with pytest.raises(ValidationError, match=r"a rule depends on gantry\.x, which has no soft limits; state where"):
        Fleet.model_validate(plain)
    plain["zones"]["ranges"] = {"gantry.x": ["-10 mm", "41 cm"]}
    assert Fleet.model_validate(plain).zones is not None


def test_zones_are_no_part_of_the_configuration_of_controllers() -> None:
    fleet = load_fleet(EXAMPLE)
    bare_fleet = fleet.model_validate({name: part for name, part in fleet.to_plain().items() if name != "zones"})
    assert bare_fleet.digest != fleet.digest and "zones" not in bare_fleet.to_plain()
    assert [config.digest for config in bare_fleet.controllers.values()] == [
        config.digest for config in fleet.controllers.values()
    ]
    assert Fleet.model_validate(fleet.to_plain()).digest == fleet.digest
