"""`tutti bench clock` and `tutti bench sync`: how well clocks are known, and how well fleets start and end together."""

import click

from orchestrator.cli.common import console, json_option, print_json


@click.command(epilog="Example: tutti bench clock --trials 1000")
@json_option
@click.option("--trials", default=200, show_default=True, type=click.IntRange(10, 100_000), help="Crystals a link.")
@click.option("--seed", default=1, show_default=True, help="Of everything random.")
def clock(as_json: bool, trials: int, seed: int) -> None:
    """Predict controllers' clocks 5 s ahead, from 300 s of readings, over modelled links; in virtual time.

    Beside the estimate stand its guaranteed bound, how often the truth was outside it, and two estimators without a
    bound: the smallest round trip at the nominal rate, and least squares.
    """
    from orchestrator.lab.bench_clock import bench_clock
    from orchestrator.monitor.tables import plain_table

    rows = bench_clock(trials, seed)
    if as_json:
        print_json({"rows": [row._asdict() for row in rows], "trials": trials, "seed": seed})
        return
    table = plain_table(["µs", "p50>", "p95>", "asked>", "max>", "bound>", "misses>", "Cristian>", "regression>"])
    for row in rows:
        asked = f"{row.asked_us:g}" if row.asked_us else ""
        errors = (row.p50_us, row.p95_us, asked, row.max_us)
        table.add_row(
            row.link, *(str(each) for each in (*errors, row.bound_us, row.misses, row.cristian_us, row.regression_us))
        )
    console.print(table)
