"""Jobs run forward on paper: unknown positions, limits, names, durations, conditions."""

from fractions import Fraction
from pathlib import Path

import pytest

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.forecast import AxisForecast, JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.plan.forecast.job import JobForecaster, forecast_job

DEMO = Path(__file__).parents[3] / "deploy" / "examples" / "demo.fleet.yaml"
FLEET = load_fleet(DEMO).model_copy(update={"positions": {}})  # axes are changed below


def steps(text: str) -> Job:
    return parse_document(f"schema: tutti.job/1\nname: test\nsteps: {text}\n", Job, "test")


def forecast(text: str, fleet: Fleet = FLEET, repeat: int = 1) -> JobForecast:
    return forecast_job(fleet, steps(text).steps, repeat)


def texts(found: JobForecast) -> list[str]:
    return [f"{problem.place[1]} {problem.code}: {problem.text}" for problem in found.problems]


def changed(**axis: object) -> Fleet:
    plain = FLEET.to_plain()
    plain["controllers"]["gantry"]["axes"]["x"] |= axis
    return Fleet.model_validate(plain)


HUNDRED = "{do: move, by: {gantry.x: 100}}"


def test_moves_by_a_distance_are_added_up_from_an_unknown_position() -> None:
    assert texts(forecast(f"[{', '.join([HUNDRED] * 4)}]")) == []
    found = forecast(f"[{', '.join([HUNDRED] * 4)}]")
    assert "gantry.x stands between -10 and 0 mm (motor position) before step 1" in found.conditions
    assert texts(forecast(f"[{', '.join([HUNDRED] * 5)}]")) == [
        "4 soft-limit: axis gantry.x: the moves from step 1 (`steps[0]`) on cover 500 mm; its soft limits are 410 mm apart"
    ]
    assert texts(forecast(f"[{HUNDRED}, {HUNDRED}]", repeat=3)) == [
        "0 soft-limit: axis gantry.x: the moves from step 1 (`steps[0]`) on cover 500 mm; its soft limits are 410 mm apart"
    ]


def test_from_homing_on_positions_are_known() -> None:
    home = "{do: home, axes: [gantry]}"
    assert texts(forecast(f"[{home}, {', '.join([HUNDRED] * 5)}]")) == [
        "5 soft-limit: axis gantry.x: target 500 mm is beyond its soft limits -10 to 400 mm"
    ]
    # A mistake is reported once; from a target that is given the axis is followed again.
    again = f"[{home}, {', '.join([HUNDRED] * 7)}, {{do: move, to: {{gantry.x: 350}}}}, {HUNDRED}]"
    assert [text[:12] for text in texts(forecast(again))] == ["5 soft-limit", "9 soft-limit"]


def test_set_position_shifts_targets_and_not_soft_limits() -> None:
    known = "{do: home, axes: [gantry]}, {do: move, to: {gantry.x: 100}}, {do: set-position, axes: {gantry.x: 0}}"
    assert texts(forecast(f"[{known}, {{do: move, to: {{gantry.x: 300}}}}]")) == []
    assert texts(forecast(f"[{known}, {{do: move, to: {{gantry.x: 301}}}}]")) == [
        "3 soft-limit: axis gantry.x: target 301 mm is beyond its soft limits -110 to 300 mm"
    ]
    unknown = "{do: set-position, axes: {gantry.x: 0}}, {do: move, to: {gantry.x: 300}}"
    assert (
        "gantry.x stands between -10 and 100 mm (motor position) before step 1" in forecast(f"[{unknown}]").conditions
    )
    assert texts(forecast(f"[{unknown}, {{do: move, to: {{gantry.x: -200}}}}]")) == [
        "2 soft-limit: axis gantry.x: the moves from step 1 (`steps[0]`) on cover 500 mm; its soft limits are 410 mm apart"
    ]
    lost = f"[{unknown}, {{do: home, axes: [gantry.x]}}, {{do: move, to: {{gantry.x: 999}}}}]"
    assert "the target of gantry.x in step 4 depends on its user offset" in forecast(lost).conditions
    cleared = "[{do: set-position, axes: {gantry.x: null}}, {do: move, to: {gantry.x: 401}}]"
    assert [text[:12] for text in texts(forecast(cleared))] == ["1 soft-limit"]


def test_an_axis_that_wraps_takes_the_turn_inside_its_limits() -> None:
    rotary = changed(kind="rotary", unit="deg", wrap=360, soft_limits={"min": -90, "max": 500}, shortest_way=True)
    text = "[{do: home, axes: [gantry.x]}, {do: move, to: {gantry.x: 300}}, {do: move, by: {gantry.x: 100}}]"
    forecaster = JobForecaster(rotary)
    for index, step in enumerate(steps(text).steps):
        forecaster.take(index, step)
    # 300° is reached as -60°; 300° itself is the longer way.
    assert forecaster.axes["gantry.x"].motor == 40


def test_motors_and_references() -> None:
    assert forecast("[{do: move, to: {gantry.x: 1}}]").conditions == [
        "gantry.x is enabled before the job",
        "gantry.x is referenced before the job",
        "user offsets (`set-position`) are 0 where no step sets them",
    ]
    off = "[{do: disable, axes: [gantry]}, {do: move, by: {gantry.x: 1}}, {do: move, by: {gantry.x: 1}}]"
    assert texts(forecast(off)) == ["1 not-enabled: axis gantry.x is not enabled"]
    assert (
        forecast("[{do: move, by: {gantry.x: 1}}]", changed(enable="per_job"))
        .conditions[0]
        .startswith("gantry.x is referenced")
    )
    state = AxisForecast(motor=Fraction(5), known=True, enabled=True, referenced=False)
    forecaster = JobForecaster(FLEET, {"gantry.x": state})
    forecaster.take(0, steps("[{do: move, by: {gantry.x: 1}}]").steps[0])
    assert [(each.code, each.remedy) for each in forecaster.problems] == [
        ("not-referenced", "add a step `do: home` before it")
    ]


def test_an_order_of_homing_that_contradicts_itself() -> None:
    waiting = changed(homing={"after": ["gantry.y"]})
    (problem,) = forecast("[{do: home, axes: [gantry.x, gantry.y]}]", waiting).problems
    assert problem.code == "homing-order"
    assert "gantry.y is referenced before the job" in forecast("[{do: home, axes: [gantry.x]}]", waiting).conditions


@pytest.mark.parametrize(
    ("step", "place", "text"),
    [
        ("{do: move, to: {gantry.q: 1}}", ["to", "gantry.q"], "did you mean gantry.y?"),
        ("{do: move, by: {gantry.x: 1 deg}}", ["by", "gantry.x"], "deg is a unit of angle"),
        ("{do: enable, axes: [gantry, nothing]}", ["axes", 1], "no axis, group or controller nothing"),
        ("{do: home, axes: [tabel]}", ["axes", 0], "did you mean table?"),
        ("{do: set-position, axes: {stage.u: 1 deg}}", ["axes", "stage.u"], "deg is a unit of angle"),
        ("{do: output, output: gantry.lmap, value: true}", ["output"], "did you mean gantry.lamp?"),
        ("{do: wait, input: gantry.door1, timeout: 1 s}", ["input"], "did you mean gantry.door?"),
        ("{do: move, to: {gantry.x: 1}, speed: 0.000001}", [], "split it into several steps"),
    ],
)
def test_mistakes_have_places(step: str, place: list[str | int], text: str) -> None:
    (problem,) = forecast(f"[{{do: home}}, {{do: move, to: {{gantry.x: 300}}}}, {step}]").problems
    assert problem.place == ["steps", 2, *place]
    assert text in problem.text


def test_outputs_that_serve_something_else() -> None:
    plain = FLEET.to_plain()
    gantry = plain["controllers"]["gantry"]
    gantry["outputs"] |= {"brake": {"number": 2}, "start": {"number": 3}}
    gantry["axes"]["x"]["brake"] = {"output": "brake", "release_s": 0.5}
    plain["controllers"]["stage"]["inputs"] = {"start": {"number": 1}}
    plain["wiring"] = [{"from": "gantry.start", "to": ["stage.start"]}]
    fleet = Fleet.model_validate(plain)
    outputs = ("gantry.brake", "gantry.start", "gantry.lamp", "gantry.lamp")
    found = forecast("[" + ", ".join(f"{{do: output, output: {name}, value: true}}" for name in outputs) + "]", fleet)
    assert texts(found) == [
        "0 output-in-use: output gantry.brake is the brake of gantry.x, which switches it by itself",
    ]
    assert found.steps[1].conditions == ["no controller waits for stage.start, which the output is wired to"]
    assert found.steps[3].conditions == ["gantry.lamp is active already"]
    assert forecast("[{do: enable, axes: [gantry]}]", fleet).least_s == 0.5


def test_durations() -> None:
    found = forecast(
        "[{do: home, axes: [gantry]}, {do: move, by: {gantry.x: 100}}, {do: move, to: {gantry.y: 0}}, "
        "{do: dwell, duration: 2 s}, {do: wait, input: gantry.door, timeout: 5 s}, {do: move, to: {stage.u: 0}}]"
    )
    assert [(step.least_s, step.most_s) for step in found.steps[:2]] == [(0, 30), (0.7, 0.7)]
    assert (found.steps[2].least_s, found.steps[2].most_s) == (0, 0)  # homed axes stand at 0
    assert [(step.least_s, step.most_s) for step in found.steps[3:5]] == [(2, 2), (0, 5)]
    # From anywhere inside its soft limits, -1 to 50 mm, at 10 mm/s and 50 mm/s².
    assert (found.steps[5].least_s, found.steps[5].most_s) == (0, pytest.approx(5.2))
    assert found.least_s == pytest.approx(2.7) and found.most_s == pytest.approx(30 + 0.7 + 2 + 5 + 5.2)
    unbounded = changed(soft_limits=None)
    assert forecast("[{do: move, to: {gantry.x: 5}}]", unbounded).most_s is None


@pytest.mark.nightly
def test_ten_thousand_steps() -> None:
    """Within the 10 s of CPU that are promised, with a wide margin for a busy machine."""
    import time

    began_s = time.process_time()
    moves = ", ".join(f"{{do: move, to: {{gantry.x: {k % 300}, stage.u: {k % 40}}}}}" for k in range(10_000))
    assert forecast(f"[{moves}]").problems == []
    assert time.process_time() - began_s < 10


def test_a_bare_speed_of_a_path_below_1_is_noted_with_its_unit() -> None:
    def path(speed: str) -> str:
        line = "{piece: line, to: [5]}"
        return f"[{{do: path, axes: [gantry.x], start: [0], pieces: [{line}], tolerance: 0.1, speed: {speed}}}]"

    assert (
        'speed 0.5 is 0.5 mm/s along the path; if a part of what its axes allow is meant, write "50 %"'
    ) in forecast(path("0.5")).steps[0].conditions
    for speed in ('"0.5 mm/s"', '"50 %"', "1"):
        assert not [note for note in forecast(path(speed)).steps[0].conditions if "along the path" in note]
    assert "speed=0.5 units/s" in forecast(path("0.5")).steps[0].text  # not of the limits, as in a move
