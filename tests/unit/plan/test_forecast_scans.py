"""Scans and repeats run forward on paper: the same mistakes and durations as if they were written out."""

from pathlib import Path
from random import Random

import pytest
from unit.random_rounds import share_with_nightly

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.forecast import JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.points import GridPoints
from orchestrator.model.steps.repeat import Repeat
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.forecast.job import JobForecaster, forecast_job

FLEET = load_fleet(Path(__file__).parents[3] / "deploy" / "examples" / "demo.fleet.yaml")
HOME = "{do: home, axes: [gantry, stage]}"


def forecast(text: str, fleet: Fleet = FLEET) -> JobForecast:
    return forecast_job(fleet, parse_document(f"schema: tutti.job/1\nname: test\nsteps: {text}\n", Job, "test").steps)


def texts(found: JobForecast) -> list[str]:
    return [f"{problem.place} {problem.code}: {problem.text}" for problem in found.problems]


def repeat(times: int, steps: str, before: str = HOME + ", ") -> str:
    return f"[{before}{{do: repeat, times: {times}, steps: [{steps}]}}]"


def by(distance: float) -> str:
    return f"{{do: move, by: {{gantry.x: {distance}}}}}"


def to(position: float) -> str:
    return f"{{do: move, to: {{gantry.x: {position}}}}}"


@pytest.mark.parametrize(
    ("steps", "text"),
    [
        (repeat(6, by(61)), ""),
        (repeat(10, by(61)), "target 427 mm is beyond its soft limits -10 to 400 mm, in pass 7 of 10"),
        (repeat(10, by(201)), "target 402 mm is beyond its soft limits -10 to 400 mm, in pass 2 of 10"),
        (repeat(10, by(401)), "target 401 mm is beyond its soft limits -10 to 400 mm"),
        (
            repeat(10, by(61), before=""),
            "from step 1 (`steps[0]`) on cover 427 mm; its soft limits are 410 mm apart, in pass 7 of 10",
        ),
        (repeat(1_000_000, f"{by(300)}, {by(-300)}"), ""),
        # A position that is given ends what was added up before.
        (repeat(1_000_000, f"{to(0)}, {by(300)}"), ""),
        (repeat(100, f"{to(0)}, {by(300)}, {by(101)}"), "target 401 mm"),
        # The positions of the user are shifted in each pass, so absolute targets wander.
        (repeat(10, f"{to(50)}, {{do: set-position, axes: {{gantry.x: 0}}}}"), "-410 to 0 mm, in pass 9 of 10"),
        (repeat(10, f"{{do: set-position, axes: {{gantry.x: 0}}}}, {to(-3)}"), "-1 to 409 mm, in pass 4 of 10"),
        (repeat(4, f"{{do: repeat, times: 5, steps: [{by(25)}]}}"), "target 425 mm is beyond its soft limits"),
        # What came before counts: its own range, and where it ends.
        (repeat(40, by(10), before=f"{by(300)}, {by(-300)}, "), ""),
        (
            repeat(42, by(10), before=f"{by(300)}, {by(-300)}, "),
            "cover 420 mm; its soft limits are 410 mm apart, in pass 42",
        ),
    ],
)
def test_a_repeat_is_refused_in_the_pass_that_leaves_the_limits(steps: str, text: str) -> None:
    found = texts(forecast(steps))
    assert (len(found) == 1 and text in found[0]) if text else not found, found


def test_after_a_repeat_the_axes_are_where_it_leaves_them() -> None:
    after = f"{HOME}, {{do: repeat, times: 7, steps: [{by(10)}]}}, {by(330)}"
    assert not texts(forecast(f"[{after}]")) and "target 401 mm" in texts(forecast(f"[{after}, {by(1)}]"))[0]
    assert "before step 1" in forecast(repeat(30, by(10), before="")).conditions[-1]
    assert "gantry.x stands between -10 and 100 mm" in forecast(repeat(30, by(10), before="")).conditions[-1]


def test_durations_of_passes_and_points_are_added_up() -> None:
    once, many = forecast(repeat(1, by(1))), forecast(repeat(300, by(1)))
    assert many.steps[1].least_s == pytest.approx(300 * once.steps[1].least_s, rel=1e-4)
    scan = (
        f"[{HOME}, {{do: scan, axes: {{gantry.x: {{from: 0, to: 20, points: 5}}, stage.u: {{from: 0, to: 1, points: 3}}}},"
        " at_each: [{do: dwell, duration: 1 s}, {do: output, output: gantry.lamp, value: true, pulse: 0.5 s}]}]"
    )
    found = forecast(scan)
    # Four kinds of ways: to the first point none, 10 along u, 4 along x with u back.
    inner, outer = "{do: move, by: {stage.u: 0.5}}", "{do: move, by: {gantry.x: 5, stage.u: -1}}"
    single = forecast(f"[{HOME}, {{do: move, to: {{stage.u: 1}}}}, {inner}, {outer}]")
    assert found.steps[1].least_s == pytest.approx(
        15 * 1.5 + 10 * single.steps[2].least_s + 4 * single.steps[3].least_s
    )
    assert found.steps[1].most_s == found.steps[1].least_s


def test_a_scan_is_refused_at_the_corner_that_leaves_the_limits() -> None:
    grid = "gantry.x: {from: 0, to: 401, points: 11}, stage.u: {from: 0, to: 5, points: 6, snake: true}"
    assert texts(forecast(f"[{HOME}, {{do: scan, axes: {{{grid}}}}}]")) == [
        "['steps', 1, 'axes', 'gantry.x'] soft-limit: axis gantry.x: target 401 mm is beyond its soft limits -10 to 400 mm,"
        " at point 61 of 66 (gantry.x 401, stage.u 0)"
    ]
    rows = "points: {axes: [gantry.x, stage.u], rows: [[0, 0], [1, -2], [500, 2], [3, 3]]}"
    found = texts(forecast(f"[{{do: scan, {rows}}}]"))
    assert "at point 3 of 4 (gantry.x 500, stage.u 2)" in found[0] and "at point 2 of 4" in found[1] and len(found) == 2
    drifting = "{do: scan, axes: {gantry.x: {from: 0, to: 1, points: 66}}, at_each: [{do: move, by: {stage.v: 1}}]}"
    assert texts(forecast(f"[{HOME}, {drifting}]")) == [
        "['steps', 1, 'at_each', 0, 'by', 'stage.v'] soft-limit: axis stage.v: target 51 mm is beyond its soft limits"
        " -1 to 50 mm, at point 51 of 66"
    ]
    lost = forecast("[{do: scan, axes: {gantry.q: {values: [0, 1]}}}]")
    assert "no axis gantry.q; did you mean gantry.y?" in texts(lost)[0]
    assert "deg is a unit of angle" in texts(forecast("[{do: scan, axes: {gantry.x: {values: [0, 1 deg]}}}]"))[0]


NAMED = Fleet.model_validate(
    FLEET.to_plain() | {"positions": {"left": {"gantry.x": "10 mm", "stage.v": 2}, "far": {"gantry.x": "395 mm"}}}
)


@pytest.mark.parametrize(
    ("by_name", "by_value"),
    [
        ("axes: {gantry.x: {from: left, to: 30, points: 3}}", "axes: {gantry.x: {from: 10, to: 30, points: 3}}"),
        ("axes: {stage.v: {values: [1, left, 3]}}", "axes: {stage.v: {values: [1, 2, 3]}}"),
        (
            "points: {axes: [gantry.x, stage.v], rows: [[0, left], [left, 0], [far, 1]]}",
            "points: {axes: [gantry.x, stage.v], rows: [[0, 2], [10, 0], [395, 1]]}",
        ),
        (
            "axes: {gantry.y: {values: [0, 1]}}, at_each: [{do: move, to: left}]",
            "axes: {gantry.y: {values: [0, 1]}}, at_each: [{do: move, to: {gantry.x: 10, stage.v: 2}}]",
        ),
        ("axes: {gantry.x: {from: 0, to: far, points: 9}}", "axes: {gantry.x: {from: 0, to: 395, points: 9}}"),
    ],
)
def test_positions_of_the_fleet_file_count_in_scans_as_their_values(by_name: str, by_value: str) -> None:
    # User positions are shifted, so that `far` is beyond the soft limits.
    head = f"{HOME}, {{do: set-position, axes: {{gantry.x: -6}}}}"
    named = forecast(f"[{head}, {{do: repeat, times: 3, steps: [{{do: scan, {by_name}}}]}}]", NAMED)
    plain = forecast(f"[{head}, {{do: repeat, times: 3, steps: [{{do: scan, {by_value}}}]}}]", NAMED)
    assert (named.least_s, named.most_s, texts(named)) == (plain.least_s, plain.most_s, texts(plain))
    assert bool(named.problems) == ("far" in by_name)


def test_of_a_scan_with_a_saved_position_the_other_axes_are_checked_with_the_right_point() -> None:
    axes = "gantry.y: {from: 0, to: 10, points: 3}, gantry.x: {from: lift, to: 30, points: 4}"
    scan = f"{{do: scan, axes: {{{axes}, stage.u: {{values: [0, 51, 2]}}}}, at_each: [{{do: dwell, duration: 1 s}}]}}"
    found = forecast(f"[{HOME}, {{do: move, to: {{gantry.x: 5}}}}, {scan}, {by(100)}]", NAMED)
    assert texts(found) == [
        "['steps', 2, 'axes', 'stage.u'] soft-limit: axis stage.u: target 51 mm is beyond its soft limits -1 to 50 mm, "
        "at point 2 of 36 (gantry.y 0, stage.u 51)"
    ]
    assert "position lift is saved in the running fleet (did you mean left?)" in found.conditions
    well = forecast(f"[{HOME}, {scan.replace('51', '5')}, {by(390)}]", NAMED)
    # Where the scan leaves gantry.x is not known, so 390 mm from there are possible; how long it takes is not bounded.
    assert well.problems == [] and well.most_s is None and well.least_s >= 36
    alone = forecast("[{do: scan, axes: {gantry.x: {from: lift, to: 0, points: 5}}}]", NAMED)
    assert alone.problems == [] and alone.most_s is None
    other = forecast("[{do: scan, axes: {stage.u: {from: left, to: 0, points: 5}}}]", NAMED)
    assert texts(other) == [
        "['steps', 0] not-in-position: position left has no value for stage.u; it has: gantry.x, stage.v"
    ]


def write_out(steps: list[Step]) -> list[Step]:
    """The job without repeats and scans."""
    found: list[Step] = []
    for step in steps:
        if isinstance(step, Repeat):
            found += write_out(step.steps) * step.times
        elif isinstance(step, Scan):
            points = GridPoints(step.axes)
            units = [FLEET.axis(name).unit for name in step.axes]
            for point in range(points.count):
                positions = (float(each) for each in points.find_position(point, units))
                found += [Move(to=dict(zip(step.axes, positions, strict=True))), *step.at_each]
        else:
            found.append(step)
    return found


@pytest.mark.parametrize("snake", [False, True])
def test_a_raster_takes_the_time_of_its_moves(snake: bool) -> None:
    """An axis that snakes has no way back between passes."""
    inner = f"stage.u: {{from: 0, to: 6, points: 4, snake: {str(snake).lower()}}}"
    scan = f"{{do: scan, axes: {{gantry.x: {{from: 0, to: 2, points: 3}}, {inner}}}, at_each: []}}"
    start = "{do: move, to: {gantry.x: 0, stage.u: 0}}"
    steps = parse_document(f"schema: tutti.job/1\nname: test\nsteps: [{HOME}, {start}, {scan}]\n", Job, "test").steps
    found, written = forecast_job(FLEET, steps), forecast_job(FLEET, write_out(steps))
    assert not found.problems and found.least_s == pytest.approx(written.least_s)
    assert found.most_s == pytest.approx(written.most_s)


@pytest.mark.parametrize("seed", share_with_nightly(range(60), 20))
def test_random_jobs_are_judged_as_if_they_were_written_out(seed: int) -> None:
    draw = Random(seed)

    def leaf() -> str:
        kinds = [by(draw.choice([-40, -7, 0.5, 10, 30])), to(draw.choice([0, 20, 100]))]
        kinds.append(f"{{do: set-position, axes: {{gantry.x: {draw.choice([0, 5, -20])}}}}}")
        kinds.append("{do: home, axes: [gantry.x]}" if draw.random() < 0.3 else kinds[0])
        kinds.append("{do: move, to: {gantry.x: somewhere}, by: {stage.v: 1}}" if draw.random() < 0.2 else kinds[1])
        kinds.append(
            "{do: scan, axes: {gantry.x: {from: 0, to: 30, points: 4}}, at_each: [{do: move, by: {stage.v: 2}}]}"
        )
        return draw.choice(kinds)

    def body(depth: int) -> str:
        parts = [leaf() for _ in range(draw.randint(1, 3))]
        if depth:
            parts.insert(
                draw.randint(0, len(parts)), f"{{do: repeat, times: {draw.randint(1, 9)}, steps: [{body(depth - 1)}]}}"
            )
        return ", ".join(parts)

    text = f"[{HOME if draw.random() < 0.6 else leaf()}, {body(2)}, {leaf()}]"
    given = parse_document(f"schema: tutti.job/1\nname: test\nsteps: {text}\n", Job, "test").steps
    short, long = JobForecaster(FLEET), JobForecaster(FLEET)
    spans = [short.take(number, step) for number, step in enumerate(given)]
    long_spans = [long.take(0, step) for step in write_out(given)]
    assert bool(short.problems) == bool(long.problems), (text, short.problems[:2], long.problems[:2])
    if short.problems:
        return
    least_s, most_s = sum(each.least_s for each in long_spans), [each.most_s for each in long_spans]
    # Where user offsets are unknown, the ways between the points of a scan are known all the same.
    if not any("user offset" in each for each in short.conditions):
        assert sum(each.least_s for each in spans) <= least_s + 1e-3
        bounds_s = [each.most_s for each in spans]
        if None not in most_s and None not in bounds_s:
            assert sum(each or 0.0 for each in bounds_s) >= sum(each or 0.0 for each in most_s) - 1e-3
    for name, state in short.axes.items():
        other = long.axes[name]
        assert (state.motor, state.known, state.lowest, state.highest) == (
            other.motor,
            other.known,
            other.lowest,
            other.highest,
        ), (name, text)
        assert (state.offset, state.offset_kind) == (other.offset, other.offset_kind)
