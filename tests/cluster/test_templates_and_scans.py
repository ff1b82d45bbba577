"""Templates, scans, repeats and named positions together, on the virtual demo fleet."""

from pathlib import Path

import pytest
from cluster.worlds import EXAMPLES, PREPARE, demo_fleet, job, outcome, run_fleet, wait_for_point

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.steps.scan import Scan
from orchestrator.model.templates.template import Template
from orchestrator.runtime.virtual.fleet import VirtualFleet

FLEET = Fleet.model_validate(
    demo_fleet().to_plain()
    | {
        "positions": {
            "sample": {"gantry.x": "12 mm", "stage.u": "3 mm"},
            "slide": {"gantry.y": 4, "stage.v": "1 mm"},
            "outside": {"stage.u": 50, "gantry.y": 0},
        }
    }
)

TEMPLATE = """schema: tutti.job/1
name: lines ${label}
parameters:
  first: {type: quantity, unit: mm, default: 10 mm}
  last: {type: text, default: sample, choices: [sample, slide]}
  points: {type: integer, default: 3, min: 2, max: 5}
  passes: {type: integer, default: 2, min: 1, max: 3}
  label: {type: text, default: test}
steps:
  - do: repeat
    times: ${passes}
    steps:
      - do: scan
        axes:
          stage.u: {values: [sample, 2]}
          gantry.x: {from: "${first}", to: "${last}", points: "${points}", snake: true}
        at_each:
          - {do: move, to: slide}
          - {do: move, by: {gantry.y: "-${first}"}}
  - {do: move, to: sample}
"""


async def refused(call: object) -> Refusal:
    with pytest.raises(Refusal) as caught:
        await call  # type: ignore[misc]
    return caught.value


def test_a_template_scans_from_a_parameter_to_a_named_position(tmp_path: Path) -> None:
    path = tmp_path / "lines.job.yaml"
    path.write_text(TEMPLATE, encoding="utf-8")

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        submitted = await client.submit(path, parameters={"first": "1 cm", "label": "here"})
        report = await client.wait_for_job(submitted)
        assert report.state == "done", report.reason
        assert report.name == "lines here"
        assert report.parameters_used == {
            "first": "1 cm", "last": "sample", "points": "3", "passes": "2", "label": "here",
        }  # fmt: skip
        used = {"sample": {"gantry.x": "12 mm", "stage.u": "3 mm"}, "slide": {"gantry.y": "4 mm", "stage.v": "1 mm"}}
        assert report.positions_used == used
        lines = [(3.0, x) for x in (10.0, 11.0, 12.0)] + [(2.0, x) for x in (12.0, 11.0, 10.0)]
        assert [tuple(each.target.values()) for each in await client.load_points(report.job_id)] == lines * 2
        # Two passes of six points with three steps each; each pass of the scan is one entry.
        assert [(step.index, step.do) for step in report.steps] == [(0, "scan"), (18, "scan"), (36, "move")]
        states = await client.status()
        assert round(states["gantry"].axes["x"].position, 3) == 12 and round(states["gantry"].axes["y"].position) == -6
        # The names stay in the job, so a re-run from a point takes what is saved by then.
        shown = await client.show_job(report.job_id)
        assert shown.job is not None and shown.job.steps == Template.load(path).fill(first="1 cm").steps
        await client.save_position("sample", at={"gantry.x": 20, "stage.u": "5 mm"})
        again = await client.retry_job(report.job_id, (18, 4))
        second = await client.wait_for_job(again.job_id)
        assert second.state == "done" and second.positions_used["sample"] == {"gantry.x": "20 mm", "stage.u": "5 mm"}
        assert [tuple(each.target.values()) for each in await client.load_points(again.job_id)] == [
            (2.0, 20.0), (2.0, 15.0), (2.0, 10.0),
        ]  # fmt: skip
        wrong = await refused(client.submit(path, parameters={"last": "slide"}))
        assert wrong.code == "not-in-position"
        assert "slide has no value for gantry.x; it has: gantry.y, stage.v" in wrong.text

    run_fleet(main, FLEET)


def test_steps_between_named_positions_are_chained_in_every_pass() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        there = "{do: move, to: {gantry.x: sample}}, {do: move, to: {gantry.x: 2}}"
        report = await outcome(fleet, job(f"[{{do: repeat, times: 3, steps: [{there}]}}]"))
        assert report.state == "done", report.reason
        assert [step.chain is not None and step.chain.kept for step in report.steps] == [False, *[True] * 5]
        assert report.positions_used == {"sample": {"gantry.x": "12 mm"}}

    run_fleet(main, FLEET)


def test_values_are_fixed_for_all_points_of_a_run() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        scan = "{do: scan, axes: {gantry.x: {from: sample, to: 0, points: 5}}, at_each: [{do: dwell, duration: 50 ms}]}"
        job_id = await client.submit(job(f"[{{do: repeat, times: 2, steps: [{scan}]}}]"))
        await wait_for_point(fleet, job_id, 2)
        await client.save_position("sample", at={"gantry.x": 100})
        report = await client.wait_for_job(job_id)
        assert report.state == "done" and report.positions_used == {"sample": {"gantry.x": "12 mm"}}
        points = await client.load_points(job_id)
        assert [each.target["gantry.x"] for each in points] == [12.0, 9.0, 6.0, 3.0, 0.0] * 2

    run_fleet(main, FLEET)


def test_a_table_of_points_may_name_positions() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        rows = "[[0, 1], [sample, sample], [5, sample]]"
        report = await outcome(fleet, job(f"[{{do: scan, points: {{axes: [gantry.x, stage.u], rows: {rows}}}}}]"))
        assert report.state == "done", report.reason
        points = await client.load_points(report.job_id)
        assert [tuple(each.target.values()) for each in points] == [(0.0, 1.0), (12.0, 3.0), (5.0, 3.0)]
        assert report.positions_used == {"sample": {"gantry.x": "12 mm", "stage.u": "3 mm"}}

    run_fleet(main, FLEET)


@pytest.mark.parametrize(
    ("steps", "code", "text"),
    [
        ("{do: scan, axes: {gantry.x: {from: 0, to: sampel, points: 3}}}", "unknown-name", "did you mean sample?"),
        ("{do: scan, axes: {gantry.y: {values: [0, sample]}}}", "not-in-position", "sample has no value for gantry.y"),
        ("{do: scan, points: {axes: [gantry.x], rows: [[slide]]}}", "not-in-position", "slide has no value for gantry"),
        (
            "{do: scan, axes: {gantry.x: {values: [0, 1]}}, at_each: [{do: move, to: sample}]}",
            "bad-step",
            "at_each[0] moves gantry.x by a position, and the scan positions it",
        ),
        (
            "{do: scan, axes: {gantry.x: {values: [0, 1]}}, at_each: [{do: move, to: {gantry.y: sampel}}]}",
            "unknown-name",
            "no position sampel",
        ),
        ("{do: repeat, times: 3, steps: [{do: move, to: sampel}]}", "unknown-name", "no position sampel"),
        (
            "{do: repeat, times: 9, steps: [{do: move, to: outside}, {do: move, by: {stage.u: 1}}]}",
            "soft-limit",
            "steps[0].steps[1] (move): axis stage.u: target 51 mm is beyond its soft limits",
        ),
        (
            "{do: scan, axes: {stage.v: {from: 0, to: 51, points: 3}, gantry.x: {from: sample, to: 0, points: 4}}}",
            "soft-limit",
            "at point 9 of 12 (stage.v 51, gantry.x 12)",
        ),
    ],
)  # fmt: skip
def test_wrong_names_inside_scans_and_repeats_are_refused_when_the_job_is_submitted(
    steps: str, code: str, text: str
) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        wrong = await refused(fleet.make_client().submit(job(f"[{steps}]")))
        assert (wrong.code, text in wrong.text) == (code, True), wrong.text
        if code != "soft-limit":
            assert (await refused(fleet.make_client().dry_run(job(f"[{steps}]")))).code == code

    run_fleet(main, FLEET)


def test_a_rerun_inside_the_last_pass_needs_no_position_of_the_steps_before() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        await client.save_position("here", at={"gantry.x": 10})
        inner = "{do: repeat, times: 2, steps: [{do: move, to: {gantry.x: 1}}, {do: dwell, duration: 1 ms}]}"
        done = await outcome(fleet, job(f"[{{do: move, to: here}}, {inner}, {{do: move, to: sample}}]"))
        assert done.state == "done" and set(done.positions_used) == {"here", "sample"}
        await client.remove_position("here")
        assert (await refused(client.retry_job(done.job_id, 0))).code == "unknown-name"
        again = await client.retry_job(done.job_id, 4)
        assert again.steps[-1] == "6 move to sample"
        report = await client.wait_for_job(again.job_id)
        assert report.state == "done" and set(report.positions_used) == {"sample"}

    run_fleet(main, FLEET)


def test_the_example_scans_from_the_sample_of_the_demo_fleet() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await client.save_position("sample", at={"gantry.x": 30, "stage.u": 6})
        template = Template.load(EXAMPLES / "scan.template.job.yaml")
        filled = template.fill(points=4, width="3 mm", lines=2)
        assert any(isinstance(step, Scan) for step in filled.steps)
        report = await outcome(fleet, filled)
        assert report.state == "done", report.reason
        points = await client.load_points(report.job_id)
        lines = [(6.0, x) for x in (0.0, 1.0, 2.0, 3.0)] + [(7.0, x) for x in (3.0, 2.0, 1.0, 0.0)]
        assert [tuple(each.target.values()) for each in points] == lines

    run_fleet(main)
