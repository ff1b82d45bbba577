"""Zones in forecasts: problems, what depends on the world, and steps of which is said that they were not checked."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.forecast import AxisForecast, JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.move import Move
from orchestrator.plan.forecast.job import JobForecaster, forecast_job
from orchestrator.plan.zones.sweeps import require_swept

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


def forecast(text: str, fleet: Fleet = FLEET) -> JobForecast:
    return forecast_job(fleet, read_steps(text).steps)


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


def test_passes_between_the_first_and_the_last_ones_are_checked_in_the_run() -> None:
    checked = forecast(f"{HOME}, {{do: repeat, times: 9, steps: [{{do: move, by: {{gantry.x: 1}}}}]}}")
    assert list_notes(checked)[1] == ["checked against zones in the run only: in pass 4 to 8"]


# Paths

PATH = (
    "{{do: path, axes: [gantry.x, gantry.z], start: [0, 0], tolerance: 100 um, "
    "pieces: [{{piece: line, to: [20, 60]}}, {{piece: line, to: [{0}, 60]}}, {{piece: line, to: [{0}, {1}]}}]}}"
)


def test_a_path_is_checked_piece_by_piece() -> None:
    checked = forecast(f"{HOME}, {PATH.format(230, 30)}")
    assert list_problems(checked) == [] and list_notes(checked)[1] == []
    checked = forecast(f"{HOME}, {PATH.format(230, 5)}")
    assert list_problems(checked) == [(1, "zone")]
    assert "zone detector-" in checked.problems[0].text and "after its start" in checked.problems[0].text


# Scans

SCAN = "{{do: scan, axes: {{gantry.x: {{from: {0}, to: {1}, points: 5}}}}, at_each: [{2}]}}"
DWELL = "{do: dwell, duration: 1 s}"


def test_a_scan_is_checked_as_a_whole_or_in_the_run() -> None:
    assert list_notes(forecast(f"{HOME}, {SCAN.format(0, 140, DWELL)}"))[1] == []
    notes = list_notes(forecast(f"{HOME}, {SCAN.format(0, 300, DWELL)}"))[1]
    assert notes == ["checked against zone detector-sample in the run only: the ways between points of the scan"]


def test_steps_at_points_count_with_all_points_of_a_scan() -> None:
    """The detector is lowered at each of them, and the last one alone is beside the arm."""
    lower = "{do: move, to: {gantry.z: 10}}, {do: move, to: {gantry.z: 60}}"
    far, near = (f"{HOME}, {RAISE}, {SCAN.format(begin, 100, lower)}" for begin in (0, 230))
    assert list_problems(forecast(far)) == [] and list_notes(forecast(far))[2] == []
    assert list_problems(forecast(near)) == []
    assert "gantry.x stands where zone detector-sample allows it" in list_notes(forecast(near))[2]


def test_a_scan_that_flies_in_one_motion_is_checked_along_it() -> None:
    lines = "{{gantry.z: {{from: 30, to: 60, points: 4}}, gantry.x: {{from: {}, to: {}, points: 30}}}}"
    fly = f"{{{{do: scan, axes: {lines}, fly: {{{{speed: 20 mm/s}}}}}}}}"
    assert list_notes(forecast(f"{HOME}, {RAISE}, {fly.format(20, 120)}"))[2] == []
    low = forecast(f"{HOME}, {RAISE}, {fly.format(150, 250).replace('from: 30', 'from: 5')}")
    assert list_problems(low) == [(2, "zone")], (low.problems, list_notes(low))


# Probes

TOUCHING = make_fleet(EXAMPLE.axis_names, gantry={"inputs": {"touch": {"number": 1}}})
PROBE = "{{do: probe, name: EDGE, to: {{gantry.x: {}}}, until: gantry.touch, speed: 1 mm/s}}"


def test_a_probe_is_checked_to_its_end_and_what_uses_its_contact_anywhere() -> None:
    assert list_problems(forecast(f"{HOME}, {PROBE.format(150)}", TOUCHING)) == []
    assert list_problems(forecast(f"{HOME}, {PROBE.format(160)}", TOUCHING)) == [(1, "zone")]
    use = "{{do: move, to: {{gantry.x: {{of: EDGE.x, plus: {}}}}}}}"
    assert list_problems(forecast(f"{HOME}, {PROBE.format(140)}, {use.format(5)}", TOUCHING)) == []
    checked = forecast(f"{HOME}, {PROBE.format(140)}, {use.format(20)}", TOUCHING)
    assert list_problems(checked) == [(2, "zone")]
    assert "somewhere on its way" in checked.problems[0].text


def test_where_a_user_counts_from_moves_no_body() -> None:
    count = "{do: set-position, axes: {gantry.x: 100}}"
    assert list_problems(forecast(f"{HOME}, {count}, {{do: move, to: {{gantry.x: 240}}}}")) == []
    assert list_problems(forecast(f"{HOME}, {count}, {{do: move, to: {{gantry.x: 300}}}}")) == [(2, "zone")]


# Homing


def make_forecaster(fleet: Fleet, **unknown: bool) -> JobForecaster:
    """Axes at 0, without a reference where they are named."""
    axes = {
        name: AxisForecast(
            motor=Fraction(0), known=True, enabled=True, referenced=not unknown.get(name.replace(".", "_"), False)
        )
        for name in fleet.axis_names
    }
    return JobForecaster(fleet, axes)


def take(forecaster: JobForecaster, text: str) -> list[str]:
    """The problems of steps, with their remedies."""
    for index, step in enumerate(read_steps(text).steps):
        forecaster.take(index, step)
    return [f"{problem.text}; {problem.remedy}" for problem in forecaster.problems]


def test_an_axis_that_is_homed_counts_as_anywhere() -> None:
    """Beside the arm x may go to 155 mm, and its range ends at 400."""
    fleet = make_fleet([])
    (text,) = take(make_forecaster(fleet, gantry_x=True), "{do: home, axes: [gantry.x]}")
    assert text.startswith("homing of gantry.x: zone ") and "anywhere between -5 and 400 mm" in text
    assert "no order of homing fits" in text
    assert take(make_forecaster(fleet, stage_u=True), "{do: home, axes: [stage.u]}") == []


def test_a_wrong_order_of_homing_is_refused_with_one_that_fits() -> None:
    """With x at its reference z may be anywhere, and with z at 0 the carriage; not both at once."""
    fleet = make_fleet(["gantry.x"])
    unknown = {"gantry_x": True, "gantry_z": True, "stage_u": True}
    (text,) = take(make_forecaster(fleet, **unknown), "{do: home, axes: [stage.u, gantry.x, gantry.z]}")
    assert "home in this order, each axis by itself: gantry.x, stage.u, gantry.z" in text, text
    assert take(make_forecaster(fleet, **unknown), "{do: home, axes: [gantry.x, gantry.z, stage.u]}") == []
    # Each by itself: axes of one entry move at the same time.
    (text,) = take(make_forecaster(fleet, **unknown), "{do: home, axes: [gantry, stage.u]}")
    assert "each axis by itself" in text


def test_a_homing_that_depends_on_what_is_referenced_is_a_condition() -> None:
    checked = forecast("{do: home}", make_fleet([]))
    assert list_problems(checked) == []
    assert list_notes(checked)[0][0].startswith("axes are referenced and stand where zones allow it: homing of ")


# The way out


def test_bodies_that_stand_too_near_may_be_moved_apart_and_no_nearer() -> None:
    def stand(x: float) -> JobForecaster:
        forecaster = make_forecaster(FLEET)
        forecaster.axes["gantry.x"] = forecaster.axes["gantry.x"].model_copy(update={"motor": Fraction(x)})
        return forecaster

    assert take(stand(156), "{do: move, to: {gantry.x: 20}}") == []
    assert take(stand(156), "{do: move, to: {gantry.z: 60}}") == []
    (text,) = take(stand(156), "{do: move, to: {gantry.x: 156.5}}")
    assert "they stand so where the step begins: jog gantry.x by about" in text and "negative direction" in text
    # Of bodies that touch, no distance says what leads out.
    (text,) = take(stand(200), "{do: move, to: {gantry.x: 20}}")
    assert "jog gantry.z by about" in text and "positive direction" in text


def test_a_kind_of_step_that_does_not_say_where_it_leads_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Move, "is_swept", False)
    step = Move(to={"gantry.x": 1})
    with pytest.raises(Refusal, match="where `do: move` may lead it is not known"):
        require_swept(FLEET, step)
    require_swept(FLEET.model_copy(update={"zones": None}), step)


def test_a_fleet_without_zones_says_nothing() -> None:
    plain = {name: part for name, part in FLEET.to_plain().items() if name != "zones"}
    checked = forecast_job(FLEET.model_validate(plain), read_steps(f"{HOME}, {OVER}, {LOWER}").steps)
    assert list_problems(checked) == [] and list_notes(checked) == [[], [], []]


def test_a_step_says_which_rules_rely_on_its_axes_keeping_step() -> None:
    plain = FLEET.to_plain()
    plain["zones"]["rules"]["detector-sample"]["trust_step"] = True
    both = "{do: move, to: {gantry.x: 50, stage.u: 10}}"
    notes = list_notes(forecast(f"{HOME}, {both}, {RAISE}", Fleet.model_validate(plain)))
    assert notes[1:] == [["gantry.x and stage.u keep step: zone detector-sample relies on it (trust_step)"], []]
    assert list_notes(forecast(f"{HOME}, {both}"))[1] == []
