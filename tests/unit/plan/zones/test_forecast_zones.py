"""Zones in forecasts: problems, what depends on the world, and steps of which is said that they were not checked."""

from fractions import Fraction
from pathlib import Path

import pytest

from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.forecast import AxisForecast, JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.plan.forecast.job import JobForecaster, forecast_job

EXAMPLE = load_fleet(Path(__file__).parents[4] / "deploy" / "examples" / "zones.fleet.yaml")
HOME = "{do: home}"
RAISE, OVER, LOWER = (f"{{do: move, to: {{{target}}}}}" for target in ("gantry.z: 60", "gantry.x: 230", "gantry.z: 0"))


def make_fleet(homes_away: Sequence[str], **controllers: Any) -> Fleet:
    """The example with other axes whose homing leads away."""
    plain = EXAMPLE.to_plain()
    plain["zones"]["homes_away"] = list(homes_away)
    for name, fields in controllers.items():
        plain["controllers"][name] |= fields
    return Fleet.model_validate(plain)


FLEET = make_fleet(EXAMPLE.axis_names)


def read_steps(text: str) -> Job:
    return parse_document(f"schema: tutti.job/1\nname: test\nsteps: [{text}]\n", Job, "test")


def forecast(text: str) -> JobForecast:
    return forecast_job(FLEET, read_steps(text).steps)


def list_problems(checked: JobForecast) -> list[tuple[object, str]]:
    return [(problem.place[1], problem.code) for problem in checked.problems]


def list_notes(checked: JobForecast) -> list[list[str]]:
    return [[note for note in step.conditions if "zone" in note] for step in checked.steps]


def test_the_step_that_brings_bodies_together_is_the_problem() -> None:
    assert list_problems(forecast(f"{HOME}, {RAISE}, {OVER}")) == []
    checked = forecast(f"{HOME}, {RAISE}, {OVER}, {LOWER}")
    assert list_problems(checked) == [(3, "zone")]
    assert checked.problems[0].text.startswith("zone detector-sample: ")


def test_what_only_the_world_knows_is_a_condition_and_no_problem() -> None:
    checked = forecast(f"{RAISE}, {OVER}")
    assert list_problems(checked) == []
    conditions = list_notes(checked)
    assert "gantry.x, gantry.z, stage.phi, stage.u stand where zone detector-sample allows it" in conditions[0]
    assert all(note.endswith("allows it") for notes in conditions for note in notes)
    # Once all axes are known, nothing is left open.
    assert list_notes(forecast(f"{HOME}, {RAISE}, {OVER}"))[1:] == [[], []]


def test_an_axis_that_the_fleet_knows_to_be_without_a_reference_is_a_problem() -> None:
    """In a dry run the states of all axes are known: no run will find it at a place."""
    axes = {
        name: AxisForecast(motor=Fraction(0), known=True, enabled=True, referenced=name != "stage.phi")
        for name in FLEET.axis_names
    }
    forecaster = JobForecaster(FLEET, axes)
    for index, step in enumerate(read_steps("{do: move, to: {gantry.x: 152}}").steps):
        forecaster.take(index, step)
    (problem,) = forecaster.problems
    assert problem.code == "zone" and "the position of stage.phi is not known" in problem.text
    assert problem.remedy.startswith("home stage.phi")


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (HOME, "not checked against zones: home of gantry.x, gantry.z, stage.u, stage.phi"),
        (
            "{do: path, axes: [gantry.x, gantry.z], start: [0, 0], tolerance: 100 um, "
            "pieces: [{piece: line, to: [50, 40]}, {piece: line, to: [60, 0]}]}",
            "not checked against zones: path of gantry.x, gantry.z",
        ),
        (
            "{do: repeat, times: 9, steps: [{do: move, by: {gantry.x: 1}}]}",
            "not checked against zones in pass 4 to 8",
        ),
    ],
)
def test_a_step_that_is_not_checked_says_so(steps: str, words: str) -> None:
    checked = forecast(f"{HOME}, {steps}")
    assert words in [note for notes in list_notes(checked) for note in notes]


def test_a_target_that_is_measured_is_not_called_checked() -> None:
    plain = FLEET.to_plain()
    plain["controllers"]["gantry"]["inputs"] = {"touch": {"number": 1}}
    fleet = FLEET.model_validate(plain)
    probe = "{do: probe, name: EDGE, to: {gantry.x: 50}, until: gantry.touch, speed: 1 mm/s}"
    job = read_steps(f"{HOME}, {probe}, {{do: move, to: {{gantry.x: {{of: EDGE.x, plus: 5}}, gantry.z: 20}}}}")
    notes = list_notes(forecast_job(fleet, job.steps))
    assert any("not checked against zones: move of" in note for note in notes[2]), notes


def test_a_fleet_without_zones_says_nothing() -> None:
    plain = {name: part for name, part in FLEET.to_plain().items() if name != "zones"}
    checked = forecast_job(FLEET.model_validate(plain), read_steps(f"{HOME}, {OVER}, {LOWER}").steps)
    assert list_problems(checked) == [] and list_notes(checked) == [[], [], []]
