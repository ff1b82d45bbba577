"""`tutti bench clock`, `firing` and `sync`: how well clocks are known, bytes on time, and fleets together."""

import re
import tempfile
from pathlib import Path

import click

from orchestrator.cli.common import console, fail, json_option, print_json, processes_option, run


@click.command(epilog="Example: tutti bench clock --trials 1000")
@json_option
@click.option("--trials", default=200, show_default=True, type=click.IntRange(10, 100_000), help="Crystals a link.")
@click.option("--seed", default=1, show_default=True, help="Of everything random.")
def clock(as_json: bool, trials: int, seed: int) -> None:
    """Predict controllers' clocks 5 s ahead, from 300 s of readings, over modelled links; in virtual time.

    Beside the estimate stand its guaranteed bound, how often the truth was outside it, and two estimators without a
    bound: the smallest round trip at the nominal rate, and least squares.
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
        raise click.BadParameter(f"{value!r} is no regular expression: {error}") from None
    return value


@click.command(epilog="Example: tutti bench sync --trials 100 --plot skews.png")
@json_option
@click.option("--trials", default=1000, show_default=True, type=click.IntRange(2, 1_000_000), help="Steps of a row.")
@click.option("--seed", default=1, show_default=True, help="Of everything random.")
@click.option(
    "--only", default="", metavar="PATTERN", callback=_pattern, help="Only rows whose name this finds: '64', 'clock$'."
)
@click.option(
    "--history", default=300, show_default=True, type=click.IntRange(5, 3600), help="Seconds of polls before."
)
@click.option("--live", type=click.IntRange(2, 10_000), help="So many steps with real sockets and processes instead.")
@click.option(
    "--plot", type=click.Path(path_type=Path, dir_okay=False), help="Distributions of the start skews, a PNG."
)
@processes_option
def sync(
    as_json: bool, trials: int, seed: int, only: str, history: int, live: int | None, plot: Path | None, processes: int
) -> None:
    """Start simulated fleets together, by the old ways and by Tutti's, and measure how well; in virtual time.

    Truth comes from the simulators. `misses` counts verdicts that do not hold it. Rows that are slow to simulate have
    fewer trials. A thousand trials take a core an hour or so; a hundred, with --history 60, some minutes.
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
    console.print(
        "of starts; bound: the p99 that nobody can do better than; end, path: p99 at the end and on the way\n"
    )
    table = plain_table(["said of the starts, ms", "budget>", "width>", "asked>", "trials>", "missed>", "late>"])
    for row in rows:
        if row.misses is not None:
            figures = (row.budget, row.width, row.width_most)
            table.add_row(
                f"{row.fleet}, {row.way}", *map(_figure, figures), str(row.trials), str(row.misses), str(row.late)
            )
    console.print(table)
    console.print(
        "budget: predicted and guaranteed, its median; width: of the verdict's interval, p99, and what is asked of it; "
        "missed: verdicts that do not hold the truth; late: a wire kept a line for longer than its adapter counts on, "
        "and only what the controllers have shown has to hold\n"
    )
    for row in rows:
        if row.asked:
            kept = "kept" if row.met else "[red]not kept[/]"
            console.print(f"{row.fleet}, {row.way}: asked {row.asked}: {kept}; worst is {row.worst}")


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


@click.command(epilog="Example: tutti bench firing --shots 1000 --json")
@json_option
@click.option("--shots", default=500, show_default=True, type=click.IntRange(100, 100_000), help="Bytes, each way.")
def firing(as_json: bool, shots: int) -> None:
    """Measure how late the last byte of a start is written, live, on an idle machine and beside a fleet of 16.

    The firing process needs the right to real-time priority; without it, whatever else runs delays it by milliseconds.
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
    table = plain_table(["written late by", "n>", "p50, µs>", "p99, µs>", "max, µs>", "asked", "met"])
    words = ("firing process, idle", f"…, {CONTROLLERS} read at 10 Hz", "event loop, idle", "…, beside the same")
    for name, each in zip(words, figures, strict=True):
        spans = (f"{ms * 1000:.0f}" for ms in (each.p50_ms, each.p99_ms, each.max_ms))
        met = "" if each.met is None else "yes" if each.met else "NO"
        table.add_row(name, str(each.n), *spans, each.asked, met)
    console.print(table)


@click.command(epilog="Example: tutti bench rates --json")
@json_option
@click.option("--trials", default=30, show_default=True, type=click.IntRange(2, 10_000), help="Crystals a link.")
@click.option("--seed", default=1, show_default=True, help="Of everything random.")
def rates(as_json: bool, trials: int, seed: int) -> None:
    """Learn crystals that can not be read, and times to the start, from moves of 5 to 60 s; in virtual time.

    Beside the learned rate stand its guaranteed bound, how often the truth was outside it, a crystal that is taken for
    what it says, and the mean of the measured durations; beside the learned time to the start, what is declared, and
    the mean of the acknowledgements. 30 crystals a link take half a minute or so.
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
    console.print("Host noise is in it: simulated controllers run on this machine, too, and act late with it.")
