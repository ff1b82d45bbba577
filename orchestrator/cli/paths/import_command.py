"""`tutti path import`: paths of other programs as job files."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import json_option, print_result
from orchestrator.cli.base.errors import exit_with_error, expected_errors

if TYPE_CHECKING:
    from orchestrator.model.paths.gcode_settings import GcodeSettings


@click.command(
    "import",
    epilog="""\b
Examples:
  tutti path import part.ngc --axis X=gantry.x --axis Y=gantry.y --to part.job.yaml
  tutti path import part.ngc --axis X=gantry.x --gcode spindle=none --gcode tools=none --to part.job.yaml
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
@click.option(
    "--gcode",
    "entries",
    multiple=True,
    metavar="ENTRY=VALUE",
    help="What stands for the machine that G-code was written for, as `gcode:` of a path step; repeat it for others.",
)
@click.option(
    "--from-line", type=click.IntRange(1), default=1, help="Begin at this line, with the modes of those before."
)
@click.option(
    "--fleet", type=click.Path(path_type=Path), help="The fleet file: its axes and limits are checked as well."
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
    entries: tuple[str, ...],
    from_line: int,
    fleet: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Write the path in FILE as a job file: G-code (.ngc, .gcode, .nc), a table of points (.csv), or a joint trajectory
    (.yaml, .json).

    What is refused is named with its line and column, and then nothing is written. With --from-line, the modes that the
    lines before leave are printed, and the job begins with a move to where the program stands then.
    """
    from orchestrator.model.paths.files.reading import GcodeStart, read_path_file
    from orchestrator.plan.programs.imported_job import make_checked_job
    from orchestrator.runtime.checked import load_checked_fleet

    if target.exists() and not force:
        exit_with_error(f"{target} is there already", BAD_INPUT, "choose another name, or give --force")
    axis_names = _read_pairs(axes, "--axis")
    places = {letter.upper(): _read_number(value, letter) for letter, value in _read_pairs(starts, "--from").items()}
    loaded_fleet = None if fleet is None else load_checked_fleet(fleet)
    with expected_errors():
        begin = GcodeStart(places, _read_entries(entries), from_line, file.parent)
        contents = read_path_file(file, axis_names, begin)
        text = make_checked_job(file.stem[:60], contents, tolerance, loaded_fleet)
        target.write_text(text, encoding="utf-8")
    steps = contents.steps
    pieces = sum(len(step.get("pieces", ())) for step in steps)
    lines = [
        f"{target}: {len(steps)} step{'s' * (len(steps) != 1)} with {pieces} pieces; `tutti path plot` shows them",
        *(f"{file}: {note}" for note in contents.notes),
        *([f"from line {from_line}: {', '.join(contents.modes)}"] if contents.modes else []),
    ]
    plain = {"file": str(target), "steps": len(steps), "pieces": pieces}
    more = {"notes": contents.notes, "modes": contents.modes}
    print_result({**plain, **more}, "\n".join(lines), as_json=as_json)


def _read_entries(entries: tuple[str, ...]) -> "GcodeSettings | None":
    """The mapping of G-code, as a job file gives it. Raises `FileError`."""
    from orchestrator.model.jobs.files import FileError, FileProblem, read_document, validate_part
    from orchestrator.model.paths.gcode_settings import GcodeSettings

    if not entries:
        return None
    pairs = [entry.partition("=") for entry in entries]
    wrong_entries = [entry for entry, (name, _, value) in zip(entries, pairs, strict=True) if not name or not value]
    if wrong_entries:
        exit_with_error(f"--gcode {wrong_entries[0]}: write ENTRY=VALUE", BAD_INPUT, "for example --gcode spindle=none")
    document = read_document("\n".join(f"{name}: {value}" for name, _, value in pairs) + "\n", "--gcode")
    settings, problems = validate_part(document.root.value, GcodeSettings)
    if settings is None or problems:
        raise FileError(
            FileProblem("--gcode", 0, ".".join(map(str, problem.place)), problem.text) for problem in problems
        )
    return settings


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
