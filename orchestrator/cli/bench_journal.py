"""`tutti bench journal`: rate of job submissions, and restart time of a coordinator with a long history."""

import tempfile
from pathlib import Path

import click

from orchestrator.cli.common import console, json_option, print_json


@click.command(epilog="Example: tutti bench journal --json")
@json_option
@click.option("--jobs", default=1000, show_default=True, type=click.IntRange(1, 100_000), help="Submitted one by one.")
@click.option("--history", default=10_000, show_default=True, type=click.IntRange(0, 1_000_000), help="Finished jobs.")
@click.option(
    "--folder",
    default=None,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="On the disk to measure; default: that of temporary files.",
)
def journal(as_json: bool, jobs: int, history: int, folder: Path | None) -> None:
    """Time submissions, each safe on disk before the next, and the restart of a coordinator with many finished jobs.

    In real time on a real disk; the bus is in memory. Filling the history first takes a minute.
    """
    from orchestrator.bench.journal import RESTART_ASKED_S, SUBMIT_ASKED_S, bench_journal
    from orchestrator.cli.demo import EXAMPLES
    from orchestrator.model.files import load_fleet
    from orchestrator.monitor.tables import plain_table

    with tempfile.TemporaryDirectory(prefix="tutti-bench-", dir=folder) as place:
        found = bench_journal(load_fleet(EXAMPLES / "demo.fleet.yaml"), Path(place), jobs, history)
    if as_json:
        print_json(found._asdict())
        return
    words = {None: "", True: "yes", False: "NO"}
    table = plain_table(["", "took, s>", "asked, s>", "met"])
    restart = f"restart with {found.history} jobs, {found.file_mb:g} MB"
    for what, took_s, asked_s, met in (
        (f"{found.jobs} jobs submitted", found.submit_s, SUBMIT_ASKED_S, found.submit_met),
        (restart, found.restart_s, RESTART_ASKED_S, found.restart_met),
    ):
        table.add_row(what, f"{took_s:g}", "" if met is None else f"{asked_s:g}", words[met])
    console.print(table)
    console.print(f"one transaction on this disk: {found.fsync_ms:g} ms", highlight=False)
