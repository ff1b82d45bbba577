"""`tutti export`: recordings as tables."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, json_option, print_json
from orchestrator.cli.base.csv_options import csv_style_options
from orchestrator.cli.base.errors import errors, exit_with_error
from orchestrator.cli.base.extras import require_extra
from orchestrator.cli.records.folder import find_recording, folder_option, recorded_fleet_option
from orchestrator.monitor.export.csv_table import CsvStyle

if TYPE_CHECKING:
    from orchestrator.monitor.export.files import TableFormat
    from orchestrator.monitor.export.table import DataTable
    from orchestrator.monitor.recording.reader import Recording, RecordingSummary

_FORMATS = ("parquet", "csv", "hdf5")


@click.command(epilog="Example: tutti export scan --to parquet -o scan.parquet")
@click.argument("recording")
@click.option("--to", "table_format", required=True, type=click.Choice(_FORMATS), help="The format.")
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="The first file.")
@click.option(
    "--period", default=None, metavar="DURATION", help="Of the common grid, e.g. 10ms. Default: that of the readings."
)
@csv_style_options
@folder_option
@recorded_fleet_option
@json_option
def export(
    recording: str,
    table_format: str,
    output: Path,
    period: str | None,
    folder: Path | None,
    fleet: str | None,
    *,
    csv_style: CsvStyle,
    as_json: bool,
) -> None:
    """Write a recording as tables. RECORDING: a job (its id, the beginning of it, its name, `last`), or a file.

    \b
    grid     all axes on one grid of fleet time
    samples  every reading as it came
    moves    each axis of each motion step, with the intervals of its start
             and end, and the step's verdict
    device   positions that controllers have recorded by themselves (`record`)
    triggers each edge of outputs that were switched on the way (`triggers`)
    points   each point of scans

    Units, job and verdicts are metadata of the files. HDF5 has the tables in one file; of CSV, metadata are in a JSON
    file beside.
    """
    if table_format == "csv":
        require_extra("record")
    else:
        require_extra("export")
    from orchestrator.monitor.export.files import SUFFIXES, write_tables
    from orchestrator.monitor.export.samples import ExportTooLarge
    from orchestrator.monitor.recording.reader import Recording, RecordingUnreadable

    format_name = cast("TableFormat", table_format)
    wanted_suffix = SUFFIXES[format_name]
    if output.suffix != wanted_suffix:
        exit_with_error(
            f"{output} does not end with {wanted_suffix}", BAD_INPUT, f"write it so: -o {output.stem}{wanted_suffix}"
        )
    period_ns = _parse_period(period)
    summary = find_recording(recording, folder, fleet)
    try:
        with Recording(summary.path) as opened_recording:
            tables, notes = _make_tables(opened_recording, summary, period_ns)
        files = write_tables(tables, output, format_name, csv_style)
    except (RecordingUnreadable, ExportTooLarge) as error:
        exit_with_error(str(error), FAILED)
    except OSError as error:
        exit_with_error(f"{error.filename or output}: {error.strerror}", BAD_INPUT, "choose another place with -o")
    rows = {table.name: table.row_count for table in tables}
    if as_json:
        print_json(
            {"recording": str(summary.path), "files": [str(file) for file in files], "rows": rows, "notes": notes}
        )
        return
    for note in notes:
        errors.print(note, highlight=False, soft_wrap=True)
    words = ", ".join(f"{name} {count} rows" for name, count in rows.items())
    console.print(f"{words}; in {', '.join(map(str, files))}", highlight=False, soft_wrap=True)


def _parse_period(period: str | None) -> int | None:
    from orchestrator.model.numbers import parse_duration

    if period is None:
        return None
    try:
        duration = parse_duration(period)
    except ValueError as error:
        exit_with_error(f"--period: {error}", BAD_INPUT)
    if duration <= 0:
        exit_with_error(f"--period {period}: must be more than nothing", BAD_INPUT)
    return duration


def _make_tables(
    opened: "Recording", summary: "RecordingSummary", period_ns: int | None
) -> "tuple[list[DataTable], list[str]]":
    """The tables of a recording, and what is to be said about it."""
    from orchestrator.monitor.export.moves import make_moves_table
    from orchestrator.monitor.export.points import make_points_table
    from orchestrator.monitor.export.recorded import load_run
    from orchestrator.monitor.export.samples import make_device_table, make_grid_table, make_samples_table
    from orchestrator.monitor.export.triggers import make_triggers_table

    run = load_run(opened)
    tables: list[Any] = [make_grid_table(run, period_ns), make_samples_table(run)]
    notes: list[str] = []
    if run.samples:
        tables.append(make_device_table(run))
    if run.triggers:
        tables.append(make_triggers_table(run))
    if run.points:
        tables.append(make_points_table(run.points, run.units))
    if run.report is not None:
        tables.append(make_moves_table(run.report, run.events))
    elif summary.job_id:
        notes.append("the job's report is not in it: the recording ended before the job, so that there are no moves")
    if opened.damage is not None:
        notes.append(f"it is read up to byte {opened.damage.at}: {opened.damage.text}; see `tutti record repair`")
    if run.unread:
        notes.append(f"{run.unread} messages are not valid, and left out")
    return tables, notes
