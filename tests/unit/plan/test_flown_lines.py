"""Lines of scans that fly: their ends, their windows, and what cannot be flown."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, load_fleet, parse_document
from orchestrator.model.jobs.forecast import JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.order import StepOrder
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.flying.flight import plan_flight
from orchestrator.plan.flying.line_plan import plan_lines
from orchestrator.plan.flying.path import ChunkAbility, choose_part
from orchestrator.plan.flying.straight import StraightLines
from orchestrator.plan.forecast.job import JobForecaster, forecast_job

FLEET = load_fleet(Path(__file__).parents[3] / "deploy" / "examples" / "path.fleet.yaml")
HOME = "{do: home}"
LINE = "gantry.x: {from: 0, to: 10, points: 21}"


def forecast(fields: str, before: str = HOME, fleet: Fleet = FLEET) -> JobForecast:
    text = f"schema: tutti.job/1\nname: test\nsteps: [{before}, {{do: scan, {fields}}}]\n"
    return forecast_job(fleet, parse_document(text, Job, "test").steps)


def lines(fly: dict[str, Any], **axes: dict[str, Any]) -> StraightLines:
    named_axes = {name.replace("_", "."): axis for name, axis in axes.items()}
    found = plan_lines(Scan(axes=named_axes, fly=fly), FLEET)
    assert isinstance(found, StraightLines)
    return found


def test_a_line_has_a_run_up_before_its_first_window_and_a_run_down_behind_its_last() -> None:
    found = lines(
        {"duration": "10 ms"}, slide_y={"from": 0, "to": 1, "points": 2}, gantry_x={"from": 0, "to": 10, "step": 0.5}
    )
    assert (found.count, found.speed, found.window_s) == (21, pytest.approx(50), pytest.approx(0.01))
    # 50 ms at 1000 mm/s2, and 50 ms for the rise of the acceleration at 20000 mm/s3: 2.5 mm, and two counts.
    assert found.run_up_s == pytest.approx(0.1) and found.run_up == pytest.approx(2.502)
    assert found.find_ends(0)[:2] == ((pytest.approx(-2.752),), (pytest.approx(12.752),))
    assert found.find_ends(25) == found.find_ends(0)
    assert [float(place) for place in found.list_positions(0, "start")[:2]] == [-0.25, 0.25]
    assert found.make_path(0).start == [-2.752]
    assert found.make_move(21).to == {"slide.y": 1.0, "gantry.x": -2.752}


def test_a_line_that_snakes_goes_back_and_begins_where_the_one_before_has_ended() -> None:
    outer, inner = {"values": [5, 7]}, {"from": 10, "to": 0, "points": 21, "snake": True}
    found = lines({"speed": "50 mm/s"}, slide_y=outer, gantry_x=inner)
    assert found.find_ends(0)[:2] == found.find_ends(21)[:2][::-1]
    assert [float(place) for place in found.list_positions(21, "start")[:2]] == [-0.25, 0.25]
    assert [float(place) for place in found.list_positions(0, "end")[:2]] == [9.75, 9.25]


def test_the_steps_of_a_flown_scan_are_a_move_and_a_path_a_line() -> None:
    axes = {"slide.y": {"values": [5, 7]}, "gantry.x": {"from": 0, "to": 10, "points": 21}}
    order = StepOrder([Scan(axes=axes, fly={"duration": "10 ms"})])
    places = [order.locate(number) for number in range(len(order))]
    assert [(place.point, place.part, place.kind) for place in places] == [
        (0, 0, "move"),
        (0, 1, "path"),
        (21, 0, "move"),
        (21, 1, "path"),
    ]
    assert places[3].describe() == "step 1 (scan), points 22 to 42 of 42 (path)"


def test_the_forecast_says_how_a_line_is_flown_and_how_long_all_take() -> None:
    fields = "axes: {slide.y: {from: 0, to: 2, points: 5}, gantry.x: {from: 0, to: 10, points: 21, snake: true}}"
    found = forecast(f"{fields}, fly: {{duration: 10 ms}}")
    assert not found.problems, found.problems
    assert found.steps[1].lines == (
        "gantry.x flies through 21 points at 50 mm/s, 10 ms each, with a run-up and a run-down of 2.502 mm; 5 lines are "
        "one motion of 1.850 s, with rounded turn-arounds; line by line where a controller loads no path in chunks, "
        "0.410 s each"
    )
    # The move to the beginning, and one motion; or five lines of 0.41 s, and four moves between them.
    most_s = found.steps[1].most_s
    assert most_s is not None and 1.85 <= found.steps[1].least_s < 2.05 <= most_s <= 3.5


def test_the_forecast_says_why_lines_are_flown_one_by_one() -> None:
    fields = (
        "axes: {slide.y: {from: 0, to: 2, points: 2}, gantry.x: {from: 0, to: 10, points: 21}}, fly: {duration: 10 ms}"
    )
    document = parse_document(f"schema: tutti.job/1\nname: a\nsteps: [{HOME}, {{do: scan, {fields}}}]\n", Job, "test")
    chunks = {"gantry": ChunkAbility(7.5, switches=True), "slide": ChunkAbility(0.0, switches=True)}
    forecaster = JobForecaster(FLEET, chunks=chunks)
    lines_text = [forecaster.take(number, step).lines for number, step in enumerate(document.steps)][1]
    assert lines_text.endswith("a line takes 0.410 s; line by line: slide loads no path in chunks")


@pytest.mark.parametrize(("shows", "motions"), [(True, 1), (False, 2)])
def test_a_flight_with_triggers_is_long_where_they_are_seen_while_it_flies(*, shows: bool, motions: int) -> None:
    """40 lines of 2 s are more than a minute, and less than ten."""
    found = lines(
        {"duration": "20 ms", "trigger": {"output": "gantry.lamp"}},
        slide_y={"from": 0, "to": 20, "points": 40},
        gantry_x={"from": 0, "to": 10, "points": 101, "snake": True},
    )
    abilities = {name: ChunkAbility(7.5, switches=True, shows=shows) for name in ("gantry", "slide")}
    begins = [0]
    while begins[-1] < found.scan.point_count:
        part, reason = choose_part(found, FLEET, begins[-1], abilities)
        assert part is not None and part.shows_switching is shows, reason
        begins.append(part.end)
    assert len(begins) == 1 + motions


BEYOND = "its lines reach -20.752 mm, 10.75 mm beyond its soft limit -10 mm"
BAD = [
    ("axes: {gantry.x: {from: 0, to: 10, points: 21}}, fly: {duration: 2 ms}", "fly-speed", "its limit is 200 mm/s"),
    ("axes: {gantry.x: {from: -18, to: 10, points: 57}}, fly: {duration: 10 ms}", "fly-room", BEYOND),
    ("axes: {gantry.x: {values: [0, 1, 3]}}, fly: {duration: 10 ms}", "fly-spacing", "not evenly spaced"),
    ("axes: {gantry.x: {from: 1, to: 1, points: 3}}, fly: {duration: 10 ms}", "fly-spacing", "would not move"),
    ("axes: {gantry.x: {from: 0, to: 0.01, points: 11}}, fly: {duration: 10 ms}", "fly-window", "1 counts long"),
    (f"axes: {{{LINE}}}, fly: {{speed: 5 deg/s}}", "bad-unit", "deg"),
    (f"axes: {{{LINE}}}, fly: {{speed: 0}}", "fly-speed", "must be above 0"),
    (f"axes: {{{LINE}}}, fly: {{speed: 50 %}}", "bad-unit", "says no time for a point"),
    (f"axes: {{{LINE}}}, fly: {{duration: 10 ms, tolerance: 0}}", "path-error", "must be above 0"),
    (f"axes: {{{LINE}}}, fly: {{duration: 10 ms, trigger: {{output: gantry.none}}}}", "unknown-name", "gantry.none"),
    ("axes: {gantry.q: {from: 0, to: 1, points: 3}}, fly: {duration: 10 ms}", "unknown-name", "gantry.q"),
]


@pytest.mark.parametrize(("fields", "code", "words"), BAD)
def test_what_cannot_be_flown_is_refused_ahead(fields: str, code: str, words: str) -> None:
    problems = forecast(fields).problems
    assert [problem.code for problem in problems] == [code] and words in problems[0].text, problems
    assert problems[0].remedy


def test_a_speed_that_is_too_high_is_refused_with_what_would_fit() -> None:
    (problem,) = forecast(f"axes: {{{LINE}}}, fly: {{duration: 2 ms}}").problems
    assert problem.text.startswith("gantry.x flies at 250 mm/s through windows of 0.5 mm")
    assert "`duration: 2.501 ms` or longer" in problem.remedy
    # That needs more room than the soft limits leave, and the room says what fits.
    (problem,) = forecast(f"axes: {{{LINE}}}, fly: {{duration: 2.501 ms}}").problems
    assert problem.code == "fly-room" and "15.23 mm beyond its soft limit -10 mm" in problem.text
    duration = problem.remedy.split("`")[1]
    assert duration == "duration: 4.281 ms"
    assert not forecast(f"axes: {{{LINE}}}, fly: {{{duration}}}").problems


def test_soft_limits_are_those_of_shifted_positions() -> None:
    shift = f"{HOME}, {{do: move, to: {{gantry.x: 300}}}}, {{do: set-position, axes: {{gantry.x: 0}}}}"
    (problem,) = forecast("axes: {gantry.x: {from: 50, to: 99, points: 99}}, fly: {duration: 10 ms}", shift).problems
    assert problem.code == "fly-room" and "beyond its soft limit 100 mm" in problem.text


WRONG = [
    (f"axes: {{{LINE}}}, fly: {{trigger: {{output: gantry.a}}}}", "known to its controller alone"),
    (f"axes: {{{LINE}}}, fly: {{duration: 1 ms, speed: 1}}", "remove one of them"),
    (f"axes: {{{LINE}}}, fly: {{detector: {{}}}}", "needs `dead_time`, `max_rate` or both"),
    (
        f"axes: {{{LINE}}}, fly: {{duration: 9 ms, trigger: {{output: gantry.a, gate: true}}}}",
        "would not end in a line",
    ),
    (
        f"axes: {{{LINE}}}, fly: {{duration: 9 ms, trigger: {{output: gantry.a, gate: true, pulse: 1 ms}}}}",
        "`gate` and `pulse`",
    ),
    (f"axes: {{{LINE}}}, fly: {{duration: 0 ms}}", "the least is 1 ms"),
    (
        f"axes: {{{LINE}}}, fly: {{duration: 10 ms}}, at_each: [{{do: dwell, duration: 1 ms}}]",
        "nothing runs in `at_each`",
    ),
    ("axes: {gantry.x: {values: [0]}}, fly: {duration: 10 ms}", "gantry.x has one point"),
    ("points: {axes: [gantry.x], rows: [[0], [1]]}, fly: {duration: 10 ms}", "needs the lines of `axes`"),
    (f"axes: {{slide.y: {{values: [0]}}, {LINE}}}, fly: {{axis: [slide.y]}}", "the last of `axes` are gantry.x"),
    (f"axes: {{{LINE}}}, fly: {{axis: [slide.y, gantry.x]}}", "must be the last ones"),
    (f"axes: {{{LINE}}}, fly: {{axis: [gantry.x, gantry.x]}}", "each once"),
    (
        f"axes: {{slide.y: {{values: [0, 1]}}, {LINE}}}, fly: {{axis: [slide.y, gantry.x]}}",
        "as many points each; slide.y has 2, gantry.x has 21",
    ),
    (
        f"axes: {{slide.y: {{from: 0, to: 1, points: 21, snake: true}}, {LINE}}}, fly: {{axis: [slide.y, gantry.x]}}",
        "the same `snake` for slide.y, gantry.x",
    ),
    (f"axes: {{{LINE}}}, fly: {{duration: 10 ms, trigger: {{output: camera}}}}", "is not an output"),
    (
        "axes: {gantry.x: {from: 0, to: 300, points: 10001}}, fly: {duration: 10 ms, trigger: {output: gantry.camera}}",
        "at most 10000 places",
    ),
]


@pytest.mark.parametrize(("fields", "words"), WRONG)
def test_a_file_says_what_is_wrong_with_fly(fields: str, words: str) -> None:
    with pytest.raises(FileError) as refused:
        forecast(fields)
    assert words in str(refused.value)


def test_an_output_that_the_job_switches_is_no_trigger() -> None:
    switch = f"{HOME}, {{do: output, output: gantry.camera, value: true}}"
    fields = f"axes: {{{LINE}}}, fly: {{duration: 10 ms, trigger: {{output: gantry.camera}}}}"
    with pytest.raises(FileError, match=r"fly.trigger: output gantry.camera is switched"):
        forecast(fields, switch)


def test_an_axis_that_wraps_is_refused() -> None:
    plain = FLEET.to_plain()
    axis = plain["controllers"]["gantry"]["axes"]["x"]
    axis |= {"kind": "rotary", "unit": "deg", "wrap": 360}
    del axis["soft_limits"]
    scan = Scan(axes={"gantry.x": {"from": 0, "to": 10, "points": 21}}, fly={"duration": "10 ms"})
    with pytest.raises(Refusal, match="wraps"):
        plan_lines(scan, Fleet.model_validate(plain))


def test_windows_are_as_short_as_the_axis_and_the_detector_allow() -> None:
    way = {"from": 0, "to": 10, "step": 0.5}
    limit = FLEET.axis("gantry.x").limits.velocity
    assert lines({}, gantry_x=way).speed == pytest.approx(min(limit, 500.0))
    assert lines({"detector": {"max_rate": 50}}, gantry_x=way).window_s == pytest.approx(0.02)
    assert lines({"detector": {"dead_time": "30 ms"}}, gantry_x=way).window_s == pytest.approx(0.03)
    with pytest.raises(Refusal, match="last 10 ms; the detector takes one in 20 ms"):
        lines({"duration": "10 ms", "detector": {"max_rate": 50}}, gantry_x=way)


def test_a_gate_ends_before_the_next_window_by_the_dead_time() -> None:
    fly = {"duration": "40 ms", "trigger": {"output": "gantry.camera", "gate": True}, "detector": {"dead_time": "5 ms"}}
    found = lines(fly, gantry_x={"from": 0, "to": 10, "step": 0.5})
    (trigger,) = found.make_triggers(0)
    assert trigger.pulse == 35_000_000 and trigger.at is not None and trigger.at[:2] == [-0.25, 0.25]


TOGETHER = (
    "axes: {slide.y: {from: 10, to: 12.5, points: 21, snake: true}, gantry.x: {from: 20, to: 30, points: 21, "
    "snake: true}}, fly: {axis: [gantry.x, slide.y], duration: 10 ms"
)


@pytest.mark.parametrize("snake", [True, False])
def test_axes_that_fly_together_stay_on_their_line(snake: bool) -> None:
    ends = {"slide_y": (10, 12.5), "gantry_x": (20, 30)}
    axes = {name: {"from": begin, "to": end, "points": 21, "snake": snake} for name, (begin, end) in ends.items()}
    found = lines(
        {"axis": ["slide.y", "gantry.x"], "duration": "10 ms"}, lift_z={"from": 0, "to": 2, "points": 3}, **axes
    )
    flight = plan_flight(found, FLEET, (0, 63))
    motion = flight.motion
    times_s = np.linspace(0.0, motion.duration_s, 5001)
    places, speeds, *_ = motion.evaluate(times_s)
    off = np.abs((places[:, 2] - 20) - 4 * (places[:, 1] - 10))
    is_on_line = (times_s <= flight.lines[0].end_s) | (times_s >= flight.lines[-1].begin_s)
    for line in flight.lines:
        in_line = (times_s > line.begin_s) & (times_s < line.end_s)
        is_on_line |= in_line
        assert np.abs(np.abs(speeds[in_line]) - [0.0, 12.5, 50.0]).max() < 1e-9
    assert off[is_on_line].max() < 1e-9
    # Each axis has its part of the run-up, also where they turn round.
    begin, end, _ = found.ends
    assert (places[:, 1:].min(axis=0) >= np.array(begin) - 1e-9).all()
    assert (places[:, 1:].max(axis=0) <= np.array(end) + 1e-9).all()
    assert (begin[1] - 20) == pytest.approx(4 * (begin[0] - 10)) and begin[0] < 10 - 0.0625


def test_the_axes_of_a_line_stop_on_it_where_the_others_take_longer() -> None:
    axes = {name: {"from": 20, "to": 30, "points": 21, "snake": True} for name in ("slide_y", "gantry_x")}
    fly = {"axis": ["slide.y", "gantry.x"], "duration": "10 ms"}
    found = lines(fly, lift_z={"from": 0, "to": 60, "points": 3}, **axes)
    flight = plan_flight(found, FLEET, (0, 63))
    places = flight.motion.evaluate(np.linspace(0.0, flight.duration_s, 5001))[0]
    assert np.abs(places[:, 1] - places[:, 2]).max() < 1e-9
    assert found.ends.begin[0] - 1e-9 <= places[:, 1].min() and places[:, 1].max() <= found.ends.end[0] + 1e-9


def test_the_forecast_of_axes_that_fly_together() -> None:
    found = forecast(TOGETHER + "}")
    assert not found.problems, found.problems
    assert found.steps[1].lines == (
        "slide.y and gantry.x fly through 21 points at 51.5388 mm/s along their line, 10 ms each, with a run-up and a "
        "run-down of 2.579 mm; a line takes 0.410 s"
    )
    outer = TOGETHER.replace("axes: {", "axes: {lift.z: {from: 0, to: 2, points: 5}, ")
    found = forecast(outer + "}")
    assert not found.problems, found.problems
    assert "5 lines are one motion of 1.850 s" in found.steps[1].lines, found.steps[1].lines


@pytest.mark.parametrize(
    ("fields", "code", "words", "remedy"),
    [
        (
            TOGETHER.replace("10 ms", "2 ms") + "}",
            "fly-speed",
            "gantry.x flies at 250 mm/s through windows of 0.5 mm; its limit is 200 mm/s",
            "`duration: 2.501 ms`",
        ),
        (
            TOGETHER.replace("from: 10, to: 12.5", "from: 297, to: 299.5") + "}",
            "fly-room",
            "slide.y needs 0.6255 mm before and behind its windows for 12.5 mm/s; its lines reach 300.188 mm, "
            "0.188 mm beyond its soft limit 300 mm",
            "`duration: 12",
        ),
        (TOGETHER.replace("from: 10, to: 12.5", "from: 10, to: 10") + "}", "fly-spacing", "slide.y", "of `fly.axis`"),
        (TOGETHER.replace("slide.y", "slide.r") + "}", "unknown-name", "slide.r", ""),
    ],
)
def test_axes_that_cannot_fly_together_are_refused_with_what_fits(
    fields: str, code: str, words: str, remedy: str
) -> None:
    (problem,) = forecast(fields).problems
    assert problem.code == code and words in problem.text and remedy in problem.remedy, problem
    if "`duration" in remedy:
        duration = problem.remedy.split("`")[1].removeprefix("duration: ")
        assert not forecast(fields.replace(fields.split("duration: ")[1].rstrip("}"), duration)).problems


def test_axes_that_fly_together_have_one_unit() -> None:
    plain = FLEET.to_plain()
    plain["controllers"]["slide"]["axes"]["y"]["unit"] = "deg"
    (problem,) = forecast(TOGETHER + "}", fleet=Fleet.model_validate(plain)).problems
    assert problem.code == "fly-axis" and "slide.y in deg, gantry.x in mm" in problem.text
