"""How virtual axes are jogged: rates, highest speeds, accelerations and ways to soft limits, from the fleet file and the
states of the real axes."""

from collections.abc import Mapping
from typing import Any

import pytest
from cluster.worlds import EXAMPLES
from pydantic import ValidationError

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.operation.virtual_jog import STEP_S, RealJog, VirtualJog, find_jogs
from orchestrator.model.state import AxisState
from orchestrator.model.virtual_axes import VirtualAxis

APART_S = 0.075


def make_state(position: float, *, referenced: bool = True, offset: int = 0) -> AxisState:
    return AxisState(
        position=position,
        commanded=position,
        velocity=0.0,
        motor_position=position - offset,
        raw_counts=0.0,
        commanded_counts=0,
        offset=offset,  # type: ignore[arg-type]
        unit="mm",
        moving=False,
        enabled=True,
        referenced=referenced,
    )


def find(group: str, states: list[AxisState], fleet: Fleet | None = None, **jog: Any) -> Mapping[str, VirtualJog]:
    """The jogs of a group of the example. jog: settings of its last axis."""
    fleet = fleet or load_fleet(EXAMPLES / "table.fleet.yaml")
    virtual_map, axes = fleet.virtual_axes.maps[group], dict(fleet.virtual[group].axes)
    if jog:
        name = list(axes)[-1]
        axes[name] = VirtualAxis.model_validate({**axes[name].to_plain(), "jog": jog})
    reals = [RealJog(name, fleet.axis(name), state) for name, state in zip(virtual_map.real, states, strict=True)]
    return find_jogs(virtual_map, axes, reals, APART_S)


def test_rates_are_those_of_the_others_at_rest() -> None:
    jogs = find("table", [make_state(0.0)] * 3)
    assert jogs["height"].rates == [1.0, 1.0, 1.0]
    assert jogs["pitch"].rates == pytest.approx([0.3, -0.15, -0.15])  # mm per mrad, at 300, -150 and -150 mm
    assert jogs["roll"].rates == pytest.approx([0.0, -0.25, 0.25])
    assert [jog.acceleration for jog in jogs.values()] == pytest.approx([50, 50 / 0.3, 50 / 0.25])


def test_the_speed_is_that_of_its_own_its_real_axes_and_the_deviation_of_the_others() -> None:
    gap = find("slit", [make_state(0.0)] * 2)["gap"]
    assert gap.speed == 10.0  # blades jog at 5 mm/s, a quarter of their limit
    assert gap.off == pytest.approx({"centre": 10.0 * 0.5 * (STEP_S / 2 + APART_S)})
    assert gap.drift == pytest.approx({"centre": 2 / 10_000 + 1e-4 * 5.0})
    limited = find("slit", [make_state(0.0)] * 2, deviation="20 um")["gap"]
    assert limited.off == pytest.approx({"centre": 0.010})  # half of it
    assert limited.speed == pytest.approx(0.2) and limited.deviations == {"centre": 0.02}
    assert find("slit", [make_state(0.0)] * 2, speed="30 mm/min")["centre"].speed == 0.5
    slow = find("slit", [make_state(0.0), make_state(0.0, referenced=False)])["gap"]
    assert slow.speed == pytest.approx(2 * 20 / 50)


def test_play_and_errors_of_real_axes_are_part_of_how_far_others_are_off() -> None:
    plain = load_fleet(EXAMPLES / "table.fleet.yaml").to_plain()
    plain["controllers"]["front"]["axes"]["upper"]["backlash"] = {"amount": "20 um"}
    fleet, states = Fleet.model_validate(plain), [make_state(0.0)] * 2
    gap = find("slit", states, fleet)["gap"]
    assert gap.play == pytest.approx({"centre": 0.5 * 0.020})  # half of one blade's
    assert not find("slit", states)["gap"].play
    # What is left of the deviation beside the play decides the speed.
    assert find("slit", states, fleet, deviation="20 um")["gap"].speed == pytest.approx(0.1)
    assert find("slit", states, fleet, deviation="10 um")["gap"].speed == 0


def test_the_way_ends_at_the_first_soft_limit_of_any_axis() -> None:
    # Blades at 12 and 10 mm, of -20 to 20 mm; the gap is 2 of 0 to 10 mm.
    jogs = find("slit", [make_state(12.0), make_state(10.0)])
    assert (jogs["gap"].low, jogs["gap"].low_by) == (-2.0, "slit.gap")
    assert (jogs["gap"].high, jogs["gap"].high_by) == (8.0, "slit.gap")
    assert (jogs["centre"].low, jogs["centre"].low_by) == (-30.0, "front.lower")
    assert (jogs["centre"].high, jogs["centre"].high_by) == (8.0, "front.upper")
    # Soft limits are motor positions.
    shifted = find("slit", [make_state(12.0, offset=5), make_state(10.0)])["centre"]
    assert (shifted.high, shifted.high_by) == (10.0, "front.lower")
    unreferenced = find("slit", [make_state(12.0, referenced=False), make_state(10.0)])["centre"]
    assert (unreferenced.high, unreferenced.high_by) == (10.0, "front.lower")
    beyond = find("slit", [make_state(12.0), make_state(13.0)])["gap"]
    assert (beyond.low, beyond.high) == (0.0, 11.0), "back inside it may go"


@pytest.mark.parametrize(
    ("jog", "text"),
    [
        ({"deviation": "3 mm/s"}, "mm/s"),
        ({"deviation": 0}, "greater than 0"),
        ({"speed": "3 deg/s"}, "deg"),
        ({"slow_speed": 1}, "slow_speed"),
    ],
)
def test_settings_that_mean_nothing_are_refused(jog: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        VirtualAxis.model_validate({"unit": "mm", "jog": jog})
