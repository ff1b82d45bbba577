"""Steps and rules: what is called clear is clear after any single stop, by a model of stops of its own."""

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.profile import Profile
from orchestrator.plan.step import StepPlan, plan_step
from orchestrator.plan.targets import make_axis_move
from orchestrator.plan.zones import search
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.clearance import PairClearance
from orchestrator.plan.zones.course import Course, Sweep, Timing
from orchestrator.plan.zones.refusals import make_refusal
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import RuleCheck, find_rule_violation

EXAMPLE = Path(__file__).parents[4] / "deploy" / "examples" / "zones.fleet.yaml"
ALONE = {"gantry": 1.2, "stage": None}
REST = {"gantry.x": 0.0, "gantry.z": 0.0, "stage.u": 0.0, "stage.phi": 0.0}
FLEET = load_fleet(EXAMPLE)
ZONES = FleetZones(FLEET)
DETECTOR_SAMPLE = next(rule for rule in ZONES.rules if rule.name == "detector-sample")
ALONE_S = 1.2


def plan(ways: Mapping[str, tuple[float, float]], speed: float = 1.0, fleet: Fleet = FLEET) -> StepPlan:
    moves = [
        make_axis_move(name, axis, axis.to_counts(Fraction(begin)), axis.to_counts(Fraction(end)), 2)
        for name, (begin, end) in ways.items()
        for axis in [fleet.axis(name)]
    ]
    return plan_step(moves, "time", speed, "common")


def make_course(
    ways: Mapping[str, tuple[float, float]],
    alone: Mapping[str, float | None] = ALONE,
    zones: FleetZones = ZONES,
    **standing: float,
) -> Course:
    others = {**REST, **{name.replace("_", "."): position for name, position in standing.items()}}
    positions = {name: (position, position) for name, position in others.items() if name not in ways}
    return zones.make_course(Sweep(plan(ways).profiles, positions, Timing(alone)))


def changed_zones(**rule: Any) -> FleetZones:
    """The example with fields of the rule detector-sample replaced."""
    plain = FLEET.to_plain()
    plain["zones"]["rules"] = {"detector-sample": {**plain["zones"]["rules"]["detector-sample"], **rule}}
    return FleetZones(Fleet.model_validate(plain))


# A model of stops


@dataclass(frozen=True, slots=True)
class Stop:
    """One axis stops at an instant, at once or by a ramp; the others brake `wait_s` later."""

    axis: str
    instant_s: float
    wait_s: float
    at_once: bool


def draw_stops(draw: random.Random, step: StepPlan, count: int) -> Iterator[Stop]:
    for _ in range(count):
        wait_s = draw.choice([0.0, ALONE_S, draw.uniform(0.0, ALONE_S)])
        instant_s = draw.choice([0.0, draw.uniform(0.0, step.duration_s)])
        yield Stop(draw.choice(list(step.profiles)), instant_s, wait_s, draw.random() < 0.5)


def find_place(profile: Profile, brake_s: float, time_s: float, *, at_once: bool) -> float:
    """The counts at an instant of an axis that follows its profile until `brake_s`, and brakes with its ramp then."""
    state = profile.state_at(min(time_s, brake_s))
    if time_s <= brake_s or at_once or not state.velocity:
        return profile.start_counts + state.position
    ramp = profile.peak_acceleration
    braking_s = min(time_s - brake_s, abs(state.velocity) / ramp)
    way = abs(state.velocity) * braking_s - ramp * braking_s**2 / 2
    return profile.start_counts + state.position + (way if state.velocity > 0 else -way)


def find_nearest(
    zones: FleetZones, rule: RuleCheck, step: StepPlan, standing: Mapping[str, float], stop: Stop
) -> float:
    """The smallest distance of the rule's bodies in a step with one stop, at many instants."""
    assert isinstance(rule.constraint, PairClearance)
    end_s, nearest = step.duration_s + 4.0, 1e9
    for number in range(61):
        time_s = end_s * number / 60
        positions = dict(standing)
        for name, profile in step.profiles.items():
            is_first = name == stop.axis
            brake_s = stop.instant_s + (0.0 if is_first else stop.wait_s)
            counts = find_place(profile, brake_s, time_s, at_once=is_first and stop.at_once)
            positions[name] = FLEET.axis(name).to_unit(counts)
        nearest = min(nearest, rule.constraint.find_distance(positions)[1])
    return nearest


def draw_step(draw: random.Random) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Ways of two or three axes, past each other, and where the other ones stand."""
    begins = {
        "gantry.x": draw.uniform(0, 400),
        "gantry.z": draw.choice([0.0, draw.uniform(0, 60)]),
        "stage.u": draw.uniform(0, 50),
        "stage.phi": draw.choice([0.0, draw.uniform(-90, 90)]),
    }
    ends = {
        "gantry.x": draw.uniform(0, 400),
        "gantry.z": draw.uniform(0, 60),
        "stage.u": draw.uniform(0, 50),
        "stage.phi": draw.uniform(-90, 90),
    }
    axes = draw.sample(list(begins), draw.randrange(2, 4))
    return {name: (begins[name], ends[name]) for name in axes}, begins


def test_what_is_clear_is_clear_after_every_single_stop() -> None:
    draw = random.Random(575)
    clear = 0
    for _ in range(60):
        ways, standing = draw_step(draw)
        step = plan(ways)
        positions = {name: (standing[name], standing[name]) for name in standing if name not in ways}
        course = ZONES.make_course(Sweep(step.profiles, positions, Timing({"gantry": ALONE_S, "stage": ALONE_S})))
        if find_rule_violation(DETECTOR_SAMPLE, course) is None:
            clear += 1
            for stop in draw_stops(draw, step, 5):
                assert find_nearest(ZONES, DETECTOR_SAMPLE, step, standing, stop) >= 5.0 - 1e-4, (ways, standing, stop)
    assert 10 < clear < 50


def test_a_stop_of_one_axis_breaks_what_holds_in_step_and_is_refused_unless_it_is_trusted() -> None:
    """The detector rises in time to pass over the sample; if it stops rising, it runs into it."""
    ways = {"gantry.x": (0.0, 300.0), "gantry.z": (0.0, 100.0)}
    step, stop = plan(ways), Stop("gantry.z", 0.45, ALONE_S, at_once=True)
    assert find_nearest(ZONES, DETECTOR_SAMPLE, step, REST, Stop("gantry.z", 99.0, 0.0, at_once=False)) > 5
    assert find_nearest(ZONES, DETECTOR_SAMPLE, step, REST, stop) < 5
    course = make_course(ways)
    violation = find_rule_violation(DETECTOR_SAMPLE, course)
    assert violation is not None
    refusal = make_refusal(ZONES, course, violation)
    assert refusal.code == "zone" and "where one of them stops and the others go on" in refusal.text
    assert "move gantry.z, then gantry.x, each in a step of its own" in refusal.remedy
    assert "`trust_step: true`" in refusal.remedy
    trusting = changed_zones(trust_step=True)
    assert trusting.is_clear(make_course(ways, zones=trusting))


def test_an_axis_without_a_watchdog_may_go_on_to_its_end() -> None:
    ways = {"gantry.x": (0.0, 300.0), "gantry.z": (49.0, 100.0)}
    assert find_rule_violation(DETECTOR_SAMPLE, make_course(ways, {"gantry": 1.0})) is None
    low_ways = {"gantry.x": (0.0, 300.0), "gantry.z": (8.0, 100.0)}
    slow = make_course(low_ways, {"gantry": 0.1}).stretch(6.0)
    assert find_rule_violation(DETECTOR_SAMPLE, slow) is None
    endless = make_course(low_ways, {"gantry": None}).stretch(6.0)
    assert find_rule_violation(DETECTOR_SAMPLE, endless) is not None


def test_a_step_that_does_not_move_the_bodies_of_a_rule_is_not_refused_for_it() -> None:
    """However they stand: another step has brought them there."""
    together = make_course({"stage.u": (0.0, 1.0)}, gantry_x=200.0)
    assert find_rule_violation(DETECTOR_SAMPLE, together) is not None
    low_detector = next(rule for rule in ZONES.rules if rule.name == "low-detector")
    assert low_detector not in [violation.rule for violation in ZONES.find_violations(together)]
    assert (
        "jog gantry.z by about 17 mm in the positive"
        in make_refusal(ZONES, together, next(ZONES.find_violations(together))).remedy
    )


@pytest.mark.parametrize(("end", "clear"), [(154.4, True), (154.6, False)])
def test_uncertainty_of_a_position_counts(end: float, clear: bool) -> None:
    """At 155 mm the bodies are 5 mm apart; the following error is 0.5 mm, and a count 0.001 mm."""
    assert (find_rule_violation(DETECTOR_SAMPLE, make_course({"gantry.x": (0.0, end)})) is None) == clear


@pytest.mark.parametrize(("z", "phi", "clear"), [(13.0, 80.0, True), (11.0, 80.0, False), (11.0, 44.0, True)])
def test_a_relation_holds_with_its_hysteresis(z: float, phi: float, clear: bool) -> None:
    rule = next(rule for rule in ZONES.rules if rule.name == "low-detector")
    course = make_course({"stage.phi": (0.0, phi)}, gantry_z=z)
    assert (find_rule_violation(rule, course) is None) == clear


def test_what_cannot_be_decided_is_refused_with_the_nearest_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    course = make_course({"gantry.x": (0.0, 150.0), "stage.phi": (0.0, 30.0)})
    assert find_rule_violation(DETECTOR_SAMPLE, course) is None
    monkeypatch.setattr(search, "MAX_LOOKS", 1)
    violation = find_rule_violation(DETECTOR_SAMPLE, course)
    assert violation is not None and violation.positions is None
    assert "cannot be decided within" in make_refusal(ZONES, course, violation).text


def test_what_a_step_allows_between_members_counts_with_a_rule_that_trusts_it() -> None:
    """Half a second late, the detector is at the sample before it is high enough."""
    ways = {"gantry.x": (0.0, 300.0), "gantry.z": (0.0, 46.5)}
    trusting = changed_zones(trust_step=True)
    positions: Box = dict.fromkeys(["stage.u", "stage.phi"], (0.0, 0.0))
    profiles = plan(ways).profiles
    assert trusting.is_clear(trusting.make_course(Sweep(profiles, positions, Timing(ALONE, 0.01))))
    assert not trusting.is_clear(trusting.make_course(Sweep(profiles, positions, Timing(ALONE, 0.5))))


def test_few_steps_are_refused_that_dense_samples_of_the_same_places_would_allow() -> None:
    """At most one in twenty: bounds are not so wide that only far bodies pass."""
    draw, refused, unconfirmed = random.Random(576), 0, 0
    constraint = DETECTOR_SAMPLE.constraint
    for _ in range(120):
        ways, standing = draw_step(draw)
        positions = {name: (standing[name], standing[name]) for name in standing if name not in ways}
        course = ZONES.make_course(Sweep(plan(ways).profiles, positions, Timing({"gantry": ALONE_S, "stage": ALONE_S})))
        if find_rule_violation(DETECTOR_SAMPLE, course) is not None:
            refused += 1
            unconfirmed += not any(
                constraint.look({axis: (place, place) for axis, place in places.items()}).holds is False
                for places in draw_places(draw, course, constraint.axes)
            )
    assert refused > 30 and unconfirmed <= refused / 20


def draw_places(draw: random.Random, course: Course, axes: Sequence[str]) -> Iterator[dict[str, float]]:
    """Where axes can be together at many instants of a step, often at the ends of their ranges."""
    for number in range(41):
        instant_s = course.duration_s * number / 40
        box = course.find_box(axes, instant_s, instant_s, trust_step=False)
        for _ in range(20):
            yield {axis: draw.choice([low, high, draw.uniform(low, high)]) for axis, (low, high) in box.items()}
