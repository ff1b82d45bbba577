"""From the end of one step to the start of the next: steps back to back, beside scripts with a socket.

In virtual time, judged by the simulators' ground truth, where only links, firmware and the work of Tutti take time; and
live, with real processes, sockets and pseudo-terminals of this machine.
"""

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from adapters.toolkit.frames import printable_text
from orchestrator.bench.field_scripts import SCRIPTS
from orchestrator.bench.fleet import run_measured_fleet
from orchestrator.bench.naive import Motions, ScriptLoop, find_gaps, find_whole_ns, measure_script, read_virtual_motions
from orchestrator.bench.spread import make_spread
from orchestrator.bench.step_fleets import SCAN_POINTS, StepsFleet, list_fleets, make_scan_fleet
from orchestrator.bench.step_wire import GapExchange, find_gap, record_wires
from orchestrator.bench.truth import NothingHappened, read_motions
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet, SerialLink
from orchestrator.model.jobs.job import Job
from orchestrator.model.names import controller_of
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

LIVE_MORE_MS = 3.0  # than in virtual time, of the median gap
LIVE_SERIAL_MORE_MS = 10.0  # the same behind a pseudo-terminal
LIVE_CHAINED = 0.95  # of the steps
KNOWN_STEPS = 24  # at the beginning, until the durations of this fleet are known


class StepsFigures(NamedTuple):
    """A row; medians and percentiles in virtual time, ms. move_ms: a motion, as executed. gap_ms, gap_p99_ms: from
    the end of a step to the start of the next. asked, asked_ms: the bound in words, and as it results from this run.
    naive_ms: the gap of the script of this benchmark; field: that of scripts of the field, by name. wire_ms: the
    wire's own sum. chained: steps that began at the T0 that was agreed while the step before moved, of those that
    could. broken: why others did not. live_…: the same with real processes; None without. live_more_ms: how much more
    than in virtual time is allowed there."""

    fleet: str
    steps: int
    move_ms: float
    gap_ms: float
    gap_p99_ms: float
    asked: str
    asked_ms: float
    chained: int
    naive_ms: float
    field: dict[str, float]
    wire_ms: float
    broken: dict[str, int]
    live_more_ms: float = LIVE_MORE_MS
    live_gap_ms: float | None = None
    live_chained: int | None = None
    live_broken: dict[str, int] | None = None

    @property
    def could(self) -> int:
        """The steps that could follow another one."""
        return self.steps - 1

    @property
    def ratio(self) -> float:
        """The gap, to that of the script of this benchmark."""
        return self.gap_ms / self.naive_ms

    @property
    def met(self) -> bool:
        return self.gap_ms <= self.asked_ms

    @property
    def live_met(self) -> bool | None:
        """Whether enough steps were chained, and their gap is near that in virtual time."""
        if self.live_gap_ms is None or self.live_chained is None:
            return None
        return self.live_chained >= LIVE_CHAINED * self.could and self.live_gap_ms <= self.gap_ms + self.live_more_ms


class ScanFigures(NamedTuple):
    """A scan in virtual time, from the first start to the last end, s. naive_s: the script of this benchmark."""

    fleet: str
    points: int
    whole_s: float
    asked: str
    asked_s: float
    naive_s: float
    field: dict[str, float]

    @property
    def ratio(self) -> float:
        """The duration, to that of the script of this benchmark."""
        return self.whole_s / self.naive_s

    @property
    def met(self) -> bool:
        return self.whole_s <= self.asked_s


class ExchangeRow(NamedTuple):
    """A line on the wire of a controller and its reply, in one gap. at_ms: since the end of the step. line_ms: its
    bytes at the baud rate; firmware_ms: the mean time of the simulated firmware. need: what evidence needs it for;
    manual: where the manual has it. is_between: between the end of the step and the start of the next."""

    fleet: str
    at_ms: float
    out: str
    out_bytes: int
    back: str
    back_bytes: int
    line_ms: float
    firmware_ms: float
    need: str
    manual: str
    is_between: bool


class StepsResult(NamedTuple):
    """All rows. exchanges: of the fleets of one controller where evidence needs some; scan: None without."""

    rows: list[StepsFigures]
    exchanges: list[ExchangeRow]
    scan: ScanFigures | None


async def bench_steps(steps: int, scan_points: int, live: Path | None, on_line: Callable[[str], None]) -> StepsResult:
    """Measure every fleet over `steps` steps. scan_points: of the scan; 0: none. live: a folder for the state of live
    fleets; None: only virtual time.

    Raises `NothingHappened`, `UpFailed`, `Refusal`."""
    figures: list[StepsFigures] = []
    exchanges: list[ExchangeRow] = []
    for number, fleet in enumerate(list_fleets()):
        on_line(f"{fleet.name}: virtual")
        row, fleet_exchanges = await asyncio.to_thread(measure_virtual, fleet, steps)
        exchanges += fleet_exchanges
        if live is not None:
            on_line(f"{fleet.name}: live")
            report, motions = await _run_live(fleet, steps, live / str(number))
            row = row._replace(
                live_gap_ms=_median_ms(find_gaps(motion[-steps:] for motion in motions.values())),
                live_chained=_count_chained(report),
                live_broken=_count_breaks(report),
            )
        figures.append(row)
    if not scan_points:
        return StepsResult(figures, exchanges, None)
    on_line(f"scan of {scan_points} points: virtual")
    return StepsResult(figures, exchanges, await asyncio.to_thread(measure_scan, scan_points))


def measure_virtual(subject: StepsFleet, steps: int) -> tuple[StepsFigures, list[ExchangeRow]]:
    """Measure one fleet in virtual time, beside the scripts. Raises `NothingHappened`, `Refusal`."""
    report, motions, wires = run_virtual(lambda clock: _run_recorded(subject, clock, steps))
    scripts = {
        name: find_gaps(measure_script(subject.fleet, loops, _make_moves(subject.counts, steps)).values())
        for name, loops in list_scripts(subject.fleet)
    }
    naive_ms, *field_ms = (_median_ms(gaps) for gaps in scripts.values())
    wire_ms = max((sum(exchange.needed_ms for exchange in wire) for wire in wires), default=0.0)
    gaps = make_spread(find_gaps(motions.values()))
    is_serial = any(isinstance(config.link, SerialLink) for config in subject.fleet.controllers.values())
    row = StepsFigures(
        fleet=subject.name,
        steps=steps,
        move_ms=_median_ms([end_ns - start_ns for axis in motions.values() for start_ns, end_ns in axis]),
        gap_ms=round(gaps.p50_ms, 2),
        gap_p99_ms=round(gaps.p99_ms, 2),
        asked=str(subject.asked),
        asked_ms=round(subject.asked.bound_ms(naive_ms, wire_ms), 1),
        chained=_count_chained(report),
        naive_ms=naive_ms,
        field=dict(zip(list(scripts)[1:], field_ms, strict=True)),
        wire_ms=round(wire_ms, 1),
        broken=_count_breaks(report),
        live_more_ms=LIVE_SERIAL_MORE_MS if is_serial else LIVE_MORE_MS,
    )
    return row, _list_rows(subject, wires)


def _list_rows(subject: StepsFleet, wires: list[list[GapExchange]]) -> list[ExchangeRow]:
    """What is shown: the exchanges of a fleet of one controller, where evidence needs some of them."""
    if len(subject.counts) > 1 or not any(exchange.need for wire in wires for exchange in wire):
        return []
    return [
        ExchangeRow(
            fleet=subject.name,
            at_ms=round(exchange.at_ms, 1),
            out=printable_text(exchange.out),
            out_bytes=len(exchange.out),
            back=printable_text(exchange.back),
            back_bytes=len(exchange.back),
            line_ms=round(exchange.out_ms + exchange.back_ms, 2),
            firmware_ms=round(exchange.firmware_ms, 2),
            need=exchange.need,
            manual=exchange.manual,
            is_between=exchange.is_between,
        )
        for wire in wires
        for exchange in wire
        if exchange.is_between or exchange.need
    ]


def list_scripts(fleet: Fleet) -> list[tuple[str, dict[str, ScriptLoop]]]:
    """The scripts that move a fleet, with the loop for each adapter: that of this benchmark, then those of the field.
    Where a make has fewer than another one, its last one is used again."""
    adapters = sorted({config.adapter for config in fleet.controllers.values()})
    most = max(len(SCRIPTS[adapter]) for adapter in adapters)
    scripts: list[tuple[str, dict[str, ScriptLoop]]] = []
    for number in range(most):
        loops = {adapter: SCRIPTS[adapter][min(number, len(SCRIPTS[adapter]) - 1)] for adapter in adapters}
        scripts.append((" + ".join(dict.fromkeys(loop.name for loop in loops.values())), loops))
    return scripts


async def _run_recorded(
    subject: StepsFleet, clock: VirtualClock, steps: int
) -> tuple[JobReport, Motions, list[list[GapExchange]]]:
    """Run the steps; return the report, their motions, and what was said on each wire in one of the last gaps."""
    virtual = VirtualFleet(subject.fleet, clock, 1)
    wires = record_wires(virtual)
    await virtual.start()
    report = await _run_job(virtual.make_client(), subject, steps)
    motions = {axis: motions[-steps:] for axis, motions in read_virtual_motions(virtual, subject.counts).items()}
    gap = find_gap(motions)
    return report, motions, [wire.list_exchanges(gap) for wire in wires]


def measure_scan(points: int = SCAN_POINTS) -> ScanFigures:
    """Run a scan of one SMC30 in virtual time, beside the scripts. Raises `NothingHappened`, `Refusal`."""
    subject = make_scan_fleet()
    ((axis, counts),) = subject.counts.items()
    whole_ns = find_whole_ns(run_virtual(lambda clock: _run_scan(subject, clock, points)).values())
    moves = [{axis: counts * number} for number in range(1, points + 1)]
    naive_s, *field_s = (
        round(find_whole_ns(measure_script(subject.fleet, loops, moves).values()) / NS_PER_S, 2)
        for _, loops in list_scripts(subject.fleet)
    )
    return ScanFigures(
        fleet=subject.name,
        points=points,
        whole_s=round(whole_ns / NS_PER_S, 2),
        asked=str(subject.asked),
        asked_s=round(subject.asked.bound_ms(naive_s, 0.0), 2),
        naive_s=naive_s,
        field=dict(zip([name for name, _ in list_scripts(subject.fleet)][1:], field_s, strict=True)),
    )


async def _run_scan(subject: StepsFleet, clock: VirtualClock, points: int) -> Motions:
    virtual = VirtualFleet(subject.fleet, clock, 1)
    await virtual.start()
    client = virtual.make_client()
    ((axis, counts),) = subject.counts.items()
    await _run_steps(client, "prepare", [{"do": "enable", "axes": list(subject.fleet.controllers)}, {"do": "home"}])
    positions = [subject.fleet.axis(axis).to_length(counts * number) for number in (1, points)]
    scan = {"do": "scan", "axes": {axis: {"from": positions[0], "to": positions[1], "points": points}}}
    await _run_steps(client, "scan", [scan])
    return {name: motions[-points:] for name, motions in read_virtual_motions(virtual, [axis]).items()}


async def _run_live(subject: StepsFleet, steps: int, state: Path) -> tuple[JobReport, Motions]:
    async with run_measured_fleet(subject.fleet, state) as (live, client):
        report = await _run_job(client, subject, steps)
        return report, {
            axis: read_motions(
                live.state / "truth" / f"{controller_of(axis)}.jsonl", subject.fleet.axis(axis).motors[0]
            )
            for axis in subject.counts
        }


def _make_moves(counts: Mapping[str, int], steps: int) -> list[dict[str, int]]:
    """Moves to and fro, in counts."""
    return [dict(counts) if step % 2 == 0 else dict.fromkeys(counts, 0) for step in range(steps)]


async def _run_job(client: Tutti, subject: StepsFleet, steps: int) -> JobReport:
    """Home the fleet, let it learn its own durations, and run the steps that are measured. Raises `NothingHappened`."""
    names = list(subject.fleet.controllers)
    await _run_steps(client, "prepare", [{"do": "enable", "axes": names}, {"do": "home"}])
    moves: list[dict[str, Any]] = [
        {"do": "move", "to": {axis: subject.fleet.axis(axis).to_length(counts) for axis, counts in move.items()}}
        for move in _make_moves(subject.counts, steps)
    ]
    await _run_steps(client, "learn", moves[: KNOWN_STEPS // 2 * 2])
    return await _run_steps(client, "steps", moves)


async def _run_steps(client: Tutti, name: str, steps: list[dict[str, Any]]) -> JobReport:
    job = Job.model_validate({"schema": "tutti.job/1", "name": name, "max_start_skew": "500 ms", "steps": steps})
    report = await client.wait_for_job(await client.submit(job), poll_s=0.5)
    if report.state != "done":
        raise NothingHappened(f"the benchmark's job {name!r} is {report.state}: {report.reason}")
    return report


def _median_ms(durations_ns: Sequence[int]) -> float:
    return round(median(durations_ns) / NS_PER_MS, 2)


def _count_chained(report: JobReport) -> int:
    return sum(step.chain is not None and step.chain.kept for step in report.steps)


def _count_breaks(report: JobReport) -> dict[str, int]:
    """How many steps began from rest, by reason."""
    breaks: dict[str, int] = {}
    for step in report.steps:
        if step.chain is not None and not step.chain.kept:
            breaks[step.chain.broken] = breaks.get(step.chain.broken, 0) + 1
    return breaks


def list_breaks(rows: Iterable[StepsFigures]) -> list[str]:
    """One line for each reason why steps were not chained."""
    return [
        f"{row.fleet}, {world}: {count} steps from rest: {reason}"
        for row in rows
        for world, breaks in (("virtual", row.broken), ("live", row.live_broken or {}))
        for reason, count in breaks.items()
    ]


def list_sources(rows: Iterable[StepsFigures | ScanFigures]) -> list[str]:
    """One line for each script of the field that stands in the rows."""
    names = {name for row in rows for fleet_name in row.field for name in fleet_name.split(" + ")}
    return [f"{loop.name}: {loop.source}" for loops in SCRIPTS.values() for loop in loops if loop.name in names]


def describe_field(row: StepsFigures | ScanFigures) -> str:
    """The figures of the scripts of the field, with their names."""
    return "; ".join(f"{figure:.1f} {name}" for name, figure in row.field.items())
