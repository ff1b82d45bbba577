"""The run function of each benchmark: `run(show_progress, **options)` returns the fields of the JSON document.

A benchmark's own module is imported only when it runs.
"""

import sys
from collections.abc import Callable, Coroutine
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


def load_demo_fleet() -> "Fleet":
    from orchestrator.model.jobs.files import load_fleet
    from orchestrator.runtime.examples import find_example

    return load_fleet(find_example("demo.fleet.yaml"))


def measure_live(measure: Callable[[Path], Coroutine[Any, Any, T]]) -> T:
    """Return the result of `measure` in a folder of its own. Raises `BenchFailed` when an expected event is missing."""
    import asyncio
    import tempfile

    from orchestrator.bench.truth import NothingHappened

    with tempfile.TemporaryDirectory(prefix="tutti-bench-") as folder:
        try:
            return asyncio.run(measure(Path(folder)))
        except NothingHappened as error:
            raise BenchFailed(str(error)) from error


def run_steps(
    show_progress: ShowProgress, steps: int, scan_points: int, *, virtual_only: bool, exchanges: bool
) -> Fields:
    from orchestrator.bench.steps import StepsResult, bench_steps

    def measure(folder: Path) -> Coroutine[Any, Any, StepsResult]:
        return bench_steps(steps, scan_points, None if virtual_only else folder, show_progress)

    result = measure_live(measure)
    return {
        "steps": steps,
        "rows": result.rows,
        "scan": result.scan,
        "exchanges": result.exchanges if exchanges else None,
    }


def run_dispatch(_: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.dispatch import bench_dispatch

    return measure_live(lambda folder: bench_dispatch(folder, rounds))._asdict()


def run_estop(_: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.estop import bench_estop

    command = [sys.executable, "-c", _TUTTI_CODE]
    return measure_live(lambda folder: bench_estop(folder, rounds, command))._asdict()


def run_firing(_: ShowProgress, shots: int) -> Fields:
    from orchestrator.bench.firing import bench_firing

    return measure_live(lambda folder: bench_firing(folder, shots))._asdict()


def run_jog(_: ShowProgress, presses: int, kills: int) -> Fields:
    from orchestrator.bench.jog import bench_jog

    fleet = load_demo_fleet()
    return measure_live(lambda folder: bench_jog(fleet, folder, _TUTTI_CODE, presses, kills))._asdict()


def run_journal(_: ShowProgress, jobs: int, history: int, folder: Path | None) -> Fields:
    import tempfile

    from orchestrator.bench.journal import bench_journal

    with tempfile.TemporaryDirectory(prefix="tutti-bench-", dir=folder) as folder_name:
        return bench_journal(load_demo_fleet(), Path(folder_name), jobs, history)._asdict()


def run_kills(show_progress: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.kills import bench_kills

    fleet = load_demo_fleet()
    return measure_live(lambda folder: bench_kills(fleet, folder, rounds, show_progress))._asdict()


def run_record(show_progress: ShowProgress, seconds: int, cuts: int) -> Fields:
    from orchestrator.bench.recording.measure import bench_record, describe_failures

    figures = measure_live(lambda folder: bench_record(folder, seconds, cuts, show_progress))
    return {**figures._asdict(), "failures": describe_failures(figures)}


def run_permit(_: ShowProgress, rounds: int) -> Fields:
    from orchestrator.bench.permit import bench_permit

    gantry = load_demo_fleet().controllers["gantry"]
    return measure_live(lambda folder: bench_permit(gantry, folder, rounds))._asdict()


def run_scale(show_progress: ShowProgress, controllers: int | None, hosts: int | None, *, live: bool) -> Fields:
    from orchestrator.bench.scale import CONTROLLERS_PER_HOST, SIZES, measure_scale
    from orchestrator.bench.scale_live import CONTROLLERS, bench_scale_live

    sizes = [controllers] if controllers else [CONTROLLERS] if live else SIZES
    if hosts is not None and hosts > min(sizes):
        raise InvalidOption("hosts", f"{hosts} hosts for {min(sizes)} controllers; each carries one at least")
    if not live:
        return {"rows": measure_scale(sizes, hosts, show_progress), "live": None}
    count = sizes[0]
    host_count = hosts or -(-count // CONTROLLERS_PER_HOST)
    return {
        "rows": None,
        "live": measure_live(lambda folder: bench_scale_live(folder, count, host_count, show_progress)),
    }


def run_sync(show_progress: ShowProgress, steps: int) -> Fields:
    from orchestrator.bench.sync import bench_sync_live

    return {"rows": measure_live(lambda folder: bench_sync_live(steps, folder, show_progress)), "steps": steps}
