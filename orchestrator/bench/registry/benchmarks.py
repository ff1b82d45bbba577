"""The registry of the users' benchmarks: what is measured live on the user's computer, with its
processes, sockets and disks.

Those of the developers, which compare Tutti's parts with baselines, are in `benches`, and not in the wheel. Only
records and run functions are loaded for `tutti bench --help`: a benchmark's own module is imported when it runs.
`orchestrator.cli.bench` makes the commands from the records, and prints tables and JSON. To add a benchmark, add its
record and its run function (`orchestrator.bench.registry.runs`).
"""

from typing import Any

from orchestrator.bench.registry import runs
from orchestrator.bench.registry.record import (
    BenchColumn,
    Benchmark,
    BenchNote,
    BenchOption,
    BenchTable,
    Document,
    index_benchmarks,
    make_spread_columns,
    make_spread_table,
)
from orchestrator.bench.registry.scale import SCALE


def _list_dispatch_rows(document: Document) -> list[tuple[str, Any]]:
    return [
        ("submit to first motion", document["first_motion"]),
        ("lead time, once settled", document["lead"]),
        ("last arming to T0", document["armed_to_t0"]),
        *((f"part: {name}", part) for name, part in document["parts"].items()),
        ("process wake-up delay", document["noise"]),
    ]


def _list_journal_rows(document: Document) -> list[tuple[str, float, bool | None, float]]:
    """Return rows of a text, a time, whether it is within its target, and the target."""
    from orchestrator.bench.journal import RESTART_TARGET_S, SUBMIT_TARGET_S

    restart = f"restart with {document['history']} jobs, {document['file_mb']:g} MB"
    return [
        (f"{document['jobs']} jobs submitted", document["submit_s"], document["submit_met"], SUBMIT_TARGET_S),
        (restart, document["restart_s"], document["restart_met"], RESTART_TARGET_S),
    ]


def _list_ends(document: Document) -> list[str]:
    ends = ", ".join(f"{count} {state}" for state, count in document["ends"].items())
    return [
        f"{document['rounds']} faults; jobs: {ends}; lost {document['lost']}, doubled {document['doubled']}, "
        f"motions longer than declared {document['moved_on']}"
    ]


def _list_script_sources(document: Document) -> list[str]:
    from orchestrator.bench.steps import list_sources

    scans = [] if document["scan"] is None else [document["scan"]]
    return [f"script: {line}" for line in list_sources([*document["rows"], *scans])]


def _describe_field_scripts(row: Any) -> str:
    from orchestrator.bench.steps import describe_field

    return describe_field(row)


def _list_chain_breaks(document: Document) -> list[str]:
    from orchestrator.bench.steps import list_breaks

    return list_breaks(document["rows"])


_BENCHMARKS = (
    Benchmark(
        name="dispatch",
        help="""Time jobs from their submission to the first motion, on 16 controllers of four axes on TCP, live.

        Also in virtual time, where only links and firmware take time; its path is the work that must be done before
        anything can move. Live, simulators and fleet share this machine's processors.
        """,
        example="tutti bench dispatch --rounds 50 --json",
        options=(BenchOption(name="rounds", kind="int", help="Jobs.", default=50, low=2, high=100_000),),
        run=runs.run_dispatch,
        layout=(
            BenchTable(
                _list_dispatch_rows,
                (BenchColumn("live", lambda row: row[0]), *make_spread_columns("ms", 1, ".1f")),
            ),
            BenchNote(
                "virtual: first motion {virtual_ms:g} ms, lead {virtual_lead_ms:g} ms, path {virtual_path_ms:g} ms; "
                "simulators used {simulators_cpu:.0%} of the processor time"
            ),
        ),
    ),
    Benchmark(
        name="estop",
        help="""Time an e-stop on 16 controllers on TCP and two on serial lines, live with simulated controllers.

        From its publication to the deceleration of the last axis; in every other round the controllers that do not
        move are being armed. The serial ones take part in every ninth round. A thousand rounds take three quarters of
        an hour.
        """,
        example="tutti bench estop --rounds 100 --json",
        options=(BenchOption(name="rounds", kind="int", help="E-stops.", default=100, low=4, high=100_000),),
        run=runs.run_estop,
        layout=(
            BenchNote("controllers: {controllers}"),
            BenchNote("repeated rounds: {spoilt}"),
            make_spread_table(
                "to deceleration, from",
                {
                    "last": "publication to the last axis",
                    "uploading": "the same, others being armed",
                    "first": "publication to the first axis",
                    "shell": "tutti estop to the last axis",
                    "smc2000_19200": "publication to SMC-2000, 19,200 baud",
                    "shrc203_38400": "publication to SHRC-203, 38,400 baud",
                    "noise": "process wake-up delay",
                },
            ),
        ),
    ),
    Benchmark(
        name="firing",
        help="""Measure the delay of a start command's last byte, live, on an idle machine and with a fleet of 16
        running.

        The firing process needs permission for real-time priority; without it, other processes delay it by
        milliseconds.
        """,
        example="tutti bench firing --shots 1000 --json",
        options=(
            BenchOption(name="shots", kind="int", help="Writes of each kind.", default=500, low=100, high=100_000),
        ),
        run=runs.run_firing,
        layout=(
            make_spread_table(
                "write delay of",
                {
                    "idle": "firing process, idle",
                    "polling": "…, with a fleet polled",
                    "loop_idle": "event loop, idle",
                    "loop_polling": "…, with the same polling",
                },
                "µs",
                1000,
                ".0f",
            ),
        ),
    ),
    Benchmark(
        name="jog",
        help="""Time the jog panel on the demo fleet, live with simulated controllers; takes some minutes.

        From a key release, and from a killed panel, to the start of deceleration. Also: from the press to the first
        motion; the same on a terminal that reports no releases; from the Python interface without panel and terminal;
        and the wake-up delay of processes on this machine.
        """,
        example="tutti bench jog --presses 100 --json",
        options=(
            BenchOption(name="presses", kind="int", help="Of a key.", default=100, low=1, high=10_000),
            BenchOption(name="kills", kind="int", help="Of the panel.", default=10, low=1, high=1000),
        ),
        run=runs.run_jog,
        layout=(
            make_spread_table(
                "to deceleration, from",
                {
                    "release": "key released",
                    "killed": "panel killed",
                    "first_motion": "key press to motion",
                    "plain_release": "released, repeats only",
                    "api_stop": "ManualControl.stop()",
                    "noise": "process wake-up delay",
                },
            ),
        ),
    ),
    Benchmark(
        name="journal",
        help="""Time submissions, each safe on disk before the next, and the restart of a coordinator with many finished
        jobs.

        In real time on a real disk; the bus is in memory. Filling the history first takes a minute.
        """,
        example="tutti bench journal --json",
        options=(
            BenchOption(name="jobs", kind="int", help="Submitted one by one.", default=1000, low=1, high=100_000),
            BenchOption(name="history", kind="int", help="Finished jobs.", default=10_000, low=0, high=1_000_000),
            BenchOption("folder", "folder", "On the disk to measure; default: that of temporary files."),
        ),
        run=runs.run_journal,
        layout=(
            BenchTable(
                _list_journal_rows,
                (
                    BenchColumn("", lambda row: row[0]),
                    BenchColumn("took, s>", lambda row: row[1], "g"),
                    BenchColumn("target, s>", lambda row: None if row[2] is None else row[3], "g"),
                    BenchColumn("met", lambda row: row[2]),
                ),
            ),
            BenchNote("one transaction on this disk: {fsync_ms:g} ms"),
        ),
    ),
    Benchmark(
        name="kills",
        help="""Kill or stop (SIGKILL, SIGSTOP) each process of the live demo fleet at random moments of a job.

        No job may be lost or run twice, no axis may move for longer than declared after the fault, and the fleet must
        recover by itself. A hundred rounds take some twenty minutes.
        """,
        example="tutti bench kills --rounds 100 --json",
        options=(BenchOption(name="rounds", kind="int", help="Faults.", default=100, low=1, high=100_000),),
        run=runs.run_kills,
        layout=(
            make_spread_table(
                "from the fault to",
                {"rest": "the last axis at rest", "back": "a completed job", "noise": "process wake-up delay"},
            ),
            BenchNote(_list_ends),
        ),
        has_failed=lambda document: bool(document["lost"] or document["doubled"] or document["moved_on"]),
    ),
    Benchmark(
        name="record",
        help="""Measure the recorder, live: 64 axes on 16 controllers, published 100 times a second by a process of its
        own.

        Everything published is recorded, or counted as left out; the recorder itself puts nothing and answers nothing.
        Then copies of a recording are cut at random bytes, and the recorder is killed: each file is repaired, and keeps
        all chunks that were closed.
        """,
        example="tutti bench record --json",
        options=(
            BenchOption(name="seconds", kind="int", help="Time of publishing.", default=60, low=5, high=3600),
            BenchOption(name="cuts", kind="int", help="Copies that are cut.", default=500, low=1, high=100_000),
        ),
        run=runs.run_record,
        layout=(
            BenchTable(
                lambda document: [
                    (
                        f"published {document['published']}; recorded {document['recorded']}, left out",
                        document["dropped"],
                        "all counted",
                        document["counted"],
                    ),
                    ("processor time of the recorder, %", document["cpu_share"] * 100, "<= 15", document["cpu_met"]),
                    ("MB an hour", document["mb_per_hour"], "<= 250", document["size_met"]),
                    (
                        f"closed chunks lost in {document['cuts']} cut copies",
                        document["lost_chunks"],
                        "0",
                        not document["lost_chunks"],
                    ),
                    (
                        f"recordings damaged by {document['kills']} kills",
                        document["kill_losses"],
                        "0",
                        not document["kill_losses"],
                    ),
                ],
                (
                    BenchColumn("recorder", lambda row: row[0]),
                    BenchColumn("found>", lambda row: row[1], ".4g"),
                    BenchColumn("target", lambda row: row[2]),
                    BenchColumn("met", lambda row: row[3]),
                ),
            ),
            BenchNote(lambda document: document["failures"]),
        ),
        has_failed=lambda document: bool(document["failures"] or document["lost_chunks"] or document["kill_losses"]),
    ),
    Benchmark(
        name="permit",
        help="""Time the loss of a permit in a step over eight controllers, live with simulated controllers.

        From the change of the input to the deceleration of the last axis, against 50 ms and the poll interval of a
        moving controller; and the wake-up delay of processes on this machine.
        """,
        example="tutti bench permit --rounds 20 --json",
        options=(BenchOption(name="rounds", kind="int", help="Losses of the permit.", default=20, low=1, high=1000),),
        run=runs.run_permit,
        layout=(
            BenchNote("controllers: {controllers}"),
            BenchNote("poll interval, ms: {poll_ms:g}"),
            make_spread_table(
                "to deceleration, from",
                {
                    "stopped": "input to the last axis",
                    "first": "input to the first axis",
                    "noise": "process wake-up delay",
                },
            ),
        ),
    ),
    Benchmark(
        name="steps",
        help="""Measure the time from the end of one step to the start of the next, beside scripts with a socket per
        controller.

        In virtual time, judged by the simulators' ground truth, and live with 100 steps a fleet, which takes some
        twenty minutes, most of them for seven SMC30 on one bus. The scripts send the same moves over the same
        simulated links one after the other: send, begin, query until all rest. One of them is of this benchmark, and
        sets the ratio; those of the field have the loops of public drivers, or of the maker's manual. Moves are as
        long as their name says, at the limits of the axis.
        """,
        example="tutti bench steps --json",
        options=(
            BenchOption(name="steps", kind="int", help="Steps of a fleet.", default=100, low=10, high=100_000),
            BenchOption("scan-points", "int", "Points of the scan; 0: no scan.", default=1000, low=0, high=100_000),
            BenchOption("virtual-only", "flag", "Only in virtual time.", default=False),
            BenchOption("exchanges", "flag", "Also list what is sent and received in one gap.", default=False),
        ),
        run=runs.run_steps,
        layout=(
            BenchTable(
                "rows",
                (
                    BenchColumn("end to start, ms", "fleet"),
                    BenchColumn("p50>", "gap_ms", ".1f"),
                    BenchColumn("p99>", "gap_p99_ms", ".1f"),
                    BenchColumn("script>", "naive_ms", ".1f"),
                    BenchColumn("ratio>", "ratio", ".1f"),
                    BenchColumn("wire>", lambda row: row.wire_ms or None, ".1f"),
                    BenchColumn("asked", "asked"),
                    BenchColumn("target>", "asked_ms", ".1f"),
                    BenchColumn("met", "met"),
                    BenchColumn("move>", "move_ms", ".0f"),
                    BenchColumn("chained>", lambda row: f"{row.chained} of {row.could}"),
                    BenchColumn("live p50>", "live_gap_ms", ".1f"),
                    BenchColumn(
                        "live chained>",
                        lambda row: None if row.live_chained is None else f"{row.live_chained} of {row.could}",
                    ),
                    BenchColumn("live met", "live_met"),
                ),
            ),
            BenchTable(
                lambda document: None if document["scan"] is None else [document["scan"]],
                (
                    BenchColumn("first start to last end, s", "fleet"),
                    BenchColumn("points>", "points"),
                    BenchColumn("whole>", "whole_s", ".1f"),
                    BenchColumn("script>", "naive_s", ".1f"),
                    BenchColumn("ratio>", "ratio", ".2f"),
                    BenchColumn("asked", "asked"),
                    BenchColumn("target>", "asked_s", ".1f"),
                    BenchColumn("met", "met"),
                ),
            ),
            BenchTable(
                lambda document: [*document["rows"], *([] if document["scan"] is None else [document["scan"]])],
                (
                    BenchColumn("scripts of the field, ms (scan: s)", "fleet"),
                    BenchColumn("p50, name", _describe_field_scripts),
                ),
            ),
            BenchTable(
                "exchanges",
                (
                    BenchColumn("one gap, byte by byte", "fleet"),
                    BenchColumn("at, ms>", "at_ms", ".1f"),
                    BenchColumn("exchange", "out"),
                    BenchColumn("out>", "out_bytes"),
                    BenchColumn("back>", "back_bytes"),
                    BenchColumn("line, ms>", "line_ms", ".1f"),
                    BenchColumn("firmware, ms>", "firmware_ms", ".1f"),
                    BenchColumn("needed for", "need"),
                    BenchColumn("manual", "manual"),
                    BenchColumn("between", lambda row: "yes" if row.is_between else "no"),
                ),
            ),
            BenchNote(_list_script_sources),
            BenchNote(_list_chain_breaks),
        ),
    ),
    SCALE,
    Benchmark(
        name="sync",
        help="""Start two simulated fleets together with real sockets and processes, and measure the skew.

        The ground truth comes from the simulators, which run on this computer too and share its delays: the skews are
        those of this computer, beside the wake-up delay of its processes. Also counted: starts outside their evidence.
        """,
        example="tutti bench sync --steps 100 --json",
        options=(BenchOption(name="steps", kind="int", help="Steps of a fleet.", default=100, low=2, high=10_000),),
        run=runs.run_sync,
        layout=(
            BenchTable(
                "rows",
                (
                    BenchColumn("start skew, ms", "fleet"),
                    BenchColumn("p50>", lambda row: row.start.p50_ms, ".3g"),
                    BenchColumn("p99>", lambda row: row.start.p99_ms, ".3g"),
                    BenchColumn("max>", lambda row: row.start.max_ms, ".3g"),
                    BenchColumn("outside evidence>", lambda row: f"{row.outside} of {row.start.n}"),
                    BenchColumn("noise p99>", lambda row: row.noise.p99_ms, ".3g"),
                ),
            ),
            BenchNote("This includes host noise: simulated controllers run on this machine too, and share its delays."),
        ),
    ),
)

BENCHMARKS: dict[str, Benchmark] = index_benchmarks(_BENCHMARKS)
"""By name of the command."""
