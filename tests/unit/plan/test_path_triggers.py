"""Triggers of a path in chunks: each instant belongs to one chunk, at whatever rate the path is played."""

import numpy as np
import pytest
from unit.plan.test_path_course import make_course

from orchestrator.model.profile import Profile
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_course import SWITCH_S, ChunkPlan, PathCourse
from orchestrator.plan.path_triggers import GivenTrigger, PathTrigger
from orchestrator.plan.step import StepPlan
from orchestrator.plan.triggers import ResolvedTrigger, find_crossings

MOST_S = 2.0
EACH_MM = ResolvedTrigger(0, "a.lamp", 1_000_000, axis="a.x", step_counts=1000.0)
EACH_10_MS = ResolvedTrigger(0, "a.lamp", 1_000_000, period_ns=10_000_000)
LEVELS = ResolvedTrigger(0, "a.lamp", 0, axis="a.x", step_counts=10_000.0)


@pytest.fixture(scope="module")
def course() -> PathCourse:
    return make_course(2.0)


def plan_whole(course: PathCourse) -> StepPlan:
    chunk = course.plan_chunk(PathClock.from_rest(0.0, 0.0), 0.0, 1000.0)
    return StepPlan(course.duration_s, chunk.profiles)


def give(course: PathCourse, resolved: ResolvedTrigger, begun_s: float = 0.0, elapsed_ns: int = 0) -> GivenTrigger:
    return GivenTrigger(PathTrigger.of(resolved, plan_whole(course), begun_s, elapsed_ns))


def play(course: PathCourse, given: GivenTrigger, clock: PathClock, chunk: ChunkPlan | None = None) -> ChunkPlan:
    """Give out chunk after chunk to the end; the last one."""
    following = chunk or course.plan_chunk(clock, 0.0, MOST_S)
    given.take_part(following)
    while not following.last:
        following = course.plan_chunk(clock, following.end_s - SWITCH_S, MOST_S)
        given.take_part(following)
    return following


def places_at(course: PathCourse, clock: PathClock, instants_ns: list[int]) -> np.ndarray:
    """Where axis a.x is at instants of the motion, mm from where it started."""
    path_s = clock.evaluate(np.array(instants_ns) / 1e9).path_s
    return course.motion.evaluate(path_s)[0][:, 0] - course.motion.positions[0, 0]


def test_a_clock_tells_when_the_motion_reaches_a_place() -> None:
    clock = PathClock.from_rest(3.0, 0.5).change_rate(2.0, 0.4, 0.8).change_rate(4.0, 1.2, 1.0).change_rate(7.0, 0.0, 1)
    times_s = np.linspace(0.0, 7.9, 1001)
    assert np.abs(clock.find_instants(clock.evaluate(times_s).path_s) - times_s).max() < 1e-6
    assert clock.find_instants(np.array([])).tolist() == []


@pytest.mark.parametrize("resolved", [EACH_MM, EACH_10_MS])
def test_chunks_have_all_instants_of_the_whole_path_once(course: PathCourse, resolved: ResolvedTrigger) -> None:
    given = give(course, resolved)
    play(course, given, course.begin_at(0.0))
    whole = resolved.find_instants_ns(plan_whole(course))
    assert len(whole) > 300
    assert np.abs(np.array(given.instants_ns) - np.array(whole)).max() <= 1
    assert given.remaining_count == 0 and given.skipped_ns == []


def test_instants_move_with_the_rate_and_stay_at_their_places(course: PathCourse) -> None:
    given, clock = give(course, EACH_MM), course.begin_at(0.0)
    first = course.plan_chunk(clock, 0.0, MOST_S)
    given.take_part(first)
    slower = course.change_rate(clock, first.end_s, 0.5)
    play(course, given, slower, course.plan_chunk(slower, first.end_s - SWITCH_S, MOST_S))
    assert np.abs(places_at(course, slower, given.instants_ns) % 1.0 - 0.5).min() > 0.49
    assert len(given.instants_ns) == len(EACH_MM.find_instants_ns(plan_whole(course)))


@pytest.mark.parametrize("resolved", [EACH_MM, EACH_10_MS])
def test_a_cut_withdraws_what_is_behind_it_and_the_next_chunk_has_it(
    course: PathCourse, resolved: ResolvedTrigger
) -> None:
    given, clock = give(course, resolved), course.begin_at(0.0)
    given.take_part(course.plan_chunk(clock, 0.0, 4.0))
    count = len(given.instants_ns)
    cut = course.brake(clock, 2.0)
    tail = course.plan_stop(cut, cut.ramps[-1].begin_s - SWITCH_S)
    first, added = given.find_part(tail)
    assert added == [] and 0 < first < count
    assert given.instants_ns[first - 1] <= round(tail.end_s * 1e9) < given.instants_ns[first]
    given.take_part(tail)
    assert len(given.instants_ns) == first
    play(course, given, clock, course.plan_chunk(clock, tail.end_s - SWITCH_S, MOST_S))
    assert given.instants_ns == give_all(course, resolved)


def give_all(course: PathCourse, resolved: ResolvedTrigger) -> list[int]:
    given = give(course, resolved)
    play(course, given, course.begin_at(0.0))
    return given.instants_ns


def test_what_the_tail_passes_is_skipped_and_the_resumed_path_goes_on_behind_it(course: PathCourse) -> None:
    given, clock = give(course, EACH_MM), course.begin_at(0.0)
    given.take_part(course.plan_chunk(clock, 0.0, 4.0))
    cut = course.brake(clock, 2.0)
    tail = course.plan_stop(cut, cut.ramps[-1].begin_s - SWITCH_S)
    given.take_part(tail)
    given.skip_tail(tail)
    assert given.skipped_ns and tail.end_s * 1e9 < given.skipped_ns[0] <= given.skipped_ns[-1] <= tail.stop_s * 1e9
    resumed = give(course, EACH_MM, tail.stop_path_s, round(tail.stop_s * 1e9))
    play(course, resumed, course.begin_at(tail.stop_path_s))
    total = len(given.instants_ns) + len(given.skipped_ns) + len(resumed.instants_ns)
    assert total == len(give_all(course, EACH_MM)) and resumed.instants_ns[0] > 0


def test_the_time_of_the_step_stands_while_the_path_is_held(course: PathCourse) -> None:
    moved_ns = 1_234_567_890
    resumed = give(course, EACH_10_MS, 1.0, moved_ns)
    play(course, resumed, course.begin_at(1.0))
    assert resumed.instants_ns[0] == 1_240_000_000 - moved_ns
    assert set(np.diff(resumed.instants_ns).tolist()) == {10_000_000}


def test_a_level_is_set_again_where_the_path_goes_on(course: PathCourse) -> None:
    marks_s = np.array(LEVELS.find_instants_ns(plan_whole(course))) / 1e9
    for begun in (3, 4):
        begun_s = float(marks_s[begun - 1] + marks_s[begun]) / 2
        given = give(course, LEVELS, begun_s)
        play(course, given, course.begin_at(begun_s))
        assert (given.instants_ns[0] == 0) == (begun == 3)
        assert len(given.instants_ns) == len(marks_s) - begun + (begun == 3)


def test_the_densest_place_of_a_path_is_known_ahead(course: PathCourse) -> None:
    trigger = PathTrigger.of(EACH_MM, plan_whole(course), 0.0, 0)
    profile: Profile = plan_whole(course).profiles["a.x"]
    crossings = find_crossings(profile, np.arange(-100_000, 1, 1000.0))
    assert trigger.least_ns == pytest.approx(np.diff(crossings).min() * 1e9, abs=2)
    assert trigger.find_most(1.0) == max(
        int(((crossings >= begin) & (crossings <= begin + 1.0)).sum()) for begin in crossings
    )
    timed = PathTrigger.of(EACH_10_MS, plan_whole(course), 0.0, 0)
    assert (timed.least_ns, timed.find_most(1.0), timed.gets_faster) == (10_000_000, 101, False)
