"""`tutti bench jog`, `permit`, `estop`, `kills`, `dispatch`: reaction times of a live fleet of simulated
controllers."""

import sys
import tempfile
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from orchestrator.cli.codes import FAILED
from orchestrator.cli.common import console, fail, json_option, print_json, run

if TYPE_CHECKING:
    from orchestrator.bench.dispatch import DispatchFigures
    from orchestrator.bench.estop import EstopFigures
    from orchestrator.bench.jog import JogFigures
    from orchestrator.bench.kills import KillFigures
    from orchestrator.bench.permit import PermitFigures
    from orchestrator.bench.spread import Spread

T = TypeVar("T")

_PANEL = "from orchestrator.cli.main import main; main(prog_name='tutti')"

_WORDS = {
    "release": "key released",
    "killed": "panel killed",
    "first_motion": "key press to motion",
    "plain_release": "released, repeats only",
    "api_stop": "Hand.stop()",
    "controllers": "controllers",
    "poll_ms": "poll interval, ms",
    "stopped": "input to the last axis",
    "first": "input to the first axis",
    "last": "publication to the last axis",
    "uploading": "the same, others being armed",
    "shell": "tutti estop to the last axis",
    "smc2000_19200": "put, SMC-2000 at 19,200 baud",
    "shrc203_38400": "put, SHRC-203 at 38,400 baud",
    "noise": "process wake-up delay",
    "spoilt": "repeated rounds",
}


@click.command(epilog="Example: tutti bench jog --presses 100 --json")
@json_option
@click.option("--presses", default=100, show_default=True, type=click.IntRange(1, 10_000), help="Of a key.")
@click.option("--kills", default=10, show_default=True, type=click.IntRange(1, 1000), help="Of the panel.")
def jog(as_json: bool, presses: int, kills: int) -> None:
    """Time the jog panel on the demo fleet, live with simulated controllers; takes some minutes.

    From a key release, and from a killed panel, to the start of deceleration. Also: from the press to the first
    motion; the same on a terminal that reports no releases; from the Python interface without panel and terminal;
    and the wake-up delay of processes on this machine.
    """
    from orchestrator.bench.jog import bench_jog
    from orchestrator.cli.demo import EXAMPLES
    from orchestrator.model.files import load_fleet

    def measure(folder: Path) -> "Coroutine[Any, Any, JogFigures]":
        return bench_jog(load_fleet(EXAMPLES / "demo.fleet.yaml"), folder, _PANEL, presses, kills)

    _show_spreads(_measured(measure), as_json)


@click.command(epilog="Example: tutti bench permit --rounds 20 --json")
@json_option
@click.option("--rounds", default=20, show_default=True, type=click.IntRange(1, 1000), help="Losses of the permit.")
def permit(as_json: bool, rounds: int) -> None:
    """Time the loss of a permit in a step over eight controllers, live with simulated controllers.

    From the change of the input to the deceleration of the last axis, against 50 ms and the poll interval of a
    moving controller; and the wake-up delay of processes on this machine.
    """
    from orchestrator.bench.permit import bench_permit
    from orchestrator.cli.demo import EXAMPLES
    from orchestrator.model.files import load_fleet

    def measure(folder: Path) -> "Coroutine[Any, Any, PermitFigures]":
        return bench_permit(load_fleet(EXAMPLES / "demo.fleet.yaml").controllers["gantry"], folder, rounds)

    _show_spreads(_measured(measure), as_json)


@click.command(epilog="Example: tutti bench estop --rounds 100 --json")
@json_option
@click.option("--rounds", default=100, show_default=True, type=click.IntRange(4, 100_000), help="E-stops.")
def estop(as_json: bool, rounds: int) -> None:
    """Time an e-stop on 16 controllers on TCP and two on serial lines, live with simulated controllers.

    From its publication to the deceleration of the last axis; in every other round the controllers that do not move
    are being armed. The serial ones take part in every ninth round. A thousand rounds take three quarters of an
    hour.
    """
    from orchestrator.bench.estop import bench_estop

    def measure(folder: Path) -> "Coroutine[Any, Any, EstopFigures]":
        return bench_estop(folder, rounds, [sys.executable, "-c", _PANEL])

    _show_spreads(_measured(measure), as_json)


@click.command(epilog="Example: tutti bench kills --rounds 100 --json")
@json_option
@click.option("--rounds", default=100, show_default=True, type=click.IntRange(1, 100_000), help="Faults.")
def kills(as_json: bool, rounds: int) -> None:
    """Kill or stop (SIGKILL, SIGSTOP) each process of the live demo fleet at random moments of a job.

    No job may be lost or run twice, no axis may move for longer than declared after the fault, and the fleet must
    recover by itself. A hundred rounds take some twenty minutes.
    """
    from orchestrator.bench.kills import bench_kills
    from orchestrator.bench.spread import Spread
    from orchestrator.cli.demo import EXAMPLES
    from orchestrator.model.files import load_fleet
    from orchestrator.monitor.tables import plain_table

    def measure(folder: Path) -> "Coroutine[Any, Any, KillFigures]":
        fleet = load_fleet(EXAMPLES / "demo.fleet.yaml")
        return bench_kills(fleet, folder, rounds, lambda line: None if as_json else console.print(f"[dim]{line}[/]"))

    figures = _measured(measure)
    if as_json:
        fields = figures._asdict()
        print_json({name: each._asdict() if isinstance(each, Spread) else each for name, each in fields.items()})
    else:
        table = plain_table(["from the fault to", "n>", "p50, ms>", "p99, ms>", "max, ms>", "asked", "met"])
        table.add_row("the last axis at rest", *_cells(figures.rest))
        table.add_row("a completed job", *_cells(figures.back))
        table.add_row(_WORDS["noise"], *_cells(figures.noise))
        console.print(table)
        ends = ", ".join(f"{count} {state}" for state, count in figures.ends.items())
        console.print(
            f"{figures.rounds} faults; jobs: {ends}; lost {figures.lost}, doubled {figures.doubled}, "
            f"motions longer than declared {figures.moved_on}",
            highlight=False,
        )
    if figures.lost or figures.doubled or figures.moved_on:
        raise SystemExit(FAILED)


@click.command(epilog="Example: tutti bench dispatch --rounds 50 --json")
@json_option
@click.option("--rounds", default=50, show_default=True, type=click.IntRange(2, 100_000), help="Jobs.")
def dispatch(as_json: bool, rounds: int) -> None:
    """Time jobs from their submission to the first motion, on 16 controllers of four axes on TCP, live.

    Also in virtual time, where only links and firmware take time; its path is the work that must be done before
    anything can move. Live, simulators and fleet share this machine's processors.
    """
    from orchestrator.bench.dispatch import bench_dispatch
    from orchestrator.monitor.tables import plain_table

    def measure(folder: Path) -> "Coroutine[Any, Any, DispatchFigures]":
        return bench_dispatch(folder, rounds)

    figures = _measured(measure)
    if as_json:
        plain = figures._asdict()
        for name in ("first_motion", "lead", "armed_to_t0", "noise"):
            plain[name] = plain[name]._asdict()
        print_json(plain | {"parts": {name: each._asdict() for name, each in figures.parts.items()}})
        return
    rows = {"submission to first motion": figures.first_motion, "lead time of T0, once settled": figures.lead}
    rows |= {"begin of last arming to T0": figures.armed_to_t0}
    rows |= {f"part: {name}": each for name, each in figures.parts.items()} | {_WORDS["noise"]: figures.noise}
    table = plain_table(["live", "n>", "p50, ms>", "p99, ms>", "max, ms>", "asked", "met"])
    for name, each in rows.items():
        table.add_row(name, *_cells(each))
    console.print(table)
    console.print(
        f"virtual: first motion {figures.virtual_ms:g} ms, lead {figures.virtual_lead_ms:g} ms, path "
        f"{figures.virtual_path_ms:g} ms; simulators used {figures.simulators_cpu:.0%} of the processor time",
        highlight=False,
    )


def _measured(measure: Callable[[Path], Coroutine[Any, Any, T]]) -> T:
    """Return the result of `measure` in a folder of its own; exit 1 when an expected event does not happen."""
    from orchestrator.bench.truth import NothingHappened

    async def main() -> T:
        with tempfile.TemporaryDirectory(prefix="tutti-bench-") as folder:
            return await measure(Path(folder))

    try:
        return run(main())
    except NothingHappened as error:
        fail(str(error))


def _show_spreads(figures: "JogFigures | PermitFigures | EstopFigures", as_json: bool) -> None:
    """Show each spread with its target; other figures above."""
    from orchestrator.bench.spread import Spread
    from orchestrator.monitor.tables import plain_table

    fields = figures._asdict()
    if as_json:
        print_json({name: each._asdict() if isinstance(each, Spread) else each for name, each in fields.items()})
        return
    table = plain_table(["to deceleration, from", "n>", "p50, ms>", "p99, ms>", "max, ms>", "asked", "met"])
    for name, each in fields.items():
        words = _WORDS[name]
        if not isinstance(each, Spread):
            console.print(f"{words}: {each:g}", highlight=False)
            continue
        table.add_row(words, *_cells(each))
    console.print(table)


def _cells(figures: "Spread") -> list[str]:
    met = "" if figures.met is None else "yes" if figures.met else "NO"
    spans = (f"{ms:.1f}" for ms in (figures.p50_ms, figures.p99_ms, figures.max_ms))
    return [str(figures.n), *spans, figures.asked, met]
