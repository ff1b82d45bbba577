"""The drawing of scans that fly: lines that are flown together are one course."""

from pathlib import Path

import pytest

from orchestrator.gateway.preview import draw_job, draw_path
from orchestrator.model.jobs.files import load_fleet, parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.steps.order import StepOrder

FLEET = load_fleet(Path(__file__).parents[3] / "deploy" / "examples" / "path.fleet.yaml")
JOB = parse_document(
    "schema: tutti.job/1\nname: a\nsteps:\n"
    "  - {do: home}\n"
    "  - {do: scan, axes: {slide.y: {from: 0, to: 2, points: 5}, gantry.x: {from: 0, to: 10, points: 21, snake: true}},"
    " fly: {duration: 10 ms}}\n",
    Job,
    "test",
)


def test_all_lines_of_a_flight_are_drawn_once() -> None:
    drawn = draw_job(FLEET, [], {}, JOB)
    assert [entry["index"] for entry in drawn["steps"]] == [0, 1, 2]
    motion = drawn["steps"][2]
    assert 1.8 < motion["t1"] - motion["t0"] < 1.9  # five lines of 0.21 s, and what is around them
    outer = drawn["axes"]["slide.y"]
    assert outer["v"][-1] == 2.0 and outer["t"][-1] <= drawn["duration_s"]


def test_axes_that_fly_together_are_drawn_together() -> None:
    fields = "slide.y: {from: 0, to: 2, points: 5}, gantry.x: {from: 0, to: 4, points: 5}"
    fly = "fly: {axis: [slide.y, gantry.x], duration: 40 ms}"
    text = f"schema: tutti.job/1\nname: a\nsteps: [{{do: home}}, {{do: scan, axes: {{{fields}}}, {fly}}}]\n"
    drawn = draw_job(FLEET, [], {}, parse_document(text, Job, "test"))
    assert drawn["unknown"] is None or "step 1" in drawn["unknown"], drawn["unknown"]
    ends = {name: (min(line["v"]), max(line["v"])) for name, line in drawn["axes"].items()}
    assert ends["gantry.x"][0] == pytest.approx(2 * ends["slide.y"][0], abs=0.001)
    assert ends["gantry.x"][1] > 4.5 and ends["slide.y"][1] == pytest.approx(ends["gantry.x"][1] / 2, abs=0.001)


def test_the_path_of_a_line_goes_on_through_those_behind_it() -> None:
    order = StepOrder(JOB.steps)
    drawn = draw_path(FLEET, [], {}, order.locate(2))
    assert drawn["axes"]["slide.y"]["v"][-1] == 2.0
    assert max(drawn["axes"]["gantry.x"]["v"]) > 10.25
    assert draw_path(FLEET, [], {}, order.locate(8))["axes"]["slide.y"]["v"][0] == 1.5
