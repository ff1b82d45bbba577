"""Time laws of paths: every limit held, rest at both ends, and how near they come to the least time."""

import time

import numpy as np
import pytest
from unit.random_rounds import share_with_nightly

from benches.paths.lower_bound import find_least_time
from benches.paths.random_paths import (
    even_limits,
    find_worst_use,
    random_outline,
    stop_everywhere,
    uneven_limits,
)
from orchestrator.model.units import Unit
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.outline import Outline, OutlineBuilder, PieceEnd
from orchestrator.plan.path.plan import plan_path
from orchestrator.plan.path.run import Run, plan_run
from orchestrator.plan.shape import ShapeBounds, solve_shapes

WORST = 1.001  # the requirement: 0.1 % above a limit


def plan_random(seed: int) -> tuple[Outline, PathLimits, Run]:
    draw = np.random.default_rng(seed)
    axes = int(draw.integers(2, 9))
    outline = random_outline(draw, axes, int(draw.integers(5, 20)))
    limits = even_limits(axes)
    return outline, limits, plan_run(outline, None, limits)


def plan_hard(seed: int) -> tuple[Outline, PathLimits, Run]:
    """Limits over decades, pieces from 10 um to 1 m."""
    draw = np.random.default_rng(seed)
    axes = int(draw.integers(1, 9))
    least = 10 ** draw.uniform(-2, 1)
    limits = uneven_limits(draw, axes)
    outline = random_outline(draw, axes, int(draw.integers(1, 25)), lengths=(least, least * 10 ** draw.uniform(0.1, 2)))
    return outline, limits, plan_run(outline, None, limits)


def check_motion(run: Run, limits: PathLimits) -> None:
    motion = run.motion
    assert find_worst_use(run, limits) <= WORST
    steps = motion.ends_s - motion.t
    assert (steps > 0).all() and motion.s[0] == 0.0 and motion.length == pytest.approx(run.track.end, rel=1e-12)
    v = motion.v + steps * (motion.a + steps * motion.j / 2)
    s = motion.s + steps * (motion.v + steps * (motion.a / 2 + steps * motion.j / 6))
    assert (np.diff(motion.s) >= 0).all()
    assert np.abs(v[:-1] - motion.v[1:]).max(initial=0) <= 1e-5 * motion.v.max()
    assert np.abs(s - np.append(motion.s[1:], motion.length)).max() <= 1e-6 * max(motion.length, 1e-3)
    assert motion.v[0] == 0.0 and abs(v[-1]) <= 1e-5 * motion.v.max()
    if np.isfinite(limits.jerk).all():
        a = motion.a + steps * motion.j
        assert np.abs(a[:-1] - motion.a[1:]).max(initial=0) <= 1e-3 * np.abs(motion.a).max()
        assert abs(motion.a[0]) + abs(a[-1]) <= 1e-3 * np.abs(motion.a).max()


@pytest.mark.parametrize("seed", share_with_nightly(range(25), 8))
def test_limits_hold_at_every_sample(seed: int) -> None:
    _, limits, run = plan_random(seed)
    check_motion(run, limits)


@pytest.mark.parametrize("seed", share_with_nightly(range(25), 8))
def test_limits_hold_with_uneven_limits_and_tiny_pieces(seed: int) -> None:
    _, limits, run = plan_hard(seed)
    check_motion(run, limits)


@pytest.mark.parametrize(
    "seed",
    [
        3503,  # an axis that moves by rounding alone, with the only jerk limit: smoothing times of 1e-18 s
        4167,  # a peak that lasts less than its smoothing time, on both flanks together
    ],
)
def test_limits_hold_where_times_are_out_of_proportion(seed: int) -> None:
    _, limits, run = plan_hard(seed)
    check_motion(run, limits)


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_limits_hold_on_10_000_paths() -> None:
    over: list[tuple[str, int, float]] = []
    refused: list[str] = []
    for seed in range(5000):
        for name, plan in (("even", plan_random), ("hard", plan_hard)):
            try:
                _, limits, run = plan(seed)
            except PathRefusal as refusal:
                refused.append(f"{name} {seed}: {refusal}")
                continue
            worst = find_worst_use(run, limits, 4)
            if worst > WORST:
                over.append((name, seed, worst))
    assert not over and not refused, (over, refused)


def measure_ratios(seeds: range) -> np.ndarray:
    """(time / least time of the same track, time / time with stops at all corners)."""
    found = []
    for seed in seeds:
        draw = np.random.default_rng(seed)
        axes = int(draw.integers(2, 5))
        outline = random_outline(draw, axes, int(draw.integers(5, 51)))
        limits = even_limits(axes)
        run = plan_run(outline, None, limits)
        stopped = plan_run(stop_everywhere(outline), None, limits).duration_s
        found.append((run.duration_s / find_least_time(run.track, limits, 30), run.duration_s / stopped))
    return np.array(found)


def check_ratios(ratios: np.ndarray) -> None:
    assert np.median(ratios[:, 0]) <= 1.15 and np.quantile(ratios[:, 0], 0.95) <= 1.4
    assert ratios[:, 0].min() >= 0.999  # nothing is faster than the least time, but for its own grid
    assert ratios[:, 1].max() <= 1 + 1e-9


def test_times_are_near_the_least_and_never_above_stopping() -> None:
    check_ratios(measure_ratios(range(8)))


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_times_of_200_paths() -> None:
    check_ratios(measure_ratios(range(100, 300)))


def one_line(length: float) -> Outline:
    builder = OutlineBuilder(np.zeros(1))
    builder.add_line(PieceEnd(0), np.array([length]))
    return builder.build()


@pytest.mark.parametrize("length", [1e-4, 1e-3, 0.1, 1.0, 5.0, 20.0, 50.0, 1000.0])
def test_a_line_from_rest_to_rest_is_as_fast_as_ruckig(length: float) -> None:
    v, a, j = 200.0, 2000.0, 200_000.0
    run = plan_run(one_line(length), None, PathLimits(np.array([v]), np.array([a]), np.array([j])))
    bounds = ShapeBounds(*(np.array([x]) for x in (length / v, a / v, j / v)))
    fastest, _ = solve_shapes(bounds, ["x"], synchronised=True)
    assert fastest * (1 - 1e-9) <= run.duration_s <= fastest * 1.001


def test_without_jerk_limits_a_line_is_a_trapezoid() -> None:
    limits = PathLimits(np.array([200.0]), np.array([2000.0]), np.array([np.inf]))
    run = plan_run(one_line(50.0), None, limits)
    assert run.duration_s == pytest.approx(0.35, rel=1e-9)
    assert np.abs(run.motion.j).max() == 0.0
    assert sorted(set(np.round(run.motion.a))) == [-2000.0, 0.0, 2000.0]


def test_acceleration_goes_on_over_a_joint() -> None:
    """100 lines of 0.1 mm, each shorter than a ramp of jerk, are as fast as one of 10 mm."""
    builder = OutlineBuilder(np.zeros(2))
    for k in range(100):
        builder.add_line(PieceEnd(k, 0.01), np.array([(k + 1) * 0.08, (k + 1) * 0.06]))
    many = plan_run(builder.build(), None, even_limits(2))
    single = OutlineBuilder(np.zeros(2))
    single.add_line(PieceEnd(0), np.array([8.0, 6.0]))
    one = plan_run(single.build(), None, even_limits(2))
    assert many.duration_s == pytest.approx(one.duration_s, rel=1e-3)


def test_the_faster_of_stop_and_blend_is_taken() -> None:
    def plan(tolerance: float, jerk: float) -> Run:
        builder = OutlineBuilder(np.zeros(2))
        for k, to in enumerate(((50.0, 0.0), (50.0, 50.0))):
            builder.add_line(PieceEnd(k, tolerance), np.array(to))
        return plan_run(builder.build(), None, PathLimits(np.full(2, 200.0), np.full(2, 2000.0), np.full(2, jerk)))

    assert plan(1.0, 200_000.0).track.blend.any()
    assert not plan(0.001, 40_000.0).track.blend.any()  # a curve of a micrometre at 50 ms a ramp


def test_a_path_speed_is_held() -> None:
    outline = random_outline(np.random.default_rng(3), 3, 8)
    limits = PathLimits(np.full(3, 200.0), np.full(3, 2000.0), np.full(3, 200_000.0), path_speed=30.0)
    run = plan_run(outline, None, limits)
    check_motion(run, limits)
    assert run.motion.v.max() == pytest.approx(30.0, rel=1e-6)


def test_both_tracks_of_a_corner_are_evaluated_at_their_own_side() -> None:
    """At a stop the direction changes in no time: the samples before belong to the line before."""
    builder = OutlineBuilder(np.zeros(2))
    for k, to in enumerate(((5.0, 0.0), (5.0, 5.0), (0.0, 5.0))):
        builder.add_line(PieceEnd(k), np.array(to))
    run = plan_run(builder.build(), None, even_limits(2))
    ends = np.flatnonzero(np.diff(run.motion.section)) + 1
    before = run.evaluate(run.motion.t[ends] - 1e-7)[2]
    after = run.evaluate(run.motion.t[ends] + 1e-7)[2]
    assert np.abs(before[0, 1]) == 0.0 and np.abs(after[0, 0]) == 0.0


@pytest.mark.nightly
def test_planning_takes_300_us_a_piece_and_does_not_grow() -> None:
    spent: dict[int, float] = {}
    for pieces in (1000, 10_000):
        draw = np.random.default_rng(1)
        outline = random_outline(draw, 8, pieces, ("line",))
        times = []
        for _ in range(5):
            begin = time.process_time()
            plan_run(outline, None, even_limits(8))
            times.append(time.process_time() - begin)
        spent[pieces] = min(times) / pieces
    assert spent[1000] <= 300e-6 and spent[10_000] <= 1.2 * spent[1000], spent


@pytest.mark.parametrize("tolerance", [0.0, 0.5])
def test_a_piece_with_a_speed_of_its_own_is_nowhere_faster(tolerance: float) -> None:
    """Also where the motion slows down to it, and speeds up behind it; the others are as fast as ever."""
    axes = [PathAxis(name, Unit.MM, 200, 2000, 20_000) for name in "xy"]
    builder = OutlineBuilder(np.zeros(2))
    places = ([50.0, 0.0], [100.0, 0.0], [100.0, 50.0])
    for number, (to, speed) in enumerate(zip(places, (100.0, 20.0, np.inf), strict=True)):
        builder.add_line(PieceEnd(number, tolerance, speed), np.array(to))
    (run,) = plan_path(builder.build(), axes).parts
    assert isinstance(run, Run)
    s, v, *_ = run.motion.evaluate(np.linspace(0.0, run.duration_s, 4001))
    span = run.track.find_spans(s)
    for number, most in enumerate(run.track.speed.tolist()):
        assert v[span == number].max() == pytest.approx(min(most, 200.0), rel=1e-3)
