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
    path.write_text(text + "groups: {all: [smc30.q]}\n")
    shown = run("fleet", "check", str(path))
    assert shown.exit_code == 2
    assert "groups.all[0]: the fleet has no axis smc30.q; did you mean smc30.z?" in shown.output
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
