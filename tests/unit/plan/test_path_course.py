"""Chunks of paths: continuous with each other, within the limits, and braked on the path."""

from itertools import pairwise
from random import Random

import numpy as np
import pytest

from orchestrator.model.errors import Refusal
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_course import MOST_USE, SWITCH_S, ChunkPlan, PathCourse
from orchestrator.plan.path_profiles import Array, FittedAxis, FittedMotion, PathStates, fit_profiles

COUNTS, SPEED, ACCELERATION, JERK = 1000.0, 200.0, 1000.0, 20_000.0
RADIUS = 50.0
STEP_S = 1e-3


def make_course(turns: float = 4.0, speed: float = 100.0) -> PathCourse:
    """A circle at a constant speed, with ramps of a second at both ends, from where the axes stand at 7 and -3 counts."""
    way = 2 * np.pi * RADIUS * turns
    duration_s = way / speed + 1.0

    def evaluate(times_s: Array) -> PathStates:
        # A ramp of the speed in a second: 3u² - 2u³.
        def rise(t: Array) -> tuple[Array, Array, Array]:
            u = np.clip(t, 0.0, 1.0)
            late = np.clip(t - 1.0, 0.0, None)
            return speed * (u**3 - u**4 / 2 + late), speed * u**2 * (3 - 2 * u), speed * 6 * u * (1 - u)

        s1, v1, a1 = rise(times_s)
        s2, v2, a2 = rise(duration_s - times_s)
        front = times_s < duration_s / 2
        s = np.where(front, s1, way - s2)
        v, a = np.where(front, v1, v2), np.where(front, a1, -a2)
        angle = s / RADIUS
        radial, tangent = np.stack([np.cos(angle), np.sin(angle)], 1), np.stack([-np.sin(angle), np.cos(angle)], 1)
        return PathStates(
            RADIUS * radial, tangent * v[:, None], tangent * a[:, None] - radial * (v**2 / RADIUS)[:, None]
        )

    axes = [
        FittedAxis("a.x", COUNTS, SPEED, ACCELERATION, 7, 7, JERK),
        FittedAxis("b.y", -COUNTS, SPEED, ACCELERATION, -3, -3, JERK),
    ]
    fitted = fit_profiles(evaluate, duration_s, axes, 0.1)
    motion: FittedMotion = fitted.motion
    return PathCourse(motion, axes, [0, 1], motion.positions[0], 0.005)


def list_chunks(course: PathCourse, clock: PathClock, most_s: float) -> list[ChunkPlan]:
    chunks = [course.plan_chunk(clock, 0.0, most_s)]
    while not chunks[-1].last:
        chunks.append(course.plan_chunk(clock, chunks[-1].end_s - SWITCH_S, most_s))
    return chunks


def sample(chunk: ChunkPlan, times_s: Array) -> Array:
    """Positions of both axes at instants of the motion, counts."""
    evaluators = [profile.make_evaluator() for profile in chunk.profiles.values()]
    return np.array([[at(t - chunk.begin_s).position for at in evaluators] for t in times_s.tolist()])


def find_radii(course: PathCourse, counts: Array) -> Array:
    x, y = (counts[:, k] / course.axes[k].counts_per_unit + course.origin[k] for k in range(2))
    return np.hypot(x, y)


@pytest.mark.parametrize("most_s", [2.0, 5.0, 7.5])
def test_neighbouring_chunks_are_the_same_motion_where_members_change_over(most_s: float) -> None:
    course = make_course()
    chunks = list_chunks(course, course.begin_at(0.0), most_s)
    assert len(chunks) > 1 and all(chunk.stop_s - chunk.begin_s <= most_s + 1e-9 for chunk in chunks)
    for before, after in pairwise(chunks):
        assert after.begin_s == pytest.approx(before.end_s - SWITCH_S)
        times_s = np.linspace(after.begin_s, before.end_s, 50)
        assert np.abs(sample(before, times_s) - sample(after, times_s)).max() < 0.01
    assert chunks[-1].stop_s == pytest.approx(course.duration_s)
    assert [profile.end_counts for profile in chunks[-1].profiles.values()] == [7, -3]


def test_every_stopping_tail_brakes_on_the_path_and_within_the_limits() -> None:
    course = make_course()
    for chunk in list_chunks(course, course.begin_at(0.0), 4.0):
        times_s = np.arange(chunk.end_s, chunk.stop_s, STEP_S)
        if len(times_s):
            assert np.abs(find_radii(course, sample(chunk, times_s)) - RADIUS).max() < 0.006
        for profile in chunk.profiles.values():
            assert profile.peak_velocity <= SPEED * COUNTS * (1 + 1e-9)
            assert profile.peak_acceleration <= ACCELERATION * COUNTS * (1 + 1e-9)
            off_counts, off_counts_s = profile.end_error
            assert off_counts <= 0.5 and off_counts_s <= 1.0


@pytest.mark.parametrize("seed", range(6))
def test_holds_and_overrides_stay_on_the_path(seed: int) -> None:
    draw, course = Random(seed), make_course(8.0)
    clock = course.begin_at(0.0)
    for _ in range(3):
        at_s = clock.ramps[-1].end_s + draw.uniform(0.5, 3.0)
        rate = draw.choice((0.1, 0.4, 0.8, 1.0))
        clock = course.change_rate(clock, at_s, rate) if rate != clock.rate else clock
    clock = course.brake(clock, clock.ramps[-1].end_s + 1.0)
    chunk = course.plan_stop(clock, 0.0)
    radii = find_radii(course, sample(chunk, np.arange(0.0, chunk.stop_s, 5e-3)))
    assert np.abs(radii - RADIUS).max() < 0.006
    assert all(p.peak_acceleration <= ACCELERATION * COUNTS * (1 + 1e-9) for p in chunk.profiles.values())
    # From there it goes on: the rest of the path, from rest.
    there = course.motion.evaluate(np.array([chunk.stop_path_s]))[0][0] - course.origin
    counts = {
        axis.name: axis.start_counts + round(axis.counts_per_unit * float(way))
        for axis, way in zip(course.axes, there, strict=True)
    }
    assert {name: profile.end_counts for name, profile in chunk.profiles.items()} == counts
    rest = course.restart(chunk.stop_path_s, counts)
    again = list_chunks(rest, rest.begin_at(chunk.stop_path_s), 7.5)
    assert [profile.end_counts for profile in again[-1].profiles.values()] == [7, -3]
    assert [profile.start_counts for profile in again[0].profiles.values()] == list(counts.values())


def test_a_rate_above_one_ends_before_the_place_that_does_not_allow_it() -> None:
    course = make_course(8.0, speed=100.0)
    course.require_rate(0.0, 1.2)
    clock = course.adapt_rate(course.begin_at(0.0), 2.0, 1.2, 100.0)
    assert [ramp.after for ramp in clock.ramps] == [1.0, 1.2, 1.0]
    times = clock.evaluate(np.arange(0.0, clock.find_instant(course.duration_s), 5e-3))
    _, v, a, _ = course.motion.evaluate(times.path_s)
    accelerations = np.abs(a * times.rates[:, None] ** 2 + v * times.changes[:, None])
    assert times.rates.max() == pytest.approx(1.2) and accelerations.max() <= ACCELERATION * 1.001
    with pytest.raises(Refusal, match="too fast for the rest of the path") as caught:
        course.require_rate(0.0, 5.0)
    assert caught.value.code == "override" and "at most" in caught.value.remedy


def test_a_rate_that_a_place_does_not_allow_is_1_there_from_a_lower_one_too() -> None:
    course = make_course(8.0)
    slow = course.change_rate(course.begin_at(0.0), 2.0, 0.5)
    ends_s = slow.find_instant(course.duration_s)
    clock = course.adapt_rate(slow, ends_s - 1.5, 1.2, 7.5)
    assert [ramp.after for ramp in clock.ramps] == [1.0, 0.5, 1.0]


def test_a_ramp_that_no_place_allows_is_refused() -> None:
    course = make_course()
    with pytest.raises(Refusal, match="no change of speed") as caught:
        course.brake(course.begin_at(0.0), course.duration_s - 0.03)
    assert caught.value.code == "path-ramp"


def test_a_clock_is_smooth_and_integrates_its_rate() -> None:
    clock = PathClock.from_rest(3.0, 0.5).change_rate(2.0, 0.4, 0.8).change_rate(4.0, 0.0, 1.0)
    times_s = np.linspace(0.0, 6.0, 6001)
    times = clock.evaluate(times_s)
    assert times.path_s[0] == 3.0 and times.rates[-1] == 0.0 and (np.diff(times.path_s) >= -1e-12).all()
    middles = (times.rates[1:] + times.rates[:-1]) / 2
    assert np.abs(np.diff(times.path_s) - middles * 1e-3).max() < 1e-8
    assert np.abs(np.diff(times.rates)).max() < 0.004
    assert clock.ramps[-1].end_path_s == pytest.approx(times.path_s[-1])
    assert 0.9 < MOST_USE < 1.0
