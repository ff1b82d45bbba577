"""The run function of each developers' benchmark: `run(show_progress, **options)` returns the fields of the JSON
document.

A benchmark's own module is imported only when it runs.
"""

from importlib.util import find_spec
from pathlib import Path

from orchestrator.bench.registry.runs import (
    BenchFailed,
    Fields,
    InvalidOption,
    ShowProgress,
    load_demo_fleet,
    measure_live,
)


def run_plan(_: ShowProgress, rounds: int) -> Fields:
    from benches.speed.plan import bench_plan

    return {"rows": bench_plan(3, rounds), "trapezoid_rows": bench_plan(2, rounds), "rounds": rounds}


def run_virtual(_: ShowProgress, hours: float) -> Fields:
    from benches.speed.virtual import bench_virtual

    return bench_virtual(load_demo_fleet(), hours)._asdict()


def run_poll(_: ShowProgress, seconds: float) -> Fields:
    from benches.makes.poll import bench_poll

    return {"rows": bench_poll(seconds), "seconds": seconds}


def run_bus(_: ShowProgress, rounds: int) -> Fields:
    from benches.makes.smc30_bus import bench_smc30_bus

    return {"rows": bench_smc30_bus(rounds), "rounds": rounds}


def run_can(_: ShowProgress, rounds: int, hours: float) -> Fields:
    from benches.makes.can.bus import bench_can
    from benches.makes.can.mixed import bench_mixed
    from benches.makes.can.stream import bench_stream

    rows = [*bench_can(rounds), *bench_mixed(rounds), *bench_stream(rounds, hours)]
    return {"rows": rows, "rounds": rounds, "hours": hours}


def run_sim(_: ShowProgress, controllers: int, seconds: float, *, step: bool) -> Fields:
    from benches.speed.sim import bench_sim

    return bench_sim(controllers, seconds, step=step)._asdict()


def run_lowering(_: ShowProgress, make: str, moves: int) -> Fields:
    from benches.makes.lowering import MAKES, bench_lowering

    if make not in MAKES:
        raise InvalidOption("make", f"unknown make {make!r}; choose one of {', '.join(MAKES)}")
    return bench_lowering(make, moves)._asdict()


def run_shrc_chain(_: ShowProgress, moves: int, seeds: int) -> Fields:
    from benches.makes.chain import bench_chain

    return {"rows": [figures._asdict() | {"met": figures.met} for figures in bench_chain(moves, seeds)]}


def run_clock(_: ShowProgress, trials: int, seed: int) -> Fields:
    from benches.clocks.clock import bench_clock

    return {"rows": bench_clock(trials, seed), "trials": trials, "seed": seed}


def run_rates(_: ShowProgress, trials: int, seed: int) -> Fields:
    from benches.clocks.rates import bench_rates

    rates, starts = bench_rates(trials, seed)
    return {"rates": rates, "starts": starts, "trials": trials, "seed": seed}


def _require_expression(only: str) -> None:
    """Raise `InvalidOption` for what is no regular expression."""
    import re

    try:
        re.compile(only)
    except re.error as error:
        raise InvalidOption("only", f"{only!r} is not a regular expression: {error}") from None


def run_sync(
    show_progress: ShowProgress,
    trials: int,
    seed: int,
    only: str,
    history: int,
    plot: Path | None,
    processes: int,
) -> Fields:
    _require_expression(only)
    from benches.sync.measure import SyncOptions, bench_sync
    from orchestrator.monitor.skew_plot import plot_skews

    options = SyncOptions(trials, seed, only, history, processes)
    rows, starts = bench_sync(options, lambda row: show_progress(f"{row.fleet}, {row.way}"))
    if plot is not None:
        plot_skews(starts, plot)
    return {"rows": rows, "trials": trials, "seed": seed, "history_s": history}


def run_paths(
    show_progress: ShowProgress, *, quick: bool, seed: int, only: str, paths: int | None, processes: int
) -> Fields:
    _require_expression(only)
    from benches.paths.measure import PathsOptions, bench_paths

    rows = bench_paths(PathsOptions(quick, seed, only, processes, paths), show_progress)
    return {"rows": rows, "quick": quick, "seed": seed}


def run_page(show_progress: ShowProgress, seconds: int, rounds: int) -> Fields:
    if find_spec("playwright") is None:
        raise BenchFailed("playwright is not installed; use the environment of the tests: make test-browser")
    from benches.page.measure import bench_page

    fleet = load_demo_fleet()
    return {"rows": measure_live(lambda folder: bench_page(fleet, folder, seconds, rounds, show_progress))}
