"""The registry of the developers' benchmarks: what compares Tutti's algorithms, simulators and page with baselines and
targets; in virtual time, but for computations alone and the page.

It is like that of the users' (`orchestrator.bench.registry.benchmarks`); `python -m benches` has the commands.
"""

from typing import Any

from benches.registry import runs
from orchestrator.bench.registry.record import (
    BenchColumn,
    Benchmark,
    BenchNote,
    BenchOption,
    BenchTable,
    Document,
    index_benchmarks,
)

_SEED = BenchOption("seed", "int", "Of all random draws.", default=1)
_PERCENTILES = (BenchColumn("n>", "n"), *(BenchColumn(f"{title}>", title, ".3f") for title in ("p50", "p99", "max")))


def _make_plan_table(title: str, rows: str) -> BenchTable:
    return BenchTable(
        rows,
        (
            BenchColumn("axes>", "axes"),
            BenchColumn("plan, µs>", "plan_us", ".1f"),
            BenchColumn("bare Ruckig, µs>", "ruckig_us", ".1f"),
            BenchColumn("ratio>", "ratio", ".1f"),
        ),
        title=f"{title}, medians of {{rounds}}",
    )


def _label_windows(document: Document) -> list[tuple[str, Any]]:
    labels = {"idle": "idle", "moving": "moving", "step": "in a step"}
    return [(label, document[field]) for field, label in labels.items() if document[field] is not None]


def _list_shares(document: Document) -> list[str]:
    shares = sorted(document["shares"].items(), key=lambda item: -item[1])
    return ["while moving: " + ", ".join(f"{part} {share:.0f} %" for part, share in shares)]


def _list_choices(document: Document) -> list[str]:
    return [
        f"{choice.cruise}: {', '.join(f'{count} by {way}' for way, count in sorted(choice.ways.items()))}"
        for choice in document["chosen"]
    ]


def _name_row(row: Any) -> str:
    return f"{row.fleet}, {row.way}"


def _list_verdict_rows(document: Document) -> list[Any]:
    return [row for row in document["rows"] if row.misses is not None]


def _list_sync_targets(document: Document) -> list[str]:
    legend = (
        "budget: predicted and guaranteed, its median; width: of the verdict's interval, p99, and its target; missed: "
        "verdicts that do not contain the true skew; late: a link delayed a command for longer than its adapter "
        "allows, and only the controllers' evidence must hold\n"
    )
    words = {True: "kept", False: "[red]missed[/]"}
    targets = [
        f"{_name_row(row)}: target {row.asked}: {words[bool(row.met)]}; worst is {row.worst}"
        for row in document["rows"]
        if row.asked
    ]
    return [legend, *targets]


def _list_path_notes(document: Document) -> list[str]:
    return [f"{row.row}, {row.figure}: {row.note}" for row in document["rows"] if row.note]


_BENCHMARKS = (
    Benchmark(
        name="plan",
        help="""Time the planning of steps of 1 to 1,024 axes against the bare Ruckig call.

        Jerk-limited axes count; trapezoids, where Ruckig has less to do, are shown for comparison.
        """,
        example="python -m benches plan --rounds 1000",
        options=(
            BenchOption(name="rounds", kind="int", help="Plans of each size.", default=300, low=10, high=100_000),
        ),
        run=runs.run_plan,
        layout=(_make_plan_table("jerk-limited", "rows"), _make_plan_table("trapezoids", "trapezoid_rows")),
    ),
    Benchmark(
        name="virtual",
        help="Run the demo fleet in constant motion, in virtual time, and report its speed relative to real time.",
        example="python -m benches virtual --hours 1 --json",
        options=(BenchOption(name="hours", kind="float", help="Of fleet time.", default=1.0, low=0.01, high=24),),
        run=runs.run_virtual,
        layout=(
            BenchNote(
                "{fleet_s:.0f} s of fleet time with {moves} synchronised moves in {cpu_s:.1f} s of processor time: "
                "{speedup:.0f} times faster than real time"
            ),
        ),
    ),
    Benchmark(
        name="poll",
        help="""Poll SMC-2000 at 19,200 baud as often as they reply, against the limit of the serial line.

        One alone and three on a daisy chain, with and without a USB adapter that delays received bytes by up to 16 ms.
        """,
        example="python -m benches poll --json",
        options=(BenchOption(name="seconds", kind="float", help="Of virtual time.", default=60.0, low=1, high=3600),),
        run=runs.run_poll,
        layout=(
            BenchTable(
                "rows",
                (
                    BenchColumn("controllers>", "units"),
                    BenchColumn("adapter delay, ms>", "hold_ms"),
                    BenchColumn("polled at once>", "at_once"),
                    BenchColumn("polls/s>", "polls_s"),
                    BenchColumn("line limit>", "wire_polls_s"),
                    BenchColumn("share, %>", "share"),
                ),
                title="SMC-2000 of two axes, virtual time",
            ),
        ),
    ),
    Benchmark(
        name="bus",
        help="""Start seven SMC30 on one bus at 9,600 baud together, and measure the spread of their starts, in virtual
        time.

        By E commands one after another, by the adapter's time slots with the delay in the programs, and by a trigger
        line.
        """,
        example="python -m benches bus --json",
        options=(
            BenchOption(name="rounds", kind="int", help="Starts of each method.", default=300, low=10, high=100_000),
        ),
        run=runs.run_bus,
        layout=(
            BenchTable(
                "rows",
                (
                    BenchColumn("seven SMC30, started by", "way"),
                    BenchColumn("n>", "n"),
                    BenchColumn("p50, ms>", "p50_ms", ".2f"),
                    BenchColumn("p99, ms>", "p99_ms", ".2f"),
                    BenchColumn("max, ms>", "max_ms", ".2f"),
                    BenchColumn("off T0>", "off_ms", ".2f"),
                ),
                has_targets=True,
            ),
        ),
    ),
    Benchmark(
        name="can",
        help="""Start eight CiA 402 drives on one CAN bus at 1 Mbit/s together, arm them, and stream positions to them.

        In virtual time, by the simulators' ground truth; in one step with an SMC-4000 by a complete coordinator. The
        last part streams positions for `--hours`: an hour takes half an hour, the rest some three minutes.
        """,
        example="python -m benches can --json",
        options=(
            BenchOption(name="rounds", kind="int", help="Moves of each method.", default=40, low=10, high=100_000),
            BenchOption(name="hours", kind="float", help="Of fleet time.", default=0.05, low=0.001, high=24),
        ),
        run=runs.run_can,
        layout=(
            BenchTable(
                "rows",
                (BenchColumn("eight CiA 402 drives", lambda row: f"{row.what}, {row.unit}"), *_PERCENTILES),
                has_targets=True,
            ),
        ),
    ),
    Benchmark(
        name="sim",
        help="""Time simulated SMC-4000, polled by their adapters at 10 Hz, in virtual time, and report where the time
        is spent.

        Idle, and with all axes moving on commands of another host.
        """,
        example="python -m benches sim --controllers 64 --json",
        options=(
            BenchOption(name="controllers", kind="int", help="Of four axes each.", default=64, low=1, high=512),
            BenchOption(name="seconds", kind="float", help="Of fleet time, each.", default=10.0, low=1, high=200),
            BenchOption("step", "flag", "Also in a step of a job; homing all axes first takes long."),
        ),
        run=runs.run_sim,
        layout=(
            BenchTable(
                _label_windows,
                (
                    BenchColumn("", lambda row: row[0]),
                    BenchColumn("times real time>", lambda row: row[1].speedup, ".1f"),
                    BenchColumn("controller-seconds a CPU second>", lambda row: row[1].controller_s, ".0f"),
                ),
                title="{controllers} simulated SMC-4000, {axes} axes, polled at {poll_hz:g} Hz",
            ),
            BenchNote(_list_shares),
        ),
    ),
    Benchmark(
        name="lowering",
        help="""Compare the executed with the planned motion, by the simulator's ground truth, in virtual time.

        Jerk-limited moves of four axes over crystals of ±100 ppm: the distance to the plan. Trapezoids: the duration,
        as planned, as compiled, and of a seeded part of them as executed; those with a cruise speed below 20,000
        counts/s are a tenth as many. Some minutes for the 10,000. An SMC30 accepts only whole steps/s: its moves are
        compared by their mean rate.
        """,
        example="python -m benches lowering --make smc4000 --json",
        options=(
            BenchOption("make", "text", "Of the controller.", "smc4000"),
            BenchOption(name="moves", kind="int", help="Trapezoids.", default=10_000, low=10, high=1_000_000),
        ),
        run=runs.run_lowering,
        layout=(
            BenchTable(
                "figures",
                (BenchColumn("trapezoids by cruise, counts/s", lambda row: f"{row.what}, {row.unit}"), *_PERCENTILES),
                has_targets=True,
            ),
            BenchNote(_list_choices),
        ),
    ),
    Benchmark(
        name="shrc-chain",
        help="""Run chains of prebuffered moves on a simulated SHRC-203 at 38,400 baud, in virtual time.

        Measures the duration of a move with its hand-over, for one axis and for three, and whether a chain ran dry.
        Some minutes.
        """,
        example="python -m benches shrc-chain --json",
        options=(
            BenchOption(name="moves", kind="int", help="Of each chain.", default=1000, low=2, high=100_000),
            BenchOption(name="seeds", kind="int", help="Chains of each kind.", default=100, low=1, high=10_000),
        ),
        run=runs.run_shrc_chain,
        layout=(
            BenchTable(
                "rows",
                (
                    BenchColumn("axes>", "axes"),
                    BenchColumn("chains>", "seeds"),
                    BenchColumn("ms a move>", "move_ms"),
                    BenchColumn("target>", "asked_ms"),
                    BenchColumn("least lead, ms>", "ahead_ms"),
                    BenchColumn("underruns>", "underruns"),
                    BenchColumn("met", "met"),
                ),
            ),
        ),
    ),
    Benchmark(
        name="clock",
        help="""Predict controllers' clocks 5 s ahead, from 300 s of samples, over modelled links; in virtual time.

        Shown with the estimate: its guaranteed bound, how often the true value was outside it, and two estimators
        without a bound: the smallest round trip at the nominal rate, and least squares.
        """,
        example="python -m benches clock --trials 1000",
        options=(
            BenchOption(name="trials", kind="int", help="Crystals a link.", default=200, low=10, high=100_000),
            _SEED,
        ),
        run=runs.run_clock,
        layout=(
            BenchTable(
                "rows",
                (
                    BenchColumn("µs", "link"),
                    BenchColumn("p50>", "p50_us"),
                    BenchColumn("p95>", "p95_us"),
                    BenchColumn("target>", lambda row: row.asked_us or None, "g"),
                    BenchColumn("max>", "max_us"),
                    BenchColumn("bound>", "bound_us"),
                    BenchColumn("misses>", "misses"),
                    BenchColumn("Cristian>", "cristian_us"),
                    BenchColumn("regression>", "regression_us"),
                ),
            ),
        ),
    ),
    Benchmark(
        name="rates",
        help="""Learn crystals that cannot be read, and start latencies, from moves of 5 to 60 s; in virtual time.

        Shown with the learned rate: its guaranteed bound, how often the true rate was outside it, the nominal rate of
        the crystal, and the mean of the measured durations. Shown with the learned latency: the declared one, and the
        mean of the acknowledgements. 30 crystals per link take half a minute or so.
        """,
        example="python -m benches rates --json",
        options=(
            BenchOption(name="trials", kind="int", help="Crystals a link.", default=30, low=2, high=10_000),
            _SEED,
        ),
        run=runs.run_rates,
        layout=(
            BenchTable(
                "rates",
                (
                    BenchColumn("rate, ppm", "link"),
                    BenchColumn("moves>", "moves"),
                    BenchColumn("p50>", "p50_ppm", "g"),
                    BenchColumn("p95>", "p95_ppm", "g"),
                    BenchColumn("max>", "max_ppm", "g"),
                    BenchColumn("bound>", "bound_ppm", "g"),
                    BenchColumn("misses>", "misses"),
                    BenchColumn("nominal>", "nominal_ppm", "g"),
                    BenchColumn("mean>", "mean_ppm", "g"),
                ),
            ),
            BenchTable(
                "starts",
                (
                    BenchColumn("start, µs", "link"),
                    BenchColumn("moves>", "moves"),
                    BenchColumn("p50>", "p50_us", "g"),
                    BenchColumn("p95>", "p95_us", "g"),
                    BenchColumn("max>", "max_us", "g"),
                    BenchColumn("misses>", "misses"),
                    BenchColumn("declared>", "declared_us", "g"),
                    BenchColumn("mean>", "mean_us", "g"),
                ),
            ),
        ),
    ),
    Benchmark(
        name="paths",
        help="""Move simulated controllers of several makes along circles, and measure how far they are off them; plan
        random paths, and compare them with their limits, the least time, and their cost; switch an output on the way.
        In virtual time.

        The ground truth comes from the simulators: no path may be above the bound that was stated ahead, and no pulse
        outside its interval. Everything takes a core an hour or so; --quick, with 5 paths of 10 s a row and without the
        long circles, half a minute.
        """,
        example="python -m benches paths --quick --json",
        options=(
            BenchOption("quick", "flag", "Few and short paths."),
            _SEED,
            BenchOption("only", "text", "Only rows that match this expression.", "", metavar="REGEX"),
            BenchOption(
                name="paths",
                kind="int",
                help="Circles of a row; default: 200, and 10 long ones.",
                default=None,
                low=1,
                high=10_000,
            ),
            BenchOption(name="processes", kind="int", help="That share the work.", default=1, low=1, high=64),
        ),
        run=runs.run_paths,
        layout=(
            BenchTable(
                "rows",
                (
                    BenchColumn("row", "row"),
                    BenchColumn("figure", "figure"),
                    BenchColumn("value>", "value", "g"),
                    BenchColumn("", "unit"),
                ),
                has_targets=True,
            ),
            BenchNote(_list_path_notes),
        ),
        has_failed=lambda document: any(row.met is False for row in document["rows"]),
    ),
    Benchmark(
        name="sync",
        help="""Start simulated fleets together, by baseline methods and by Tutti's, and measure the skew; in virtual
        time.

        The ground truth comes from the simulators. `misses` counts verdicts that do not contain it. Rows that are slow
        to simulate have fewer trials. A thousand trials take a core an hour or so; a hundred, with --history 60, some
        minutes.
        """,
        example="python -m benches sync --trials 100 --plot skews.png",
        options=(
            BenchOption(name="trials", kind="int", help="Steps of a row.", default=1000, low=2, high=1_000_000),
            _SEED,
            BenchOption("only", "text", "Only rows whose name matches: '64', 'clock$'.", "", metavar="PATTERN"),
            BenchOption(
                name="history", kind="int", help="Seconds of polls before the start.", default=300, low=5, high=3600
            ),
            BenchOption("plot", "file", "Distributions of the start skews, a PNG."),
            BenchOption(name="processes", kind="int", help="Number of parallel processes.", default=1, low=1, high=256),
        ),
        run=runs.run_sync,
        layout=(
            BenchTable(
                "rows",
                (
                    BenchColumn("skew, ms", _name_row),
                    BenchColumn("p50>", "start_p50", ".3g"),
                    BenchColumn("p99>", "start_p99", ".3g"),
                    BenchColumn("max>", "start_max", ".3g"),
                    BenchColumn("bound>", "bound_p99", ".3g"),
                    BenchColumn("end>", "end_p99", ".3g"),
                    BenchColumn("path>", "path_p99", ".3g"),
                ),
            ),
            BenchNote(
                "of starts; bound: the smallest p99 that is possible; end, path: p99 at the end and on the path\n"
            ),
            BenchTable(
                _list_verdict_rows,
                (
                    BenchColumn("reported start skew, ms", _name_row),
                    BenchColumn("budget>", "budget", ".3g"),
                    BenchColumn("width>", "width", ".3g"),
                    BenchColumn("target>", "width_most", ".3g"),
                    BenchColumn("trials>", "trials"),
                    BenchColumn("missed>", "misses"),
                    BenchColumn("late>", "late"),
                ),
            ),
            BenchNote(_list_sync_targets),
        ),
    ),
    Benchmark(
        name="page",
        help="""Measure the gateway and the operators' page in a real browser (Chromium), live, for some minutes.

        The gateway's processor time with 20 sockets and a page, 64 axes moving; script time and heap of the page; and
        how quickly a jog ends when it is let go, or when the browser is killed, by the simulator's truth.
        """,
        example="python -m benches page --json",
        options=(
            BenchOption(name="seconds", kind="int", help="Of load.", default=20, low=5, high=600),
            BenchOption(name="rounds", kind="int", help="Jogs that are let go.", default=30, low=1, high=1000),
        ),
        run=runs.run_page,
        layout=(
            BenchTable("rows", (BenchColumn("figure", "what"), BenchColumn("value>", "value", "g")), has_targets=True),
        ),
        has_failed=lambda document: not all(row.met for row in document["rows"]),
    ),
)

BENCHMARKS: dict[str, Benchmark] = index_benchmarks(_BENCHMARKS)
"""By name of the command."""
