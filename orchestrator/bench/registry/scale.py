"""The record of the benchmark of fleets of hundreds, in virtual time and live."""

from typing import NamedTuple

from orchestrator.bench.registry import runs
from orchestrator.bench.registry.record import BenchColumn, Benchmark, BenchOption, BenchTable, Document

LIVE_LABELS = {
    "controllers": ("controllers", ""),
    "hosts": ("adapter hosts", ""),
    "adopted_s": ("first process started to all adopted", "s"),
    "home_s": ("enable and home all", "s"),
    "first_start_ms": ("first step over all: submission to T0", "ms"),
    "start_ms": ("learned step over all: submission to T0", "ms"),
    "done_s": ("its submission to its report", "s"),
    "start_skew_ms": ("its start skew by the evidence, at most", "ms"),
    "jobs": ("jobs at once, on controllers of their own", ""),
    "jobs_submitted_s": ("until all are accepted", "s"),
    "jobs_done_s": ("until all have ended", "s"),
    "jobs_failed": ("of them not done", ""),
    "latched_s": ("e-stop to its report by all", "s"),
    "reset_s": ("reset to its report by all", "s"),
    "coordinator_cpu_ms": ("at rest: CPU of the coordinator for a controller", "ms/s"),
    "host_cpu_ms": ("CPU of a host for a controller", "ms/s"),
    "router_cpu_ms": ("CPU of the router", "ms/s"),
    "coordinator_mb": ("memory of the coordinator", "MB"),
    "host_mb": ("memory of a host", "MB"),
    "router_mb": ("memory of the router", "MB"),
    "refusals": ("refusals", ""),
    "alarms": ("alarms", ""),
    "losses": ("losses of messages in logs", ""),
}
"""Label and unit of each field of `LiveScale`."""


class _LiveFigure(NamedTuple):
    """One row of the table of a live run."""

    label: str
    figure: float
    unit: str


def _list_live_rows(document: Document) -> list[_LiveFigure] | None:
    figures = document["live"]
    if figures is None:
        return None
    return [_LiveFigure(label, getattr(figures, field), unit) for field, (label, unit) in LIVE_LABELS.items()]


SCALE = Benchmark(
    name="scale",
    help="""Count and time the work of fleets of 10 to 1,000 controllers of four axes, in virtual time, or of one live.

    The controllers are light ones, which cost next to nothing: what is measured is Tutti. In virtual time counts are
    exact, and processor times are those of all parts together, the medium too; 200 controllers take two minutes.

    With --live a fleet runs as processes of this computer, which share its processors: router, coordinator, adapter
    hosts and their guardians. Jobs that fail, refusals, alarms other than that of the e-stop, and losses
    are to be 0.
    """,
    example="tutti bench scale --live --controllers 200 --json",
    options=(
        BenchOption(
            name="controllers", kind="int", help="Only one of so many; live 50.", low=2, high=5000, metavar="N"
        ),
        BenchOption(
            name="hosts", kind="int", help="Adapter hosts; one for 50 by default.", low=1, high=100, metavar="H"
        ),
        BenchOption(name="live", kind="flag", help="As processes of this computer, in its time."),
    ),
    run=runs.run_scale,
    layout=(
        BenchTable(
            "rows",
            (
                BenchColumn("at rest, a second", "controllers"),
                BenchColumn("hosts", "hosts"),
                BenchColumn("declarations of a host>", "declared", ".0f"),
                BenchColumn("messages of a host>", "rest_messages", ".1f"),
                BenchColumn("bytes of a controller>", "rest_size", ".0f"),
                BenchColumn("wake-ups for a host>", "rest_wakes", ".1f"),
                BenchColumn("commits>", "rest_writes"),
                BenchColumn("tasks of a controller>", "rest_tasks", ".1f"),
                BenchColumn("CPU of a controller, ms>", "rest_cpu_ms", ".3f"),
            ),
        ),
        BenchTable(
            "rows",
            (
                BenchColumn("a step over all", "controllers"),
                BenchColumn("messages of a host>", "step_messages", ".1f"),
                BenchColumn("bytes of a controller>", "step_size", ".0f"),
                BenchColumn("wake-ups for a host>", "step_wakes", ".1f"),
                BenchColumn("commits>", "step_writes"),
                BenchColumn("tasks of a controller>", "step_tasks", ".1f"),
                BenchColumn("CPU of a controller, ms>", "step_cpu_ms", ".2f"),
            ),
        ),
        BenchTable(
            "rows",
            (
                BenchColumn("in virtual time, ms", "controllers"),
                BenchColumn("submission to start>", "start_ms", ".0f"),
                BenchColumn("first after a restart>", "first_start_ms", ".0f"),
                BenchColumn("e-stop to slowing down>", "estop_ms", ".1f"),
                BenchColumn("start skew, µs>", "skew_us", ".1f"),
            ),
        ),
        BenchTable(
            _list_live_rows,
            (
                BenchColumn("live", "label"),
                BenchColumn("figure>", "figure", ".3g"),
                BenchColumn("unit", "unit"),
            ),
        ),
    ),
    has_failed=lambda document: document["live"] is not None and document["live"].has_failed,
)
