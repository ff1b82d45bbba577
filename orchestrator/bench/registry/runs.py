"""The run function of each benchmark: `run(show_progress, **options)` returns the fields of the JSON document.

A benchmark's own module is imported only when it runs.
"""

import sys
from collections.abc import Callable, Coroutine
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from orchestrator.model.errors import TuttiError

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet

T = TypeVar("T")
ShowProgress = Callable[[str], None]
Fields = dict[str, Any]

_TUTTI_CODE = "from orchestrator.cli.main import main; main(prog_name='tutti')"


class InvalidOption(TuttiError):
    """The value of an option is invalid. `name`: the option."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(text)
        self.name = name


class BenchFailed(TuttiError):
    """The benchmark could not be completed. The text is the reason."""


def _load_demo_fleet() -> "Fleet":
    from orchestrator.model.jobs.files import load_fleet
    from orchestrator.runtime.examples import find_example

    return load_fleet(find_example("demo.fleet.yaml"))


def _measure_live(measure: Callable[[Path], Coroutine[Any, Any, T]]) -> T:
    """Return the result of `measure` in a folder of its own. Raises `BenchFailed` when an expected event is missing."""
    import asyncio
    import tempfile

    from orchestrator.bench.truth import NothingHappened

    with tempfile.TemporaryDirectory(prefix="tutti-bench-") as folder:
        try:
            return asyncio.run(measure(Path(folder)))
        except NothingHappened as error:
            raise BenchFailed(str(error)) from error


def run_plan(_: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.plan import bench_plan

    return {"rows": bench_plan(3, rounds), "trapezoid_rows": bench_plan(2, rounds), "rounds": rounds}


def run_steps(show_progress: ShowProgress, steps: int, *, virtual_only: bool) -> Fields:
    from orchestrator.bench.steps import bench_steps

    def measure(folder: Path) -> Coroutine[Any, Any, list[Any]]:
        return bench_steps(steps, None if virtual_only else folder, show_progress)

    rows = _measure_live(measure)
    return {"steps": steps, "rows": rows}


def run_virtual(_: ShowProgress, hours: float) -> Fields:
    from orchestrator.bench.virtual import bench_virtual

    return bench_virtual(_load_demo_fleet(), hours)._asdict()


def run_poll(_: ShowProgress, seconds: float) -> Fields:
    from orchestrator.bench.poll import bench_poll

    return {"rows": bench_poll(seconds), "seconds": seconds}


def run_bus(_: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.smc30_bus import bench_smc30_bus

    return {"rows": bench_smc30_bus(rounds), "rounds": rounds}


def run_can(_: ShowProgress, rounds: int, hours: float) -> Fields:
    from orchestrator.bench.can.bus import bench_can
    from orchestrator.bench.can.mixed import bench_mixed
    from orchestrator.bench.can.stream import bench_stream

    rows = [*bench_can(rounds), *bench_mixed(rounds), *bench_stream(rounds, hours)]
    return {"rows": rows, "rounds": rounds, "hours": hours}


def run_sim(_: ShowProgress, controllers: int, seconds: float, *, step: bool) -> Fields:
    from orchestrator.bench.sim import bench_sim

    return bench_sim(controllers, seconds, step=step)._asdict()


def run_lowering(_: ShowProgress, make: str, moves: int) -> Fields:
    from orchestrator.bench.lowering import MAKES, bench_lowering

    if make not in MAKES:
        raise InvalidOption("make", f"unknown make {make!r}; choose one of {', '.join(MAKES)}")
    return bench_lowering(make, moves)._asdict()


def run_shrc_chain(_: ShowProgress, moves: int, seeds: int) -> Fields:
    from orchestrator.bench.chain import bench_chain

    return {"rows": [figures._asdict() | {"met": figures.met} for figures in bench_chain(moves, seeds)]}


def run_clock(_: ShowProgress, trials: int, seed: int) -> Fields:
    from orchestrator.bench.clock import bench_clock

    return {"rows": bench_clock(trials, seed), "trials": trials, "seed": seed}


def run_rates(_: ShowProgress, trials: int, seed: int) -> Fields:
    from orchestrator.bench.rates import bench_rates

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
    live: int | None,
    plot: Path | None,
    processes: int,
) -> Fields:
    _require_expression(only)
    if live is not None:
        from orchestrator.bench.sync.live import bench_sync_live

        return {"rows": _measure_live(lambda folder: bench_sync_live(live, folder, show_progress))}
    from orchestrator.bench.sync.measure import SyncOptions, bench_sync
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
    from orchestrator.bench.paths.measure import PathsOptions, bench_paths

    rows = bench_paths(PathsOptions(quick, seed, only, processes, paths), show_progress)
    return {"rows": rows, "quick": quick, "seed": seed}


def run_dispatch(_: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.dispatch import bench_dispatch

    return _measure_live(lambda folder: bench_dispatch(folder, rounds))._asdict()


def run_estop(_: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.estop import bench_estop

    command = [sys.executable, "-c", _TUTTI_CODE]
    return _measure_live(lambda folder: bench_estop(folder, rounds, command))._asdict()


def run_firing(_: ShowProgress, shots: int) -> Fields:
    from orchestrator.bench.firing import bench_firing

    return _measure_live(lambda folder: bench_firing(folder, shots))._asdict()


def run_jog(_: ShowProgress, presses: int, kills: int) -> Fields:
    from orchestrator.bench.jog import bench_jog

    fleet = _load_demo_fleet()
    return _measure_live(lambda folder: bench_jog(fleet, folder, _TUTTI_CODE, presses, kills))._asdict()


def run_journal(_: ShowProgress, jobs: int, history: int, folder: Path | None) -> Fields:
    import tempfile

    from orchestrator.bench.journal import bench_journal

    with tempfile.TemporaryDirectory(prefix="tutti-bench-", dir=folder) as folder_name:
        return bench_journal(_load_demo_fleet(), Path(folder_name), jobs, history)._asdict()


def run_kills(show_progress: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.kills import bench_kills

    fleet = _load_demo_fleet()
    return _measure_live(lambda folder: bench_kills(fleet, folder, rounds, show_progress))._asdict()


def run_page(show_progress: ShowProgress, seconds: int, rounds: int) -> Fields:
    if find_spec("playwright") is None:
        raise BenchFailed("playwright is not installed; use the environment of the tests: make test-browser")
    from orchestrator.bench.page.measure import bench_page

    fleet = _load_demo_fleet()
    return {"rows": _measure_live(lambda folder: bench_page(fleet, folder, seconds, rounds, show_progress))}


def run_record(show_progress: ShowProgress, seconds: int, cuts: int) -> Fields:
    from orchestrator.bench.recording.measure import bench_record, describe_failures

    figures = _measure_live(lambda folder: bench_record(folder, seconds, cuts, show_progress))
    return {**figures._asdict(), "failures": describe_failures(figures)}


def run_permit(_: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.permit import bench_permit

    gantry = _load_demo_fleet().controllers["gantry"]
    return _measure_live(lambda folder: bench_permit(gantry, folder, rounds))._asdict()
