"""`tutti job check`, `tutti fleet check` and `tutti fleet init`: what they print, and their exit codes."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from orchestrator.cli.main import main

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
DEMO = EXAMPLES / "demo.fleet.yaml"


def run(*words: str) -> Result:
    return CliRunner().invoke(main, list(words), env={"COLUMNS": "200"})


def job_file(folder: Path, *steps: str) -> Path:
    path = folder / "x.job.yaml"
    path.write_text("schema: tutti.job/1\nname: x\nsteps:\n" + "".join(f"  - {step}\n" for step in steps))
    return path


def test_a_job_is_checked_without_a_fleet_in_its_form_alone(tmp_path: Path) -> None:
    good = run("job", "check", str(job_file(tmp_path, "{do: move, to: {no.axis: 1}}")))
    assert (good.exit_code, "not checked: give --fleet FILE" in good.output) == (0, True)
    bad = run("job", "check", str(job_file(tmp_path, "{do: mvoe, to: {gantry.x: 1}}", "{do: dwell, duration: 5}")))
    assert bad.exit_code == 2
    assert "x.job.yaml:4: steps[0]: found 'mvoe' for 'do'" in bad.output
    assert "x.job.yaml:5: steps[1].duration: 5 is not a duration" in bad.output


def test_a_fleet_file_in_place_of_a_job_file_is_named_and_the_reverse() -> None:
    said = run("job", "check", str(DEMO))
    assert (said.exit_code, said.output.count("\n")) == (2, 1)
    assert "this is a fleet file; a job file is needed here" in said.output
    said = run("up", str(EXAMPLES / "demo.job.yaml"), "--sim")
    assert said.exit_code == 2
    assert "demo.job.yaml:2: schema: this is a job file; a fleet file is needed here" in said.output


def test_all_is_no_name_of_a_group_or_a_controller(tmp_path: Path) -> None:
    path = tmp_path / "x.fleet.yaml"
    text = (EXAMPLES / "smc30.fleet.yaml").read_text()
    path.write_text(text + "groups: {all: [smc30.z]}\n")
    assert "groups.all: `all` stands for the whole fleet" in run("fleet", "check", str(path)).output
    path.write_text(text.replace("smc30:", "all:"))
    assert "controllers.all: `all` stands for the whole fleet" in run("fleet", "check", str(path)).output


def test_a_job_is_checked_against_a_fleet_file(tmp_path: Path) -> None:
    demo = run("job", "check", str(EXAMPLES / "demo.job.yaml"), "--fleet", str(DEMO))
    assert demo.exit_code == 0
    assert "8 steps, 2.360 to 122.360 s: no problem found" in demo.output
    assert "the reference is found within 120 s" in demo.output
    steps = ("{do: home}", "{do: move, by: {gantry.x: 500}}", "{do: wait, input: gantry.dor, timeout: 1 s}")
    bad = run("job", "check", str(job_file(tmp_path, *steps)), "--fleet", str(DEMO))
    assert bad.exit_code == 2
    assert "x.job.yaml:5: steps[1].by.gantry.x: axis gantry.x: target 500 mm is beyond" in bad.output
    assert "x.job.yaml:6: steps[2].input: the fleet has no input gantry.dor; did you mean gantry.door?" in bad.output
    as_json = run("job", "check", str(job_file(tmp_path, *steps)), "--fleet", str(DEMO), "--json")
    assert as_json.exit_code == 2
    assert [each["place"] for each in json.loads(as_json.output)["problems"]] == [
        ["steps", 1, "by", "gantry.x"],
        ["steps", 2, "input"],
    ]


def test_repeats_are_checked(tmp_path: Path) -> None:
    path = str(job_file(tmp_path, "{do: move, by: {gantry.x: 100}}"))
    assert run("job", "check", path, "--fleet", str(DEMO), "--repeat", "4").exit_code == 0
    assert run("job", "check", path, "--fleet", str(DEMO), "--repeat", "5").exit_code == 2


def test_every_mistake_of_a_fleet_file_by_the_rules_of_its_makes(tmp_path: Path) -> None:
    path = tmp_path / "x.fleet.yaml"
    text = (EXAMPLES / "smc30.fleet.yaml").read_text()
    for old, new in (
        ("address: 1", "address: 9"),
        ("checksum: true", "chekcsum: true"),
        ('motors: ["1"]', 'motors: ["2"]'),
        ("method: default", "method: magic"),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text + "groups: {every: [smc30.q]}\n")
    shown = run("fleet", "check", str(path))
    assert shown.exit_code == 2
    assert "groups.every[0]: the fleet has no axis smc30.q; did you mean smc30.z?" in shown.output
    path.write_text(text)
    shown = run("fleet", "check", str(path))
    for expected in (
        "link.address: 9 is not an address; allowed: 1 to 7",
        "options.chekcsum: unknown field; did you mean checksum?",
        "axes.z.motors: '2' is not a motor",
        "axes.z.homing.method: 'magic' is unknown",
    ):
        assert f"controllers.smc30.{expected}" in shown.output
    assert "config" not in shown.output and "Traceback" not in shown.output


def test_init_writes_a_file_that_passes_the_check(tmp_path: Path) -> None:
    path = tmp_path / "my lab.fleet.yaml"
    done = run("fleet", "init", "--make", "smc4000:2", "--make", "smc30:3", "-o", str(path))
    assert done.exit_code == 0, done.output
    assert "5 controllers, 7 axes" in done.output and "--sim" in done.output
    assert run("fleet", "check", str(path)).exit_code == 0
    assert "fleet: my-lab" in path.read_text()
    again = run("fleet", "init", "--make", "smc4000", "-o", str(path))
    assert (again.exit_code, "--force" in again.output) == (2, True)
    assert run("fleet", "init", "--make", "smc4000", "-o", str(path), "--force", "--name", "lab7").exit_code == 0
    assert "fleet: lab7" in path.read_text()


@pytest.mark.parametrize(
    ("makes", "expected"),
    [
        (["smc400"], "known adapters: ascii, cia402, galil, ppsmc, shrc203, smc2000, smc30, smc4000"),
        (["smc30:0"], "must be 1 to 32"),
        (["smc30:x"], "must be 1 to 32"),
        (["smc30:²"], "must be 1 to 32"),
        (["smc30:3", "smc30"], "name each make once"),
        (["smc30:30", "smc4000:3"], "at most 32 controllers"),
    ],
)
def test_init_with_bad_makes(makes: list[str], expected: str) -> None:
    shown = run("fleet", "init", *(word for make in makes for word in ("--make", make)))
    assert shown.exit_code == 2
    assert expected in " ".join(shown.output.split())


def test_init_with_eight_smc30_is_refused_by_their_rule(tmp_path: Path) -> None:
    """Seven share a port: the file is written, and the check says what is wrong."""
    done = run("fleet", "init", "--make", "smc30:8", "-o", str(tmp_path / "x.yaml"))
    assert (done.exit_code, "8 is not an address; allowed: 1 to 7" in done.output) == (2, True)


TEMPLATE = """schema: tutti.job/1
name: x
parameters:
  width: {type: quantity, unit: mm, default: 10 mm, min: 1 mm, max: 500 mm, description: of a line}
  passes: {type: integer}
  lamp: {type: boolean, default: false}
steps:
  - do: move
    name: pass ${passes}
    to:
      gantry.x: ${width}
"""


def test_a_template_is_checked_with_its_values_and_at_the_ends_of_their_ranges(tmp_path: Path) -> None:
    path = tmp_path / "x.job.yaml"
    path.write_text(TEMPLATE)
    missing = run("job", "check", str(path), "--set", "with=3", "--set", "width=0.5mm")
    assert missing.exit_code == 2
    assert [line.strip().removeprefix("tutti: ") for line in missing.stderr.splitlines()] == [
        "--set: with: the job file has no parameter with; did you mean width? its parameters are: width, passes, lamp",
        "--set: width: found 0.5mm; must be at least 1 mm".replace("0.5mm", "'0.5mm'"),
        f"{path}:5: parameters.passes: has no default; give it a value: `--set passes=…`",
    ]
    good = run("job", "check", str(path), "--set", "passes=3", "--fleet", str(DEMO))
    assert good.exit_code == 0
    notes = [line for line in good.output.splitlines() if line.startswith("note:")]
    assert notes[0].endswith(":6: parameters.lamp: is declared and not used; write ${lamp}, or remove it")
    assert notes[1].startswith("note: with width=500 mm (its max): ")
    assert notes[1].endswith(
        ":11: steps[0].to.gantry.x: axis gantry.x: target 500 mm is beyond its soft limits -10 to 400 mm "
        "(${width} is 500 mm)"
    )
    values = tmp_path / "values.yaml"
    values.write_text("width: 450 mm\npasses: 2\n")
    bad = run("job", "check", str(path), "--set-file", str(values), "--fleet", str(DEMO))
    assert bad.exit_code == 2 and ":11: steps[0].to.gantry.x: axis gantry.x: target 450 mm is beyond" in bad.stderr
    over = run(
        "job", "check", str(path), "--set-file", str(values), "--set", "width=4cm", "--fleet", str(DEMO), "--json"
    )
    assert json.loads(over.output)["parameters_used"] == {"width": "4 cm", "passes": "2", "lamp": "false"}


SCANS = """schema: tutti.job/1
name: x
parameters:
  last: {type: quantity, unit: mm, default: 10 mm, min: 5 mm, max: 402 mm}
  table: {type: text, default: near, choices: [near, far, none]}
steps:
  - {do: repeat, times: 1000000, steps: [{do: scan, axes: {gantry.x: {from: sample, to: "${last}", points: 1000001}}}]}
  - {do: scan, points: {file: "${table}.csv"}}
"""


def test_the_check_runs_through_scans_and_tables_of_a_template_at_the_ends_of_their_ranges(tmp_path: Path) -> None:
    path = tmp_path / "x.job.yaml"
    path.write_text(SCANS)
    (tmp_path / "near.csv").write_text("gantry.x\n1\n2\n")
    (tmp_path / "far.csv").write_text("gantry.x\n1\n2\n403\n")
    found = run("job", "check", str(path), "--fleet", str(DEMO))
    assert found.exit_code == 0
    notes = [line for line in found.output.splitlines() if line.startswith("note:")]
    assert [note.partition(": ")[2].partition(": ")[0] for note in notes] == [
        "with last=402 mm (its max)", "with table=far (one of its choices)", "with table=none (one of its choices)",
    ]  # fmt: skip
    assert "target 402 mm is beyond its soft limits -10 to 400 mm, at point 1000001 of 1000001" in notes[0]
    assert ":8: steps[1]" in notes[1] and "at point 3 of 3 (gantry.x 403)" in notes[1]
    assert "none.csv: cannot be read" in notes[2]
    bad = run("job", "check", str(path), "--fleet", str(DEMO), "--set", "table=far")
    assert bad.exit_code == 2 and "target 403 mm is beyond its soft limits" in bad.stderr
    assert "with last=402 mm" not in bad.stderr


def test_the_parameters_of_a_job_file_are_listed_for_people_and_for_forms(tmp_path: Path) -> None:
    path = tmp_path / "x.job.yaml"
    path.write_text(TEMPLATE)
    rows = run("job", "parameters", str(path)).output.splitlines()
    assert rows[1].split() == ["width", "quantity", "mm", "10", "mm", "1", "mm", "to", "500", "mm", "of", "a", "line"]
    assert rows[2].split() == ["passes", "integer", "required"]
    listed = json.loads(run("job", "parameters", str(path), "--json").output)
    assert listed[0] == {
        "name": "width", "type": "quantity", "unit": "mm", "default": "10 mm", "min": "1 mm", "max": "500 mm",
        "choices": None, "description": "of a line", "required": False,
    }  # fmt: skip
    assert [each["required"] for each in listed] == [False, True, False]
    assert "has no parameters" in run("job", "parameters", str(EXAMPLES / "demo.job.yaml")).output
    path.write_text(TEMPLATE.replace("integer", "whole"))
    assert run("job", "parameters", str(path)).exit_code == 2


def test_named_positions_are_checked_offline_as_far_as_the_fleet_file_knows_them(tmp_path: Path) -> None:
    fleet = tmp_path / "x.fleet.yaml"
    text = DEMO.read_text()
    assert "{gantry.x: 120 mm, gantry.y: 80 mm, stage.u: 6 mm}" in text
    fleet.write_text(text.replace("{gantry.x: 120 mm, gantry.y: 80 mm, stage.u: 6 mm}", "{gantry.x: 390, stage.u: 2}"))
    steps = ("{do: move, to: sample}", "{do: move, by: {gantry.x: 20}}")
    beyond = run("job", "check", str(job_file(tmp_path, *steps)), "--fleet", str(fleet))
    assert beyond.exit_code == 2 and "steps[1].by.gantry.x: axis gantry.x: target 410 mm is beyond" in beyond.output
    # Where a saved one is, only the running fleet knows; what comes after it is not compared with an old place.
    steps = ("{do: move, to: sample}", "{do: move, to: {gantry.x: sampel}}", "{do: move, by: {gantry.x: 20}}")
    saved = run("job", "check", str(job_file(tmp_path, *steps)), "--fleet", str(fleet))
    assert (
        saved.exit_code == 0 and "position sampel is saved in the running fleet (did you mean sample?)" in saved.output
    )
    whole = run("job", "check", str(job_file(tmp_path, "{do: move, to: elsewhere}", steps[2])), "--fleet", str(fleet))
    assert whole.exit_code == 0 and "position elsewhere is saved in the running fleet" in whole.output
    without = run("job", "check", str(job_file(tmp_path, "{do: move, to: {gantry.y: sample}}")), "--fleet", str(fleet))
    assert without.exit_code == 2 and "position sample has no value for gantry.y" in without.output
