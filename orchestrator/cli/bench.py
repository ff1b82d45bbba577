"""`tutti bench …`: measurements."""

from typing import TYPE_CHECKING, TypeVar

import click

from orchestrator.cli.bench_clocks import clock, firing, rates, sync
from orchestrator.cli.bench_journal import journal
from orchestrator.cli.bench_live import dispatch, estop, jog, kills, permit
from orchestrator.cli.common import console, json_option, print_json

if TYPE_CHECKING:
    pass

T = TypeVar("T")


@click.group(epilog="Example: tutti bench plan --json")
def bench() -> None:
    """Measure Tutti; every figure stands next to its baseline from the same run."""


@bench.command(epilog="Example: tutti bench plan --rounds 1000")
@json_option
@click.option("--rounds", default=300, show_default=True, type=click.IntRange(10, 100_000), help="Plans of each size.")
def plan(as_json: bool, rounds: int) -> None:
    """Time the planning of steps of 1 to 1,024 axes against the bare Ruckig call.

    Jerk-limited axes count; trapezoids, where Ruckig has less to do, are shown for comparison.
    """
    from rich.table import Table

    from orchestrator.bench.plan import bench_plan

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
    """Run the demo fleet in constant motion, in virtual time, and report its speed relative to real time."""
    from orchestrator.bench.virtual import bench_virtual
    from orchestrator.cli.demo import EXAMPLES
    from orchestrator.model.files import load_fleet

    run = bench_virtual(load_fleet(EXAMPLES / "demo.fleet.yaml"), hours)
    if as_json:
        print_json(run._asdict())
    else:
        console.print(
            f"{run.fleet_s:.0f} s of fleet time with {run.moves} synchronised moves in {run.cpu_s:.1f} s "
            f"of processor time: {run.speedup:.0f} times faster than real time",
            highlight=False,
        )


@bench.command(epilog="Example: tutti bench poll --json")
@json_option
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(1, 3600), help="Of virtual time.")
def poll(as_json: bool, seconds: float) -> None:
    """Poll SMC-2000 at 19,200 baud as often as they reply, against the limit of the serial line.

    One alone and three on a daisy chain, with and without a USB adapter that delays received bytes by up to 16 ms.
    """
    from rich.table import Table

    from orchestrator.bench.poll import bench_poll

    rows = bench_poll(seconds)
    if as_json:
        print_json({"rows": [row._asdict() for row in rows], "seconds": seconds})
        return
    table = Table(title="SMC-2000 of two axes, virtual time", title_justify="left", header_style="bold")
    for name in ("units", "adapter delay, ms", "polled at once", "polls/s", "serial line limit", "share, %"):
        table.add_column(name, justify="right")
    for row in rows:
        shown = (row.units, row.hold_ms, row.at_once, row.polls_s, row.wire_polls_s, row.share)
        table.add_row(*(str(value) for value in shown))
    console.print(table)


@bench.command(epilog="Example: tutti bench bus --json")
@json_option
@click.option(
    "--rounds", default=300, show_default=True, type=click.IntRange(10, 100_000), help="Starts of each method."
)
def bus(as_json: bool, rounds: int) -> None:
    """Start seven SMC30 on one bus at 9,600 baud together, and measure the spread of their starts, in virtual time.

    By E commands one after another, by the adapter's time slots with the delay in the programs, and by a trigger
    line.
    """
    from orchestrator.bench.smc30_bus import bench_smc30_bus
    from orchestrator.monitor.tables import plain_table

    rows = bench_smc30_bus(rounds)
    if as_json:
        print_json({"rows": [row._asdict() for row in rows], "rounds": rounds})
        return
    table = plain_table(
        ["seven SMC30, started by", "n>", "p50, ms>", "p99, ms>", "max, ms>", "off T0>", "asked", "met"]
    )
    for row in rows:
        met = "" if row.met is None else "yes" if row.met else "NO"
        off = "" if row.off_ms is None else f"{row.off_ms:.2f}"
        spans = (f"{ms:.2f}" for ms in (row.p50_ms, row.p99_ms, row.max_ms))
        table.add_row(row.way, str(row.n), *spans, off, row.asked, met)
    console.print(table)


@bench.command(epilog="Example: tutti bench can --json")
@json_option
@click.option("--rounds", default=40, show_default=True, type=click.IntRange(10, 100_000), help="Moves of each method.")
@click.option("--hours", default=0.05, show_default=True, type=click.FloatRange(0.001, 24), help="Of fleet time.")
def can(as_json: bool, rounds: int, hours: float) -> None:
    """Start eight CiA 402 drives on one CAN bus at 1 Mbit/s together, arm them, and stream positions to them.

    In virtual time, by the simulators' ground truth; in one step with an SMC-4000 by a complete coordinator. The
    last part streams positions for `--hours`: an hour takes half an hour, the rest some three minutes.
    """
    from orchestrator.bench.can import bench_can
    from orchestrator.bench.can_mixed import bench_mixed
    from orchestrator.bench.can_stream import bench_stream
    from orchestrator.monitor.tables import plain_table

    rows = [*bench_can(rounds), *bench_mixed(rounds), *bench_stream(rounds, hours)]
    if as_json:
        print_json({"rows": [row._asdict() for row in rows], "rounds": rounds, "hours": hours})
        return
    table = plain_table(["eight CiA 402 drives", "n>", "p50>", "p99>", "max>", "asked", "met"])
    for row in rows:
        met = "" if row.met is None else "yes" if row.met else "NO"
        spans = (f"{value:.3f}" for value in (row.p50, row.p99, row.max))
        table.add_row(f"{row.what}, {row.unit}", str(row.n), *spans, row.asked, met)
    console.print(table)


@bench.command(epilog="Example: tutti bench sim --controllers 64 --json")
@json_option
@click.option("--controllers", default=64, show_default=True, type=click.IntRange(1, 512), help="Of four axes each.")
@click.option("--seconds", default=10.0, show_default=True, type=click.FloatRange(1, 200), help="Of fleet time, each.")
@click.option("--step", is_flag=True, help="Also in a step of a job; homing all axes first takes long.")
def sim(as_json: bool, controllers: int, seconds: float, step: bool) -> None:
    """Time simulated SMC-4000, polled by their adapters at 10 Hz, in virtual time, and report where the time is
    spent.

    Idle, and with all axes moving on commands of another host.
    """
    from rich.table import Table

    from orchestrator.bench.sim import bench_sim

    figures = bench_sim(controllers, seconds, step=step)
    windows = {"idle": figures.idle, "moving": figures.moving}
    if figures.step is not None:
        windows["in a step"] = figures.step
    if as_json:
        shown = {name.removeprefix("in a "): window._asdict() for name, window in windows.items()}
        print_json(figures._asdict() | shown)
        return
    title = f"{figures.controllers} simulated SMC-4000, {figures.axes} axes, polled at {figures.poll_hz:g} Hz"
    table = Table(title=title, title_justify="left", header_style="bold")
    table.add_column("")
    for name in ("times real time", "controller-seconds a CPU second"):
        table.add_column(name, justify="right")
    for name, window in windows.items():
        table.add_row(name, f"{window.speedup:.1f}", f"{window.controller_s:.0f}")
    console.print(table)
    shares = sorted(figures.shares.items(), key=lambda item: -item[1])
    console.print("while moving: " + ", ".join(f"{part} {share:.0f} %" for part, share in shares), highlight=False)


@bench.command(epilog="Example: tutti bench lowering --make smc4000 --json")
@json_option
@click.option("--make", default="smc4000", show_default=True, help="Of the controller.")
@click.option("--moves", default=10_000, show_default=True, type=click.IntRange(10, 1_000_000), help="Trapezoids.")
def lowering(as_json: bool, make: str, moves: int) -> None:
    """Compare the executed with the planned motion, by the simulator's ground truth, in virtual time.

    Jerk-limited moves of four axes over crystals of ±100 ppm: the distance to the plan. Trapezoids: the duration, as
    planned, as compiled, and of a seeded part of them as executed; those with a cruise speed below 20,000 counts/s
    are a tenth as many. Some minutes for the 10,000. An SMC30 accepts only whole steps/s: its moves are compared by
    their mean rate.
    """
    from orchestrator.bench.lowering import MAKES, bench_lowering
    from orchestrator.monitor.tables import plain_table

    if make not in MAKES:
        raise click.BadParameter(f"unknown make {make!r}; choose one of {', '.join(MAKES)}", param_hint="--make")
    found = bench_lowering(make, moves)
    if as_json:
        print_json(
            {
                "make": found.make,
                "moves": found.moves,
                "figures": [each._asdict() for each in found.figures],
                "chosen": [each._asdict() for each in found.chosen],
            }
        )
        return
    table = plain_table(["trapezoids by cruise, counts/s", "n>", "p50>", "p99>", "max>", "asked", "met"])
    for each in found.figures:
        met = "" if each.met is None else "yes" if each.met else "NO"
        values = (f"{value:.3f}" for value in (each.p50, each.p99, each.max))
        table.add_row(f"{each.what}, {each.unit}", str(each.n), *values, each.asked, met)
    console.print(table)
    for each in found.chosen:
        ways = ", ".join(f"{count} by {way}" for way, count in sorted(each.ways.items()))
        console.print(f"{each.cruise}: {ways}", highlight=False)


@bench.command("shrc-chain", epilog="Example: tutti bench shrc-chain --json")
@json_option
@click.option("--moves", default=1000, show_default=True, type=click.IntRange(2, 100_000), help="Of each chain.")
@click.option("--seeds", default=100, show_default=True, type=click.IntRange(1, 10_000), help="Chains of each kind.")
def shrc_chain(as_json: bool, moves: int, seeds: int) -> None:
    """Run chains of prebuffered moves on a simulated SHRC-203 at 38,400 baud, in virtual time.

    Measures the duration of a move with its hand-over, for one axis and for three, and whether a chain ran dry. Some
    minutes.
    """
    from orchestrator.bench.chain import bench_chain
    from orchestrator.monitor.tables import plain_table

    figures = bench_chain(moves, seeds)
    if as_json:
        print_json({"rows": [each._asdict() | {"met": each.met} for each in figures]})
        return
    table = plain_table(["axes>", "chains>", "ms a move>", "asked>", "least lead, ms>", "underruns>", "met"])
    for each in figures:
        values = (each.axes, each.seeds, each.move_ms, each.asked_ms, each.ahead_ms, each.underruns)
        table.add_row(*map(str, values), "yes" if each.met else "NO")
    console.print(table)


for command in (clock, dispatch, estop, firing, jog, journal, kills, permit, rates, sync):
    bench.add_command(command)
