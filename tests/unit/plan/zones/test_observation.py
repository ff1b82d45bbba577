"""What is shown of zones: outlines that are the shapes, where the axes have brought them, and what rules say."""

import math
from pathlib import Path

import numpy as np
import pytest

from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.operation.zone_state import RuleReading, ZoneState
from orchestrator.model.zone_fields import ZoneShape
from orchestrator.monitor.zones_plot import find_hull
from orchestrator.plan.zones.observation import observe_zones
from orchestrator.plan.zones.outlines import make_wire
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.shapes import make_shape

FLEET = load_fleet(Path(__file__).parents[4] / "deploy" / "examples" / "zones.fleet.yaml")
ZONES = FleetZones(FLEET)
REST = {"gantry.x": 0.0, "gantry.z": 0.0, "stage.u": 0.0, "stage.phi": 0.0}


def observe(unknown: dict[str, str] | None = None, **positions: float) -> ZoneState:
    moved = {name.replace("_", "."): position for name, position in positions.items()}
    causes = unknown or {}
    known = {name: position for name, position in {**REST, **moved}.items() if name not in causes}
    return observe_zones(FLEET, ZONES, known, causes)


def rules_of(state: ZoneState) -> dict[str, RuleReading]:
    return {rule.rule: rule for rule in state.rules}


@pytest.mark.parametrize("direction", ["x", "y", "z"])
@pytest.mark.parametrize(
    ("fields", "edges"),
    [
        ({"box": [10, 20, 30]}, 12),
        ({"cylinder": {"radius": 5, "height": 40}}, 48),
        ({"polygon": {"corners": [[-10, -10], [60, -10], [60, 10]], "height": 20}}, 9),
        ({"sphere": 7}, 0),
    ],
)
def test_an_outline_reaches_as_far_as_its_shape(fields: dict[str, object], edges: int, direction: str) -> None:
    """In every direction, with what a polygon instead of a circle leaves out."""
    spec = ZoneShape.model_validate({**fields, "direction": direction, "at": [1, -2, 3]})
    wire, shape = make_wire(spec), make_shape(spec)
    assert len(wire.edges) == edges
    corners = np.asarray(wire.corners)
    left_out = 5 * (1 - math.cos(math.pi / 24)) if "cylinder" in fields else 0.0
    for way in np.random.default_rng(1).normal(size=(200, 3)):
        toward = way / np.linalg.norm(way)
        reach = float(np.max(corners @ toward)) + wire.radius
        support = float(np.dot(shape.find_support(tuple(toward)), toward))
        assert support - left_out - 1e-9 <= reach <= support + 1e-9


def test_bodies_are_where_their_axes_have_brought_them() -> None:
    state = observe(gantry_x=100, gantry_z=20, stage_u=10, stage_phi=90)
    detector, sample = (np.asarray(state.bodies[name].corners) for name in ("detector", "sample"))
    assert detector.mean(axis=0) == pytest.approx([100, 0, 100])
    # Along x from -10 to 60 before, now along y, about x = 210.
    assert sample.min(axis=0) == pytest.approx([200, -10, 30], abs=2e-3)
    assert sample.max(axis=0) == pytest.approx([220, 60, 50], abs=2e-3)
    assert state.ways["gantry.z"] == (0.0, 0.0, 1.0) and "stage.phi" not in state.ways


def test_rules_say_what_holds_and_what_is_broken() -> None:
    near = rules_of(observe(gantry_x=150, stage_phi=30))
    assert near["detector-sample"].holds is True and near["detector-sample"].least == 5
    assert near["detector-sample"].distance == pytest.approx(6.34, abs=0.01)
    assert near["column"].bodies == ["detector", "column"]
    assert near["low-detector"].distance is None and near["low-detector"].bodies == []
    broken = rules_of(observe(gantry_x=158, stage_phi=50))
    assert [name for name, rule in broken.items() if rule.holds is False] == ["detector-sample", "low-detector"]


def test_what_an_unknown_axis_may_do_is_said() -> None:
    state = observe({"stage.phi": "not referenced"}, gantry_z=150)
    rules = rules_of(state)
    assert rules["low-detector"].holds is True  # wherever it is: the detector is high
    assert rules["detector-carriage"].holds is True and rules["detector-carriage"].distance is not None
    assert "stage.phi (not referenced) may be anywhere in its range, and the rule holds" in rules["low-detector"].text
    assert not state.bodies["sample"].certain and state.bodies["carriage"].certain
    low = rules_of(observe({"stage.phi": "offline"}))["low-detector"]
    assert low.holds is None and low.text == "stage.phi (offline) may be anywhere in its range"


def test_a_hull_has_its_corners_alone() -> None:
    spots = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [1, 1], [1, 0]], dtype=float)
    assert sorted(map(tuple, find_hull(spots).tolist())) == [(0, 0), (0, 2), (2, 0), (2, 2)]
