"""Scans that fly along curves: the spline through their windows, its limits, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import FileError, load_fleet, parse_document
from orchestrator.model.jobs.forecast import JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.flying.curves import CurvedLines
from orchestrator.plan.flying.flight import plan_flight
from orchestrator.plan.flying.line_plan import plan_lines
from orchestrator.plan.flying.path import ChunkAbility, FlightPath
from orchestrator.plan.flying.splines import fit_curve, reverse_motion
from orchestrator.plan.forecast.job import JobForecaster
from orchestrator.plan.forecast.line import find_first_part

FLEET = load_fleet(Path(__file__).parents[3] / "deploy" / "examples" / "path.fleet.yaml")
POINTS = 12
ANGLES = np.pi * np.linspace(0.0, 1.0, 2 * POINTS + 1) ** 1.3
KNOTS = np.round(20 + 4 * np.stack([np.sin(ANGLES), np.cos(ANGLES)], axis=1), 4)
FLOWN = ("slide.y", "gantry.x")


def axes(knots: Any = KNOTS, outer: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {outer: {"values": [2, 4]}} if outer else {}
    for name, column in zip(FLOWN, knots.T.tolist(), strict=True):
        found[name] = {"values": column[1::2], "bounds": column[::2], "snake": True}
    return found


def curve(knots: Any = KNOTS, outer: str = "", **fly: Any) -> CurvedLines:
    found = plan_lines(Scan(axes=axes(knots, outer), fly={"axis": list(FLOWN), **fly}), FLEET)
    assert isinstance(found, CurvedLines)
    return found


def forecast(knots: Any = KNOTS, chunks: dict[str, ChunkAbility] | None = None, **fly: Any) -> JobForecast:
    scan = Scan(axes=axes(knots), fly={"axis": list(FLOWN), **fly})
    steps = parse_document("schema: tutti.job/1\nname: a\nsteps: [{do: home}]\n", Job, "test").steps
    forecaster = JobForecaster(FLEET, chunks=chunks)
    return JobForecast(
        steps=[forecaster.take(number, step) for number, step in enumerate([*steps, scan])],
        problems=forecaster.problems,
    )


def test_a_spline_is_smooth_and_passes_its_knots_at_even_times() -> None:
    motion = fit_curve(KNOTS, 0.04)
    times_s = 0.02 * np.arange(2 * POINTS + 1)
    assert np.allclose(motion.times_s, times_s)
    before, after = (motion.evaluate(np.clip(times_s[1:-1] + side, 0.0, None)) for side in (-1e-9, 1e-9))
    for rows, others, near in zip(before[:3], after[:3], (1e-6, 1e-5, 1e-3), strict=True):
        assert np.abs(rows - others).max() < near
    back = reverse_motion(motion)
    there, again = motion.evaluate(times_s[1:-1] - 1e-7), back.evaluate(motion.duration_s - times_s[1:-1] + 1e-7)
    for rows, others, sign in zip(there, again, (1, -1, 1, -1), strict=True):
        assert np.allclose(rows, sign * others)
    cubic = np.linspace(0.0, 0.16, 9)[:, None] ** 3
    assert np.allclose(fit_curve(cubic, 0.04).jerks, 6.0)


def test_a_curve_is_flown_through_its_bounds_at_its_times_and_within_all_limits() -> None:
    lines = curve(outer="lift.z", duration="60 ms")
    flight = plan_flight(lines, FLEET, (0, 2 * POINTS))
    for line, knots in zip(flight.lines, (KNOTS, KNOTS[::-1]), strict=True):
        places = flight.motion.evaluate(line.begin_s + 0.03 * np.arange(2 * POINTS + 1))[0]
        assert np.abs(places[:, 1:] - knots).max() < 1e-9 and line.window_s == pytest.approx(0.06)
    rows = flight.motion.evaluate(np.linspace(0.0, flight.duration_s, 20001))
    limits = np.array([(axis.velocity, axis.acceleration, axis.jerk) for axis in lines.limits]) * (1 + 1e-6)
    for values, limit in zip(rows[1:], limits.T, strict=True):
        assert (np.abs(values[:, 1:]).max(axis=0) <= limit).all()
    assert np.abs(np.diff(rows[1], axis=0)).max() <= 1001 * flight.duration_s / 20000
    assert np.allclose(rows[0][0, 1:], lines.find_begin(0)) and np.allclose(rows[0][-1, 1:], lines.find_end(POINTS))
    # What was broken is flown again from its window, with a run-up of its own.
    again = plan_flight(lines, FLEET, (POINTS + 5, 2 * POINTS))
    assert (again.lines[0].first, again.lines[0].points) == (POINTS + 5, POINTS - 5)
    place = again.motion.evaluate(np.array([again.lines[0].begin_s]))[0][0, 1:]
    assert np.allclose(place, KNOTS[::-1][10])


def test_a_curve_without_duration_is_as_fast_as_its_axes_and_its_detector_allow() -> None:
    fastest = curve()
    assert curve(duration=f"{fastest.window_s * 1.001 * 1e3:.3f} ms").count == POINTS
    with pytest.raises(Refusal, match="its limit is"):
        curve(duration=f"{fastest.window_s * 0.9 * 1e3:.3f} ms")
    assert curve(detector={"max_rate": 5}).window_s == pytest.approx(0.2)


def test_a_curve_that_is_too_fast_is_refused_with_axis_window_and_what_fits() -> None:
    (problem,) = forecast(duration="10 ms").problems
    assert problem.code == "fly-speed" and "in the window of point 1 of the curve" in problem.text, problem
    duration = problem.remedy.split("`")[1].removeprefix("duration: ")
    assert not forecast(duration=duration).problems


def test_the_forecast_of_a_curve() -> None:
    found = forecast(duration="60 ms")
    assert not found.problems, found.problems
    assert found.steps[1].lines.startswith(
        "slide.y and gantry.x fly through 12 points on a curve, 60 ms each; it takes 0."
    )
    assert "where all its controllers load paths in chunks" in found.steps[1].lines
    lines = curve(duration="60 ms", trigger={"output": "gantry.camera"})
    part = find_first_part(FLEET, lines, 0)
    assert part is not None and (part.first, part.end) == (0, POINTS)
    at = FlightPath.make(part).triggers[0].at
    assert at is not None and len(at) == POINTS


def test_a_curve_is_not_flown_where_no_path_is_loaded_in_chunks() -> None:
    chunks = {"gantry": ChunkAbility(7.5, switches=True), "slide": ChunkAbility(0.0, switches=True)}
    (problem,) = forecast(chunks=chunks, duration="60 ms").problems
    assert problem.code == "fly-curve" and "slide loads no path in chunks" in problem.text
    assert "leave out" in problem.remedy


def test_a_curve_leaves_no_soft_limit_on_its_way() -> None:
    (problem,) = forecast([13.95, 0.0] + KNOTS * [-1, 1], duration="60 ms").problems
    assert problem.code == "fly-room" and "beyond its soft limit -10 mm" in problem.text and problem.remedy


def test_a_window_that_begins_where_it_ends_is_refused() -> None:
    knots = KNOTS.copy()
    knots[8] = knots[6]
    with pytest.raises(Refusal, match="the window of point 4 of the curve begins where it ends"):
        curve(knots, duration="60 ms")


Y, X = "slide.y: {values: [1, 2], bounds: [0, 1, 2]}", "gantry.x: {values: [1, 2], bounds: [0, 1, 2]}"


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (f"axes: {{{X}}}", "gantry.x have them, and no axes fly"),
        (f"axes: {{{Y}, {X}}}, fly: {{duration: 20 ms}}", "slide.y, gantry.x have them, and gantry.x fly"),
        (f"axes: {{{X}}}, fly: {{speed: 5}}", "several lengths, and one time; write `duration`"),
        (f"axes: {{{X}}}, fly: {{wait: {{input: gantry.a, timeout: 1 s}}}}", "put a step `do: wait` before"),
        ("axes: {gantry.x: {values: [1, 2], bounds: [0, 1]}}", "one more than these; there are 2"),
        ("axes: {gantry.x: {from: 1, to: 2, points: 2, bounds: [0, 1, 2]}}", "`bounds` needs `values`"),
    ],
)
def test_a_file_says_what_is_wrong_with_a_curve(fields: str, words: str) -> None:
    with pytest.raises(FileError) as refused:
        parse_document(f"schema: tutti.job/1\nname: a\nsteps: [{{do: scan, {fields}}}]\n", Job, "test")
    assert words in str(refused.value)
