"""The common ramp of jogged virtual axes: no real axis is asked for too much, and all of them start and stop together."""

import random
from typing import Any

import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.operation.virtual_jog import STEP_S, VirtualJog
from orchestrator.model.operation.virtual_ramp import FIRST_SHARE, VirtualRamp
from orchestrator.model.operation.virtual_state import VirtualAxisState, VirtualState

REALS = ("front.a", "left.b")
ACCELERATIONS = (50.0, 20.0)
RATES = {"gap": (0.5, -0.5), "centre": (1.0, 1.0)}


def make_state(**changes: Any) -> VirtualState:
    """A slit of two blades that accelerate by 50 and 20 mm/s². changes: of how its gap is jogged."""
    jogs = {
        name: VirtualJog(
            rates=list(rates),
            speed=10.0,
            acceleration=min(a / abs(rate) for a, rate in zip(ACCELERATIONS, rates, strict=True)),
            off={other: 0.2 for other in RATES if other != name},
            drift={other: 0.01 for other in RATES if other != name},
            deviations={},
        )
        for name, rates in RATES.items()
    }
    jogs["gap"] = jogs["gap"].model_copy(update=changes)
    axis = VirtualAxisState(position=0, low=0, high=0, target=0, velocity=0, unit="mm")
    return VirtualState(
        group="slit",
        of=list(REALS),
        axes=dict.fromkeys(RATES, axis),
        jogs=jogs,
        moving=False,
        enabled=True,
        referenced=True,
        obstacle="",
        fleet_ns=None,
    )


def make_ramp(**changes: Any) -> VirtualRamp:
    return VirtualRamp({"slit": make_state(**changes)})


def run_until_settled(ramp: VirtualRamp, elapsed_s: float = STEP_S) -> list[dict[str, float]]:
    """Take steps to the end of the ramp; it must have one."""
    steps = [ramp.step(elapsed_s)]
    while not ramp.is_settled:
        steps.append(ramp.step(elapsed_s))
        assert len(steps) < 1000
    return steps


def test_a_jog_is_one_proportion_of_its_real_axes() -> None:
    ramp = make_ramp()
    ramp.request({"slit.gap": 10.0})
    steps = run_until_settled(ramp)
    assert steps[-1] == {"front.a": 5.0, "left.b": -5.0}
    assert all(step["front.a"] == -step["left.b"] for step in steps)
    # 5 mm/s by 20 mm/s²: a short first step, then 5 of one size, at most 1 mm/s each 50 ms.
    assert [step["front.a"] for step in steps] == pytest.approx([FIRST_SHARE, 1.08, 2.06, 3.04, 4.02, 5.0])
    ramp.request_rest()
    assert [step["front.a"] for step in run_until_settled(ramp)] == pytest.approx([4.0, 3.0, 2.0, 1.0, 0.0])
    assert not ramp.is_moving


@pytest.mark.parametrize("seed", range(50))
def test_no_step_asks_a_real_axis_for_more_than_its_acceleration(seed: int) -> None:
    rng = random.Random(seed)
    ramp, present = make_ramp(), dict.fromkeys(REALS, 0.0)
    for _ in range(20):
        ramp.request({"slit.gap": rng.uniform(-5, 5), "slit.centre": rng.choice([0.0, rng.uniform(-5, 5)])})
        for _ in range(rng.randint(1, 40)):
            was_moving = ramp.is_moving
            elapsed_s = rng.uniform(0, 0.2)
            velocities = {**dict.fromkeys(REALS, 0.0), **ramp.step(elapsed_s)}
            for axis, acceleration in zip(REALS, ACCELERATIONS, strict=True):
                change = abs(velocities[axis] - present[axis])
                assert change <= acceleration * STEP_S * (1 + 1e-9)
                # Directions change only where all axes rest.
                assert velocities[axis] * present[axis] >= 0 or not was_moving
            present = velocities


def test_another_direction_is_reached_through_rest() -> None:
    ramp = make_ramp()
    ramp.request({"slit.gap": 2.0})
    run_until_settled(ramp)
    ramp.request({"slit.gap": 0.0, "slit.centre": 1.0})
    steps = run_until_settled(ramp)
    assert {"front.a": 0.0, "left.b": 0.0} in steps
    assert steps[-1] == {"front.a": 1.0, "left.b": 1.0}


def test_speeds_above_the_stated_ones_are_refused_with_both_numbers() -> None:
    ramp = make_ramp()
    text = r"slit\.gap may jog at 10 mm/s at most, where slit\.centre is off by at most 0\.2 mm, not at 10\.1"
    with pytest.raises(Refusal, match=text):
        ramp.request({"slit.gap": -10.1})
    ramp.request({"slit.gap": 6.0})
    with pytest.raises(Refusal, match=r"slit\.centre may jog .* together with slit\.gap"):
        ramp.request({"slit.centre": 5.0})
    assert ramp.wanted == {"slit.gap": 6.0}


def test_it_slows_down_before_a_soft_limit_and_is_refused_at_it() -> None:
    """A way of 5 mm, by states that are two steps old; the other direction stays possible."""
    ramp = make_ramp()
    ramp.request({"slit.gap": 10.0})
    positions = [0.0, 0.0, 0.0]
    with pytest.raises(Refusal, match=r"slit\.gap is at the soft limit of front\.a"):
        for _ in range(1000):
            ramp.states["slit"] = make_state(high=5.0 - positions[-3], high_by="front.a")
            positions.append(positions[-1] + 2 * ramp.step(STEP_S)["front.a"] * STEP_S)
    assert 4.8 < positions[-1] < 5.0
    ramp.clear()
    with pytest.raises(Refusal, match="soft limit"):
        ramp.request({"slit.gap": 10.0})
    ramp.request({"slit.gap": -10.0})


def test_a_jog_ends_before_a_deviation_is_exceeded() -> None:
    """0.2 mm for each rise to 10 mm/s and back to rest, 0.01 mm a second; 0.5 mm are allowed."""
    ramp = make_ramp(deviations={"centre": 0.5})
    ramp.request({"slit.gap": 10.0})
    run_until_settled(ramp)
    seconds = 0.0
    with pytest.raises(Refusal, match=r"slit\.centre might be off its position by 0\.5 mm") as refusal:
        for _ in range(1000):
            ramp.step(STEP_S)
            seconds += STEP_S
    assert refusal.value.code == "deviation"
    assert seconds == pytest.approx(30, abs=1)
    ramp.request_rest()
    run_until_settled(ramp)  # coming to rest is never refused
    for _ in range(3):  # each jog has the whole of it
        ramp.request({"slit.gap": 10.0})
        run_until_settled(ramp)
        ramp.request_rest()
        run_until_settled(ramp)
    ramp.request({"slit.gap": 10.0})
    run_until_settled(ramp)
    with pytest.raises(Refusal, match="might be off"):
        for velocity in (1.0, 10.0, 1.0, 10.0):
            ramp.request({"slit.gap": velocity})
            run_until_settled(ramp)


def test_a_lone_real_axis_needs_no_ramp() -> None:
    """Its controller may change a speed only at rest."""
    state = make_state().model_copy(update={"of": ["front.a"]})
    jogs = {"gap": state.jogs["gap"].model_copy(update={"rates": [2.0]})}
    ramp = VirtualRamp({"slit": state.model_copy(update={"jogs": jogs})})
    ramp.request({"slit.gap": 1.0})
    assert ramp.step(0.0) == {"front.a": 2.0} and ramp.is_settled


def test_what_has_no_jog_is_refused_with_the_reason() -> None:
    state = make_state()
    ramp = VirtualRamp({"slit": state.model_copy(update={"jogs": {}})})
    with pytest.raises(Refusal, match="its group is curved"):
        ramp.request({"slit.gap": 1.0})
    offline = state.model_copy(update={"jogs": {}, "axes": {}, "obstacle": "front is offline"})
    with pytest.raises(Refusal, match="front is offline"):
        VirtualRamp({"slit": offline}).request({"slit.gap": 1.0})
