"""`tutti path import`: paths of other programs as job files."""

import json
from pathlib import Path

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import json_option, print_result
from orchestrator.cli.base.errors import exit_with_error, expected_errors


@click.command(
    "import",
    epilog="""\b
Examples:
  tutti path import part.ngc --axis X=gantry.x --axis Y=gantry.y --to part.job.yaml
  tutti path import points.csv --to points.job.yaml
  tutti path import arm.trajectory.yaml --axis joint_1=arm.a --to arm.job.yaml""",
)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--to", "target", type=click.Path(path_type=Path), required=True, help="The job file that is written.")
@click.option(
    "--axis",
    "axes",
    multiple=True,
    metavar="NAME=AXIS",
    help="A letter, column or joint of the file, and its axis of the fleet; repeat it for others.",
)
@click.option(
    "--from",
    "starts",
    multiple=True,
    metavar="LETTER=MM",
    help="Where an axis of G-code stands before it, in mm; without it at 0.",
)
@click.option(
    "--tolerance",
    default="200 um",
    show_default=True,
    help="How far the axes may be off the path; a job for which that cannot be guaranteed is refused before it moves.",
)
@click.option("--force", is_flag=True, help="Write over a file that is there.")
@json_option
def import_path(
    file: Path,
    target: Path,
    axes: tuple[str, ...],
    starts: tuple[str, ...],
    tolerance: str,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Write the path in FILE as a job file: G-code (.ngc, .gcode, .nc), a table of points (.csv), or a joint trajectory
    (.yaml, .json).

    Of G-code: G0 to G4, G17 to G21, G61, G64 P, G90, G91, F. Anything else is refused with its line and column, and
    then nothing is written.
    """
    from orchestrator.model.jobs.files import validate_value
    from orchestrator.model.jobs.job import Job
    from orchestrator.model.paths.files.imported import make_job
    from orchestrator.model.paths.files.reading import read_path_file

    if target.exists() and not force:
        exit_with_error(f"{target} is there already", BAD_INPUT, "choose another name, or give --force")
    axis_names = _read_pairs(axes, "--axis")
    places = {letter.upper(): _read_number(value, letter) for letter, value in _read_pairs(starts, "--from").items()}
    with expected_errors():
        path_steps = read_path_file(file, axis_names, places)
    steps = [{**step, "tolerance": tolerance} if step["do"] == "path" else step for step in path_steps]
    name = file.stem[:60]
    job, problems = validate_value(make_job(name, steps), Job)
    if job is None:
        problem_list = "; ".join(f"{'.'.join(map(str, problem.place))} {problem.text}" for problem in problems[:5])
        exit_with_error(f"{file}: the job would not be valid: {problem_list}", BAD_INPUT)
    # JSON is YAML: each step in a line of its own can be compared and edited.
    lines = ",\n  ".join(json.dumps(step, ensure_ascii=False) for step in steps)
    text = f'{{"schema": "tutti.job/1", "name": {json.dumps(name)}, "steps": [\n  {lines}\n]}}\n'
    with expected_errors():
        target.write_text(text, encoding="utf-8")
    pieces = sum(len(step.get("pieces", ())) for step in steps)
    words = f"{target}: {len(steps)} step{'s' * (len(steps) != 1)} with {pieces} pieces; `tutti path plot` shows them"
    print_result({"file": str(target), "steps": len(steps), "pieces": pieces}, words, as_json=as_json)


def _read_pairs(words: tuple[str, ...], option: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not sign or not name or not value:
            exit_with_error(f"{option} {word}: write NAME=VALUE", BAD_INPUT, f"for example {option} X=gantry.x")
        pairs[name] = value
    return pairs


def _read_number(text: str, letter: str) -> float:
    try:
        return float(text.removesuffix("mm"))
    except ValueError:
        exit_with_error(f"--from {letter}={text}: write a number of mm", BAD_INPUT, f"for example --from {letter}=12.5")
