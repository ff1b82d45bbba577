"""`tutti bench …`: measurements."""

import click

from orchestrator.cli.common import console, json_option, print_json


@click.group(epilog="Example: tutti bench plan --json")
def bench() -> None:
    """Measure Tutti; every figure stands next to its baseline of the same run."""


@bench.command(epilog="Example: tutti bench plan --rounds 1000")
@json_option
@click.option("--rounds", default=300, show_default=True, type=click.IntRange(10, 100_000), help="Plans of each size.")
def plan(as_json: bool, rounds: int) -> None:
    """Time planning of steps of 1 to 1,024 axes against the bare Ruckig call.

    Jerk-limited axes count; trapezoids, where Ruckig has less to do, are shown beside them.
    """
    from rich.table import Table

    from orchestrator.lab.bench_plan import bench_plan

    jerk_limited, trapezoids = bench_plan(3, rounds), bench_plan(2, rounds)
    if as_json:
        print_json(
            {
                "rows": [row._asdict() for row in jerk_limited],
                "trapezoid_rows": [row._asdict() for row in trapezoids],
                "rounds": rounds,
            }
        )
        return
    for title, rows in (("jerk-limited", jerk_limited), ("trapezoids", trapezoids)):
        table = Table(title=f"{title}, medians of {rounds}", title_justify="left", header_style="bold")
        for name in ("axes", "plan, µs", "bare Ruckig, µs", "ratio"):
            table.add_column(name, justify="right")
        for row in rows:
            table.add_row(str(row.axes), f"{row.plan_us:.1f}", f"{row.ruckig_us:.1f}", f"{row.ratio:.1f}")
        console.print(table)


@bench.command(epilog="Example: tutti bench virtual --hours 1 --json")
@json_option
@click.option("--hours", default=1.0, show_default=True, type=click.FloatRange(0.01, 24), help="Of fleet time.")
def virtual(as_json: bool, hours: float) -> None:
    """Run the demo fleet, moving all the time, in virtual time, and say how much faster than real time it was."""
    from orchestrator.cli.demo import EXAMPLES
    from orchestrator.lab.bench_virtual import bench_virtual
    from orchestrator.model.files import load_fleet

    run = bench_virtual(load_fleet(EXAMPLES / "demo.fleet.yaml"), hours)
    if as_json:
        print_json(run._asdict())
    else:
        console.print(
            f"{run.fleet_s:.0f} s of fleet time with {run.moves} synchronised moves in {run.cpu_s:.1f} s of processor "
            f"time: {run.speedup:.0f} times faster than real time",
            highlight=False,
        )
