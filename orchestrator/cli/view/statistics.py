"""`tutti stats`: what axes, controllers and jobs have done."""

import sys
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.csv_options import csv_style_options
from orchestrator.cli.base.instants import InstantType
from orchestrator.monitor.export.csv_table import CsvStyle, CsvTable

if TYPE_CHECKING:
    from orchestrator.client import Tutti

WEEK = timedelta(days=7)


@click.command(epilog="Example: tutti stats --since 30d --csv > stats.csv")
@click.option(
    "--since",
    default=None,
    type=InstantType(past=True),
    help="From the UTC day of this time on; or an age, default 7d.",
)
@click.option("--by-day", is_flag=True, help="Also each day by itself.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a line for each figure of each day.")
@csv_style_options
@fleet_options
@json_option
def stats(
    since: datetime | None,
    connect: str,
    fleet: str | None,
    *,
    by_day: bool,
    as_csv: bool,
    csv_style: CsvStyle,
    as_json: bool,
) -> None:
    """Show statistics: moves, distance and reversals of axes, availability of controllers, start skews of pairs of
    controllers, jobs and failures by cause.

    They are kept by UTC day, also when jobs are deleted.
    """
    from orchestrator.cli.view.statistics_words import list_figures, make_tables

    if as_csv and as_json:
        raise click.UsageError("choose one of --csv and --json")
    day = (datetime.now(UTC) - WEEK if since is None else since.astimezone(UTC)).date().isoformat()

    async def show_statistics(tutti: "Tutti") -> None:
        statistics = await tutti.read_statistics(day, by_day=by_day or as_csv)
        if as_json:
            print_json(statistics.to_plain())
        elif as_csv:
            table = CsvTable(sys.stdout, csv_style, "\n")
            table.write_row(("day", "kind", "subject", "figure", "value", "unit"))
            table.write_rows(line for day in statistics.days for line in list_figures(day))
        else:
            for figures in [*statistics.days, statistics.total]:
                title = f"since {statistics.since}" if figures.day is None else figures.day
                for part in make_tables(figures, title):
                    console.print(part, highlight=False)

    with_fleet(connect, fleet, show_statistics)
