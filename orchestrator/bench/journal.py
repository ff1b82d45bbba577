"""The rate of job submissions to the journal, and the restart time of a coordinator with a long history."""

import time
from pathlib import Path
from typing import NamedTuple

from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.latch import FileLatchStore
from orchestrator.bus.memory.bus import MemoryBus, MemoryNet
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.executor import run_inline
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.coordinator import Coordinator
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.leadership.environment import CoordinatorEnvironment, run_no_command
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import JobReport, JobState, JobTransition
from orchestrator.runtime.virtual.disk import VirtualDisk

SUBMIT_TARGET_S = 3.0  # for a thousand
RESTART_TARGET_S = 1.0  # with ten thousand
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
    job = _make_job(fleet)
    fsync_ms = _measure_fsync_ms(folder)
    submit_s = run_virtual(lambda clock: _measure_submit(fleet, clock, folder / "submit.db", job, jobs))
    path = folder / "history.db"
    _fill_history(path, job, history)
    restart_s = run_virtual(lambda clock: _measure_restart(fleet, clock, path, history))
    return JournalFigures(
        jobs=jobs,
        submit_s=round(submit_s, 2),
        submit_met=submit_s < SUBMIT_TARGET_S if jobs == 1000 else None,
        fsync_ms=round(fsync_ms, 3),
        history=history,
        restart_s=round(restart_s, 3),
        restart_met=restart_s < RESTART_TARGET_S if history == 10_000 else None,
        file_mb=round(path.stat().st_size / 1e6, 1),
    )


def _make_job(fleet: Fleet) -> Job:
    """Return a typical job: some steps on all axes."""
    move: dict[str, object] = {"do": "move", "to": dict.fromkeys(fleet.axis_names, 1.0), "speed": 0.5}
    steps: list[dict[str, object]] = [{"do": "enable", "axes": list(fleet.controllers)}, {"do": "home"}, *[move] * 4]
    return Job.model_validate({"schema": "tutti.job/1", "name": "bench", "actor": "bench", "steps": steps})


def _measure_fsync_ms(folder: Path) -> float:
    journal = SqliteJournal(folder / "fsync.db")
    took_s: list[float] = []
    for epoch in range(50):
        began_s = time.perf_counter()
        journal.take_epoch(epoch)
        took_s.append(time.perf_counter() - began_s)
    journal.close()
    return sorted(took_s)[len(took_s) // 2] * 1000


def _make_coordinator(fleet: Fleet, clock: VirtualClock, journal: SqliteJournal) -> tuple[Coordinator, Tutti]:
    net = MemoryNet(clock)
    numbers = iter(range(10**9))

    def make_id() -> str:
        # Its head becomes a job's id.
        return f"{next(numbers):08x}{'0' * 24}"

    bus: MemoryBus = net.join_process("coordinator")
    court = CoordinatorEnvironment(
        bus=bus,
        keys=FleetKeys(fleet.fleet),
        clock=clock,
        journal=journal,
        execute=run_inline,
        new_id=make_id,
        sink=lambda _: None,
        save_fleet=lambda _: None,
        latches=FileLatchStore(Path("estop.json"), VirtualDisk(clock).access_files()),
        run_command=run_no_command,
        find_free=VirtualDisk(clock).find_free,
    )
    return Coordinator(fleet, court), Tutti(net.join_process("client"), fleet.fleet, "bench", make_id)


async def _measure_submit(fleet: Fleet, clock: VirtualClock, path: Path, job: Job, jobs: int) -> float:
    journal = SqliteJournal(path)
    coordinator, client = _make_coordinator(fleet, clock, journal)
    await coordinator.start()
    began_s = time.perf_counter()
    for number in range(jobs):
        # Held: the queue is measured, not the execution of jobs without controllers.
        await client.submit(job, f"key-{number}", QueueTerms(held=True))
    took_s = time.perf_counter() - began_s
    total = (await client.list_jobs(1)).total
    if total != jobs:
        raise RuntimeError(f"{total} of {jobs} jobs are in the journal")
    await coordinator.close()
    journal.close()
    return took_s


def _fill_history(path: Path, job: Job, history: int) -> None:
    """Write finished jobs to the journal, as a coordinator does."""
    journal = SqliteJournal(path)
    for number in range(history):
        job_id = f"h{number:07}"
        journal.accept_job(job_id, job_id, job, EPOCH_UTC)
        for state in _STATES:
            journal.record_transition(job_id, _make_transition(state, number))
        journal.record_end(job_id, _make_transition("done", number), _make_report(job, job_id, number))
    journal.close()


def _make_transition(state: JobState, number: int) -> JobTransition:
    return JobTransition(state=state, reason="", actor="bench", utc=EPOCH_UTC, fleet_ns=number)


def _make_report(job: Job, job_id: str, number: int) -> JobReport:
    return JobReport(
        job_id=job_id,
        name=job.name,
        actor=job.actor,
        state="done",
        reason="",
        epoch=1,
        submitted_utc=EPOCH_UTC,
        max_start_skew_ns=job.max_start_skew,
        transitions=[_make_transition(state, number) for state in _STATES],
    )


async def _measure_restart(fleet: Fleet, clock: VirtualClock, path: Path, history: int) -> float:
    began_s, began_ns = time.perf_counter(), clock.now_ns()
    journal = SqliteJournal(path)
    coordinator, client = _make_coordinator(fleet, clock, journal)
    await coordinator.start()
    total = (await client.list_jobs(20)).total
    took_s = time.perf_counter() - began_s
    if total != history or clock.now_ns() - began_ns > 5 * NS_PER_S:
        raise RuntimeError(f"{total} of {history} jobs are found after {clock.now_ns() - began_ns} ns")
    await coordinator.close()
    journal.close()
    return took_s
