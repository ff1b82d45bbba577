"""The rate of job submissions to the journal, and the restart time of a coordinator with a long history."""

import time
from pathlib import Path
from typing import NamedTuple

from orchestrator.bus.keys import Keys
from orchestrator.bus.memory.bus import MemoryBus, MemoryNet
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.executor import run_inline
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.coordinator import Coordinator, CoordinatorEnvironment
from orchestrator.coordinator.journal.journal import Journal
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Job
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobReport, JobState, JobTransition

SUBMIT_ASKED_S = 3.0  # for a thousand
RESTART_ASKED_S = 1.0  # with ten thousand
_STATES: tuple[JobState, ...] = ("planning", "arming", "armed", "committed", "running")
EPOCH_UTC = "2026-01-01T00:00:00.000000Z"


class JournalFigures(NamedTuple):
    """The figures of one disk.

    jobs, submit_s: number of jobs, submitted one by one, each on disk before the next, and their total time.
    fsync_ms: time of one transaction alone on this disk, median.
    history, restart_s: number of finished jobs, and the time from opening their journal to a coordinator that leads
    and answers, without the pause in which it listens for another one.
    file_mb: size of the journal."""

    jobs: int
    submit_s: float
    submit_met: bool | None
    fsync_ms: float
    history: int
    restart_s: float
    restart_met: bool | None
    file_mb: float


def bench_journal(fleet: Fleet, folder: Path, jobs: int, history: int) -> JournalFigures:
    """Measure on the disk of `folder`, in real time, with everything but the disk in memory."""
    job = _job(fleet)
    fsync_ms = _fsync_ms(folder)
    submit_s = run_virtual(lambda clock: _submit(fleet, clock, folder / "submit.db", job, jobs))
    path = folder / "history.db"
    _fill(path, job, history)
    restart_s = run_virtual(lambda clock: _restart(fleet, clock, path, history))
    return JournalFigures(
        jobs=jobs,
        submit_s=round(submit_s, 2),
        submit_met=submit_s < SUBMIT_ASKED_S if jobs == 1000 else None,
        fsync_ms=round(fsync_ms, 3),
        history=history,
        restart_s=round(restart_s, 3),
        restart_met=restart_s < RESTART_ASKED_S if history == 10_000 else None,
        file_mb=round(path.stat().st_size / 1e6, 1),
    )


def _job(fleet: Fleet) -> Job:
    """Return a typical job: some steps on all axes."""
    move: dict[str, object] = {"do": "move", "to": dict.fromkeys(fleet.axis_names, 1.0), "speed": 0.5}
    steps: list[dict[str, object]] = [{"do": "enable", "axes": list(fleet.controllers)}, {"do": "home"}, *[move] * 4]
    return Job.model_validate({"schema": "tutti.job/1", "name": "bench", "actor": "bench", "steps": steps})


def _fsync_ms(folder: Path) -> float:
    journal = Journal(folder / "fsync.db")
    took_s: list[float] = []
    for seen in range(50):
        began_s = time.perf_counter()
        journal.take_epoch(seen)
        took_s.append(time.perf_counter() - began_s)
    journal.close()
    return sorted(took_s)[len(took_s) // 2] * 1000


def _coordinator(fleet: Fleet, clock: VirtualClock, journal: Journal) -> tuple[Coordinator, Tutti]:
    net = MemoryNet(clock)
    numbers = iter(range(10**9))

    def new_id() -> str:
        # Its head becomes a job's id.
        return f"{next(numbers):08x}{'0' * 24}"

    bus: MemoryBus = net.join("coordinator")
    court = CoordinatorEnvironment(
        bus=bus,
        keys=Keys(fleet.fleet),
        clock=clock,
        journal=journal,
        execute=run_inline,
        new_id=new_id,
        sink=lambda _: None,
        save_fleet=lambda _: None,
    )
    return Coordinator(fleet, court), Tutti(net.join("client"), fleet.fleet, "bench", new_id)


async def _submit(fleet: Fleet, clock: VirtualClock, path: Path, job: Job, jobs: int) -> float:
    journal = Journal(path)
    coordinator, client = _coordinator(fleet, clock, journal)
    await coordinator.start()
    began_s = time.perf_counter()
    for number in range(jobs):
        # Held: the queue is measured, not the execution of jobs without controllers.
        await client.submit(job, f"key-{number}", QueueTerms(held=True))
    took_s = time.perf_counter() - began_s
    found = (await client.list_jobs(1)).total
    if found != jobs:
        raise RuntimeError(f"{found} of {jobs} jobs are in the journal")
    await coordinator.close()
    journal.close()
    return took_s


def _fill(path: Path, job: Job, history: int) -> None:
    """Write finished jobs to the journal, as a coordinator does."""
    journal = Journal(path)
    for number in range(history):
        job_id = f"h{number:07}"
        journal.accept_job(job_id, job_id, job, EPOCH_UTC)
        for state in _STATES:
            journal.record_transition(job_id, _transition(state, number))
        journal.record_transition(job_id, _transition("done", number), _report(job, job_id, number))
    journal.close()


def _transition(state: JobState, number: int) -> JobTransition:
    return JobTransition(state=state, reason="", actor="bench", utc=EPOCH_UTC, fleet_ns=number)


def _report(job: Job, job_id: str, number: int) -> JobReport:
    return JobReport(
        job_id=job_id,
        name=job.name,
        actor=job.actor,
        state="done",
        reason="",
        epoch=1,
        submitted_utc=EPOCH_UTC,
        max_start_skew_ns=job.max_start_skew,
        transitions=[_transition(state, number) for state in _STATES],
    )


async def _restart(fleet: Fleet, clock: VirtualClock, path: Path, history: int) -> float:
    began_s, began_ns = time.perf_counter(), clock.now_ns()
    journal = Journal(path)
    coordinator, client = _coordinator(fleet, clock, journal)
    await coordinator.start()
    found = (await client.list_jobs(20)).total
    took_s = time.perf_counter() - began_s
    if found != history or clock.now_ns() - began_ns > 5 * NS_PER_S:
        raise RuntimeError(f"{found} of {history} jobs are found after {clock.now_ns() - began_ns} ns")
    await coordinator.close()
    journal.close()
    return took_s
