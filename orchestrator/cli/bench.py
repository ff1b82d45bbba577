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
    """Measure Tutti; every figure stands next to its baseline of the same run."""


@bench.command(epilog="Example: tutti bench plan --rounds 1000")
@json_option
@click.option("--rounds", default=300, show_default=True, type=click.IntRange(10, 100_000), help="Plans of each size.")
def plan(as_json: bool, rounds: int) -> None:
    """Time planning of steps of 1 to 1,024 axes against the bare Ruckig call.

    Jerk-limited axes count; trapezoids, where Ruckig has less to do, are shown beside them.
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
    """Run the demo fleet, moving all the time, in virtual time, and say how much faster than real time it was."""
    from orchestrator.bench.virtual import bench_virtual
    from orchestrator.cli.demo import EXAMPLES
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


@bench.command(epilog="Example: tutti bench poll --json")
@json_option
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(1, 3600), help="Of virtual time.")
def poll(as_json: bool, seconds: float) -> None:
    """Poll SMC-2000 at 19,200 baud as often as they answer, against what the characters on the wire allow.

    Alone and three on a daisy chain, with and without a USB adapter that keeps received bytes for up to 16 ms.
    """
    from rich.table import Table

    from orchestrator.bench.poll import bench_poll

    rows = bench_poll(seconds)
    if as_json:
        print_json({"rows": [row._asdict() for row in rows], "seconds": seconds})
        return
    table = Table(title="SMC-2000 of two axes, virtual time", title_justify="left", header_style="bold")
    for name in ("units", "adapter holds, ms", "asked at once", "polls/s", "the wire allows", "share, %"):
        table.add_column(name, justify="right")
    for row in rows:
        shown = (row.units, row.hold_ms, row.at_once, row.polls_s, row.wire_polls_s, row.share)
        table.add_row(*(str(value) for value in shown))
    console.print(table)


@bench.command(epilog="Example: tutti bench bus --json")
@json_option
@click.option("--rounds", default=300, show_default=True, type=click.IntRange(10, 100_000), help="Starts each way.")
def bus(as_json: bool, rounds: int) -> None:
    """Start seven SMC30 on one bus at 9,600 baud together, and say how far apart they begin, in virtual time.

    By E to one after another, by the adapter's slots with the waiting in the programs, and by a wired line.
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
@click.option("--rounds", default=40, show_default=True, type=click.IntRange(10, 100_000), help="Moves each way.")
@click.option("--hours", default=0.05, show_default=True, type=click.FloatRange(0.001, 24), help="Of fleet time.")
def can(as_json: bool, rounds: int, hours: float) -> None:
    """Start eight CiA 402 drives on one CAN bus at 1 Mbit/s together, arm them, and stream positions to them.

    In virtual time, by the simulators' truth; in one step with SMC-4000 by a whole coordinator. Positions are streamed
    for `--hours` at last: an hour takes half an hour, the rest some three minutes.
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
@click.option("--step", is_flag=True, help="Also in a step of a job; homing all axes before takes long.")
def sim(as_json: bool, controllers: int, seconds: float, step: bool) -> None:
    """Time simulated SMC-4000, read by their adapters at 10 Hz, in virtual time, and say where the time goes.

    Idle, and with all axes moving, told so by another host.
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
    title = f"{figures.controllers} simulated SMC-4000, {figures.axes} axes, read at {figures.poll_hz:g} Hz"
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
    """Compare what a controller executes with what was planned, by its simulator's truth, in virtual time.

    Jerk-limited moves of four axes over crystals of ±100 ppm: the distance to the plan. Trapezoids: the duration, as
    planned, as lowered, and of a seeded part of them as executed; those of a cruise below 20,000 counts/s are a tenth
    as many. Some minutes for the 10,000. An SMC30 is told whole steps/s: its moves are shown by their mean rate.
    """
    from orchestrator.bench.lowering import MAKES, bench_lowering
    from orchestrator.monitor.tables import plain_table

    if make not in MAKES:
        raise click.BadParameter(f"{make!r}; known are {', '.join(MAKES)}", param_hint="--make")
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

    How long a move takes with its hand-over, for one axis and for three, and whether a chain ran dry. Some minutes.
    """
    from orchestrator.bench.chain import bench_chain
    from orchestrator.monitor.tables import plain_table

    figures = bench_chain(moves, seeds)
    if as_json:
        print_json({"rows": [each._asdict() | {"met": each.met} for each in figures]})
        return
    table = plain_table(["axes>", "chains>", "ms a move>", "asked>", "least ahead, ms>", "underruns>", "met"])
    for each in figures:
        values = (each.axes, each.seeds, each.move_ms, each.asked_ms, each.ahead_ms, each.underruns)
        table.add_row(*map(str, values), "yes" if each.met else "NO")
    console.print(table)


for command in (clock, dispatch, estop, firing, jog, journal, kills, permit, rates, sync):
    bench.add_command(command)
