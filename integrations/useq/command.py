"""`tutti job from-useq`: a sequence of a microscope as a job file."""

from pathlib import Path

import click

from tutti.commands import BAD_INPUT, exit_with_error, json_option, print_result, require_extra


@click.command(
    "from-useq",
    epilog="Example: tutti job from-useq exp.yaml --map x=gantry.x,y=gantry.y,camera=gantry.lamp -o exp.job.yaml",
)
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option(
    "--map",
    "entries",
    multiple=True,
    required=True,
    metavar="NAME=TARGET,…",
    help="Axes for x, y, z; outputs for `camera` (a pulse as long as the exposure) and `channel.NAME` (on meanwhile).",
)
@click.option("--ignore", multiple=True, metavar="NAME,…", help="Leave these parts of the sequence out, on purpose.")
@click.option("--exposure", type=click.FloatRange(0, min_open=True), help="In ms, for channels that state none.")
@click.option("-o", "--to", "target", type=click.Path(path_type=Path), required=True, help="The job file.")
@click.option("--force", is_flag=True, help="Write over a file that is there.")
@json_option
def from_useq(  # noqa: PLR0913 (the options of a command arrive as its parameters)
    file: Path,
    entries: tuple[str, ...],
    ignore: tuple[str, ...],
    exposure: float | None,
    *,
    target: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Write the sequence in FILE (useq-schema, YAML or JSON) as a job: positions, grids, z plans, time plans, channels.

    Positions are in the units of the axes. What the sequence has and the mapping has nothing for is named, and nothing
    is written. Check the job with `tutti job check`.
    """
    require_extra("useq", "useq")
    from integrations.useq.job_file import read_sequence, write_job
    from integrations.useq.mapping import BadMapping, read_mapping
    from integrations.useq.steps import UnmappedSequence, make_steps

    if target.exists() and not force:
        exit_with_error(f"{target} is there already", BAD_INPUT, "choose another name, or give --force")
    try:
        mapping = read_mapping(list(entries), list(ignore))
        steps = make_steps(read_sequence(file), mapping, exposure)
    except BadMapping as error:
        exit_with_error(f"--map {error.text}", BAD_INPUT, error.remedy)
    except UnmappedSequence as error:
        exit_with_error("\n".join(f"{file}: {problem}" for problem in error.problems), BAD_INPUT, code="bad-file")
    write_job(target, file, steps)
    points = sum(len(step.get("points", {}).get("rows", ())) for step in steps)
    words = f"{target}: {len(steps)} steps with {points} points; check it: tutti job check {target}"
    print_result({"file": str(target), "steps": len(steps), "points": points}, words, as_json=as_json)
