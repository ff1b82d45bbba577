"""`tutti bench clock`, `firing` and `sync`: accuracy of clock estimates, of timed writes, and of synchronised
starts."""

import re
import tempfile
from pathlib import Path

import click

from orchestrator.cli.common import console, fail, json_option, print_json, processes_option, run


@click.command(epilog="Example: tutti bench clock --trials 1000")
@json_option
@click.option("--trials", default=200, show_default=True, type=click.IntRange(10, 100_000), help="Crystals a link.")
@click.option("--seed", default=1, show_default=True, help="Of all random draws.")
def clock(as_json: bool, trials: int, seed: int) -> None:
    """Predict controllers' clocks 5 s ahead, from 300 s of samples, over modelled links; in virtual time.

    Shown with the estimate: its guaranteed bound, how often the true value was outside it, and two estimators
    without a bound: the smallest round trip at the nominal rate, and least squares.
    """
    from orchestrator.bench.clock import bench_clock
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


def _pattern(context: click.Context, parameter: click.Parameter, value: str) -> str:
    del context, parameter
    try:
        re.compile(value)
    except re.error as error:
        raise click.BadParameter(f"{value!r} is not a regular expression: {error}") from None
    return value


@click.command(epilog="Example: tutti bench sync --trials 100 --plot skews.png")
@json_option
@click.option("--trials", default=1000, show_default=True, type=click.IntRange(2, 1_000_000), help="Steps of a row.")
@click.option("--seed", default=1, show_default=True, help="Of all random draws.")
@click.option(
    "--only", default="", metavar="PATTERN", callback=_pattern, help="Only rows whose name matches: '64', 'clock$'."
)
@click.option(
    "--history", default=300, show_default=True, type=click.IntRange(5, 3600), help="Seconds of polls before the start."
)
@click.option(
    "--live", type=click.IntRange(2, 10_000), help="Run this many steps with real sockets and processes instead."
)
@click.option(
    "--plot", type=click.Path(path_type=Path, dir_okay=False), help="Distributions of the start skews, a PNG."
)
@processes_option
def sync(
    as_json: bool, trials: int, seed: int, only: str, history: int, live: int | None, plot: Path | None, processes: int
) -> None:
    """Start simulated fleets together, by baseline methods and by Tutti's, and measure the skew; in virtual time.

    The ground truth comes from the simulators. `misses` counts verdicts that do not contain it. Rows that are slow
    to simulate have fewer trials. A thousand trials take a core an hour or so; a hundred, with --history 60, some
    minutes.
    """
    if live is not None:
        _live(live, as_json)
        return
    from orchestrator.bench.sync import bench_sync
    from orchestrator.monitor.skew_plot import plot_skews
    from orchestrator.monitor.tables import plain_table

    rows, starts = bench_sync(
        trials,
        seed,
        only,
        history,
        processes,
        lambda row: None if as_json else console.print(f"[dim]{row.fleet}, {row.way}[/]"),
    )
    if plot is not None:
        plot_skews(starts, plot)
    if as_json:
        print_json({"rows": [row._asdict() for row in rows], "trials": trials, "seed": seed, "history_s": history})
        return
    table = plain_table(["skew, ms", "p50>", "p99>", "max>", "bound>", "end>", "path>"])
    for row in rows:
        figures = (row.start_p50, row.start_p99, row.start_max, row.bound_p99, row.end_p99, row.path_p99)
        table.add_row(f"{row.fleet}, {row.way}", *map(_figure, figures))
    console.print(table)
    console.print("of starts; bound: the smallest p99 that is possible; end, path: p99 at the end and on the path\n")
    table = plain_table(["reported start skew, ms", "budget>", "width>", "asked>", "trials>", "missed>", "late>"])
    for row in rows:
        if row.misses is not None:
            figures = (row.budget, row.width, row.width_most)
            table.add_row(
                f"{row.fleet}, {row.way}", *map(_figure, figures), str(row.trials), str(row.misses), str(row.late)
            )
    console.print(table)
    console.print(
        "budget: predicted and guaranteed, its median; width: of the verdict's interval, p99, and its "
        "target; missed: verdicts that do not contain the true skew; late: a link delayed a command for "
        "longer than its adapter allows, and only the controllers' evidence must hold\n"
    )
    for row in rows:
        if row.asked:
            kept = "kept" if row.met else "[red]missed[/]"
            console.print(f"{row.fleet}, {row.way}: target {row.asked}: {kept}; worst is {row.worst}")


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


@click.command(epilog="Example: tutti bench firing --shots 1000 --json")
@json_option
@click.option("--shots", default=500, show_default=True, type=click.IntRange(100, 100_000), help="Writes of each kind.")
def firing(as_json: bool, shots: int) -> None:
    """Measure the delay of a start command's last byte, live, on an idle machine and with a fleet of 16 running.

    The firing process needs permission for real-time priority; without it, other processes delay it by milliseconds.
    """
    from orchestrator.bench.firing import CONTROLLERS, bench_firing
    from orchestrator.bench.truth import NothingHappened
    from orchestrator.monitor.tables import plain_table

    with tempfile.TemporaryDirectory(prefix="tutti-bench-") as folder:
        try:
            figures = run(bench_firing(Path(folder), shots))
        except NothingHappened as error:
            fail(str(error))
    if as_json:
        print_json({name: each._asdict() for name, each in figures._asdict().items()})
        return
    table = plain_table(["write delay of", "n>", "p50, µs>", "p99, µs>", "max, µs>", "asked", "met"])
    words = (
        "firing process, idle",
        f"…, {CONTROLLERS} polled at 10 Hz",
        "event loop, idle",
        "…, with the same polling",
    )
    for name, each in zip(words, figures, strict=True):
        spans = (f"{ms * 1000:.0f}" for ms in (each.p50_ms, each.p99_ms, each.max_ms))
        met = "" if each.met is None else "yes" if each.met else "NO"
        table.add_row(name, str(each.n), *spans, each.asked, met)
    console.print(table)


@click.command(epilog="Example: tutti bench rates --json")
@json_option
@click.option("--trials", default=30, show_default=True, type=click.IntRange(2, 10_000), help="Crystals a link.")
@click.option("--seed", default=1, show_default=True, help="Of all random draws.")
def rates(as_json: bool, trials: int, seed: int) -> None:
    """Learn crystals that cannot be read, and start latencies, from moves of 5 to 60 s; in virtual time.

    Shown with the learned rate: its guaranteed bound, how often the true rate was outside it, the nominal rate of
    the crystal, and the mean of the measured durations. Shown with the learned latency: the declared one, and the
    mean of the acknowledgements. 30 crystals per link take half a minute or so.
    """
    from orchestrator.bench.rates import bench_rates
    from orchestrator.monitor.tables import plain_table

    found, starts = bench_rates(trials, seed)
    if as_json:
        rows = {"rates": [row._asdict() for row in found], "starts": [row._asdict() for row in starts]}
        print_json({**rows, "trials": trials, "seed": seed})
        return
    table = plain_table(["rate, ppm", "moves>", "p50>", "p95>", "max>", "bound>", "misses>", "nominal>", "mean>"])
    for row in found:
        table.add_row(row.link, str(row.moves), *(f"{each:g}" for each in row[3:]))
    console.print(table)
    table = plain_table(["start, µs", "moves>", "p50>", "p95>", "max>", "misses>", "declared>", "mean>"])
    for row in starts:
        table.add_row(row.link, str(row.moves), *(f"{each:g}" for each in row[3:]))
    console.print(table)


def _live(steps: int, as_json: bool) -> None:
    from orchestrator.bench.sync_live import bench_sync_live
    from orchestrator.monitor.tables import plain_table

    with tempfile.TemporaryDirectory(prefix="tutti-bench-") as folder:
        rows = run(
            bench_sync_live(steps, Path(folder), lambda line: None if as_json else console.print(f"[dim]{line}[/]"))
        )
    if as_json:
        print_json(
            {"rows": [{**row._asdict(), "start": row.start._asdict(), "noise": row.noise._asdict()} for row in rows]}
        )
        return
    table = plain_table(["start skew, ms", "p50>", "p99>", "max>", "outside evidence>", "noise p99>"])
    for row in rows:
        shown = (f"{each:.3g}" for each in (row.start.p50_ms, row.start.p99_ms, row.start.max_ms))
        table.add_row(row.fleet, *shown, f"{row.outside} of {row.start.n}", f"{row.noise.p99_ms:.3g}")
    console.print(table)
    console.print("This includes host noise: simulated controllers run on this machine too, and share its delays.")
