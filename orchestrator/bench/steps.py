"""From the end of one step to the start of the next: steps back to back, beside a script with a socket.

In virtual time, judged by the simulators' ground truth, where only links, firmware and the work of Tutti take time; and
live, with real processes, sockets and pseudo-terminals of this machine.
"""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from orchestrator.bench.fleet import run_measured_fleet
from orchestrator.bench.naive import PPSMC, SHRC203, SMC30, SMC4000, NaiveMove, find_gaps, measure_naive_gaps
from orchestrator.bench.truth import NothingHappened, read_motions
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.names import controller_of
from orchestrator.model.report import JobReport
from orchestrator.runtime.examples import find_example
from orchestrator.runtime.simulated_fleets import make_ppsmc, make_shrc203, make_smc30, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

LIVE_MORE_MS = 5.0  # than in virtual time, of the median gap
LIVE_CHAINED = 0.95  # of the steps
REARMING = 1.2  # of the declared time of arming, where a controller is armed after the end of each move
KNOWN_STEPS = 24  # at the beginning, until the durations of this fleet are known


class StepsFleet(NamedTuple):
    """A fleet of the benchmark. counts: how far each axis moves to and fro. asked_ms: of the gap; None: from the
    declared time of arming."""

    name: str
    fleet: Fleet
    counts: Mapping[str, int]
    naive: list[NaiveMove]
    asked_ms: float | None


class StepsFigures(NamedTuple):
    """A row. gap, naive: medians in virtual time, ms. chained: steps that began at the T0 that was agreed while the
    step before moved, of those that could. broken: why others did not. live_…: the same with real processes; None
    without."""

    fleet: str
    steps: int
    gap_ms: float
    asked_ms: float
    chained: int
    naive_ms: float
    broken: dict[str, int]
    live_gap_ms: float | None = None
    live_chained: int | None = None
    live_broken: dict[str, int] | None = None

    @property
    def could(self) -> int:
        """The steps that could follow another one."""
        return self.steps - 1

    @property
    def met(self) -> bool:
        return self.gap_ms <= self.asked_ms

    @property
    def live_met(self) -> bool | None:
        """Whether enough steps were chained, and their gap is near that in virtual time."""
        if self.live_gap_ms is None or self.live_chained is None:
            return None
        return self.live_chained >= LIVE_CHAINED * self.could and self.live_gap_ms <= self.gap_ms + LIVE_MORE_MS


def list_fleets() -> list[StepsFleet]:
    """Return the fleets of the benchmark."""
    demo = load_fleet(find_example("demo.fleet.yaml"))
    return [
        _make_fleet("1 SMC-4000", [make_smc4000(0)], 2000, NaiveMove(SMC4000, 2000), 15.0),
        _make_fleet("8 SMC-4000", [make_smc4000(k) for k in range(8)], 2000, NaiveMove(SMC4000, 2000), 20.0),
        StepsFleet(
            "demo fleet",
            demo,
            {"gantry.x": 2000, "stage.u": 5000},
            [NaiveMove(SMC4000, 2000), NaiveMove(SHRC203, 5000)],
            60.0,
        ),
        _make_fleet("SHRC-203", [make_shrc203(0)], 5000, NaiveMove(SHRC203, 5000), None),
        _make_fleet("SMC30", [make_smc30(0, 1)], 2000, NaiveMove(SMC30, 2000), None),
        _make_fleet("pp-electronic SMC", [make_ppsmc(0)], 2000, NaiveMove(PPSMC, 2000), None),
    ]


def _make_fleet(
    name: str, controllers: list[dict[str, Any]], counts: int, naive: NaiveMove, asked_ms: float | None
) -> StepsFleet:
    named_controllers = {f"c{number}": controller for number, controller in enumerate(controllers)}
    fleet = Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "steps", "controllers": named_controllers})
    return StepsFleet(
        name, fleet, {f"{name}.x": counts for name in named_controllers}, [naive] * len(named_controllers), asked_ms
    )


async def bench_steps(steps: int, live: Path | None, on_line: Callable[[str], None]) -> list[StepsFigures]:
    """Measure every fleet over `steps` steps. live: a folder for the state of live fleets; None: only virtual time.

    Raises `NothingHappened`, `UpFailed`, `Refusal`."""
    figures: list[StepsFigures] = []
    for number, fleet in enumerate(list_fleets()):
        on_line(f"{fleet.name}: virtual")
        row = await asyncio.to_thread(_run_virtual, fleet, steps)
        if live is not None:
            on_line(f"{fleet.name}: live")
            report, motions = await _run_live(fleet, steps, live / str(number))
            row = row._replace(
                live_gap_ms=_median_gap_ms(motions, steps),
                live_chained=_count_chained(report),
                live_broken=_count_breaks(report),
            )
        figures.append(row)
    return figures


async def _measure_virtual(each: StepsFleet, clock: VirtualClock, steps: int) -> StepsFigures:
    virtual = VirtualFleet(each.fleet, clock, 1)
    await virtual.start()
    client = virtual.make_client()
    report = await _run_job(client, each, steps)
    infos = [await client.controller_info(name) for name in each.fleet.controllers]
    declared_ms = max(info.costs.arm_ns for info in infos) / NS_PER_MS
    motions = {
        axis: [
            (motion.start_ns, motion.end_ns)
            for motion in virtual.controllers[controller_of(axis)].commanded_motions
            if motion.axis == each.fleet.axis(axis).motors[0] and motion.end_ns is not None
        ]
        for axis in each.counts
    }
    holds_ns = [round(config.simulate.hold_ms * NS_PER_MS) for config in each.fleet.controllers.values()]
    script = [replace(move, hold_ns=hold_ns) for move, hold_ns in zip(each.naive, holds_ns, strict=True)]
    naive = measure_naive_gaps(script, steps)
    return StepsFigures(
        fleet=each.name,
        steps=steps,
        gap_ms=_median_gap_ms(motions, steps),
        asked_ms=round(REARMING * declared_ms if each.asked_ms is None else each.asked_ms, 1),
        chained=_count_chained(report),
        naive_ms=round(median(naive) / NS_PER_MS, 2),
        broken=_count_breaks(report),
    )


def _run_virtual(each: StepsFleet, steps: int) -> StepsFigures:
    return run_virtual(lambda clock: _measure_virtual(each, clock, steps))


async def _run_live(each: StepsFleet, steps: int, state: Path) -> tuple[JobReport, dict[str, list[tuple[int, int]]]]:
    async with run_measured_fleet(each.fleet, state) as (live, client):
        report = await _run_job(client, each, steps)
        return report, {
            axis: read_motions(live.state / "truth" / f"{controller_of(axis)}.jsonl", each.fleet.axis(axis).motors[0])
            for axis in each.counts
        }


async def _run_job(client: Tutti, each: StepsFleet, steps: int) -> JobReport:
    """Home the fleet, let it learn its own durations, and run the steps that are measured. Raises `NothingHappened`."""
    names = list(each.fleet.controllers)
    await _run_steps(client, "prepare", [{"do": "enable", "axes": names}, {"do": "home"}])
    targets = {axis: each.fleet.axis(axis).to_unit(counts) for axis, counts in each.counts.items()}
    moves: list[dict[str, Any]] = [
        {"do": "move", "to": targets if step % 2 == 0 else dict.fromkeys(targets, 0)} for step in range(steps)
    ]
    await _run_steps(client, "learn", moves[: KNOWN_STEPS // 2 * 2])
    return await _run_steps(client, "steps", moves)


async def _run_steps(client: Tutti, name: str, steps: list[dict[str, Any]]) -> JobReport:
    job = Job.model_validate({"schema": "tutti.job/1", "name": name, "max_start_skew": "500 ms", "steps": steps})
    report = await client.wait_for_job(await client.submit(job), poll_s=0.5)
    if report.state != "done":
        raise NothingHappened(f"the benchmark's job {name!r} is {report.state}: {report.reason}")
    return report


def _median_gap_ms(motions: Mapping[str, list[tuple[int, int]]], steps: int) -> float:
    """The median gap of the last `steps` steps, ms."""
    return round(median(find_gaps(motion[-steps:] for motion in motions.values())) / NS_PER_MS, 2)


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
