"""Triggers of the SHRC-203 by drive pulses: instants against the executed move, and what is refused."""

from dataclasses import replace
from random import Random
from typing import Any

import pytest
from unit.adapters.test_shrc203_lowering import controller, wire

from adapters.shrc203 import MAKE
from adapters.shrc203.lowering import ShrcLowered, lower_step
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.pulses import require_trigger
from adapters.shrc203.triggers import add_trigger
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import OutputTrigger, StartOptions, TriggerDrive
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from orchestrator.plan.triggers import ResolvedTrigger

OUTPUTS = {"camera": {"number": 7}, "lamp": {"number": 2}}


def make_config(**outputs: Any) -> Controller:
    return Controller.model_validate({**controller().model_dump(by_alias=True), "outputs": {**OUTPUTS, **outputs}})


def lower(profile: Profile, interval: float, output: str = "camera", loop: frozenset[int] = frozenset()) -> ShrcLowered:
    plan = plan_step([AxisMove("s.x", profile.start_counts, profile.end_counts, 50_000, 500_000)])
    instants = ResolvedTrigger(0, f"s.{output}", 10_000, "s.x", step_counts=interval).find_instants_ns(plan)
    asked = OutputTrigger(output=output, axis="x", instants_ns=instants, pulse_ns=10_000)
    options, config, profiles = ShrcOptions(), make_config(), {"x": plan.profiles["s.x"]}
    traits = replace(wire(options, 260_000), closed_loop=loop, pulsed="x")
    require_trigger(config, options, profiles, [asked])
    step = lower_step(config, options, traits, profiles, StartOptions(triggers=[asked]))
    return add_trigger(step, config, options, traits, (asked, profiles["x"]))


def make_profile(distance: int) -> Profile:
    return plan_step([AxisMove("x", 0, distance, 50_000, 500_000)]).profiles["x"]


def test_every_pulse_is_between_the_drive_pulses_beside_its_place() -> None:
    draw = Random(3)
    for _ in range(40):
        distance, interval = draw.choice((1, -1)) * draw.randint(200, 100_000), draw.randint(50, 5000)
        if interval > abs(distance):
            continue
        lowered = lower(make_profile(distance), interval)
        trigger, (move,) = lowered.trigger, lowered.moves
        assert trigger is not None and trigger.command == f"T:P1P{interval}" == lowered.commands[0]
        assert len(trigger.spans_s) == abs(distance) // interval
        clock_s, covered, legs = 0.0, 0.0, list(move.running_shape.motion_legs)
        for number, (early, late) in enumerate(trigger.spans_s, 1):
            for at_s, place in ((early, number * interval - 1), (late, number * interval + 1)):
                clock_s, covered = 0.0, 0.0
                for duration, speed, acceleration in legs:
                    t = min(max(at_s - clock_s, 0.0), duration)
                    covered += t * (speed + t * acceleration / 2)
                    clock_s += duration
                assert covered == pytest.approx(min(place, abs(distance)), abs=1e-3)
        early_ns, late_ns = lowered.triggers["camera"][0].earliest_ns, lowered.triggers["camera"][-1].latest_ns
        assert early_ns <= 0 < late_ns < NS_PER_S


@pytest.mark.parametrize(
    ("distance", "interval", "output", "code"),
    [
        (10_000, 33.3, "camera", "trigger-positions"),
        (10_000, 1, "camera", "trigger-positions"),
        (200_000, 30_001, "camera", "trigger-positions"),
        (10_000, 100, "lamp", "no-triggers"),
    ],
)
def test_what_it_cannot_count_is_refused(distance: int, interval: float, output: str, code: str) -> None:
    with pytest.raises(Refusal) as refused:
        lower(make_profile(distance), interval, output)
    assert refused.value.code == code


def test_it_is_refused_in_closed_loop_and_for_what_needs_a_level() -> None:
    with pytest.raises(Refusal) as refused:
        lower(make_profile(1000), 100, loop=frozenset({1}))
    assert refused.value.code == "trigger-loop"
    drive = StartOptions(drive=TriggerDrive(output="camera"))
    with pytest.raises(Refusal, match="gives pulses only"):
        lower_step(make_config(), ShrcOptions(), wire(ShrcOptions(), 260_000), {}, drive)
    MAKE.check_config(make_config())
    for wrong in ({"number": 8}, {"number": 7, "safe": False}):
        with pytest.raises(ValueError, match="trigger output"):
            MAKE.check_config(make_config(other=wrong))
