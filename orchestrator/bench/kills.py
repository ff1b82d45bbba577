"""`kill -9` and SIGSTOP of every process of a live fleet at random moments: no job is lost or doubled, and no motion
continues.

The demo fleet with a standby coordinator, real Zenoh and real sockets. In each round a job moves both of its
controllers to and fro while one process is killed, or stopped and resumed later; the motions come from the
simulators' logs. Afterwards the fleet must recover by itself: the next round begins with homing.
"""

import asyncio
import contextlib
import os
import signal
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import NamedTuple

from orchestrator.bench.fleet import run_measured_fleet
from orchestrator.bench.processes import list_children
from orchestrator.bench.spread import DurationSpread, WakeUpNoise, make_spread
from orchestrator.bench.truth import NothingHappened, TruthLog
from orchestrator.client import Tutti
from orchestrator.clock.live import raw_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import FINISHED_STATES
from orchestrator.runtime.live.fleet import STANDBY, LiveFleet

SEED = 23
TARGETS = ("router", "coordinator", "standby", "guardian", "host")
SIGNALS = (signal.SIGKILL, signal.SIGSTOP)
# Declared: adapters stop by themselves after 0.5 s without a coordinator, a guardian after 0.3 s without its host; the
# ramps of the job take 0.3 s. The wake-up delay of processes on this machine is measured in parallel.
DECLARED_S = 0.8
FAULT_WINDOW_S = (0.0, 2.5)
STOPPED_S = 2.5
RECOVERY_TIMEOUT_S = 60.0
POLL_S = 0.2
MOVES = 3


class KillFigures(NamedTuple):
    """The figures of all rounds.

    rest: fault → the last axis at rest, in rounds whose job the fault ended.
    back: fault → the fleet has completed a job again.
    lost, doubled: number of jobs.
    moved_on: rounds in which an axis moved for longer than declared.
    ends: of the jobs, by state."""

    rounds: int
    rest: DurationSpread
    back: DurationSpread
    lost: int
    doubled: int
    moved_on: int
    ends: dict[str, int]
    noise: DurationSpread


class _KillRound(NamedTuple):
    """One round. rest_ns: None when the job completed despite the fault."""

    state: str
    rest_ns: int | None
    back_ns: int
    lost: bool
    doubled: bool


async def bench_kills(fleet: Fleet, state: Path, rounds: int, on_line: Callable[[str], None]) -> KillFigures:
    """Run `rounds` faults. Raises `UpFailed`, `NothingHappened`."""
    async with run_measured_fleet(fleet, state, standby=True) as (live, tutti), WakeUpNoise() as noise:
        rig = _KillRig(live, tutti, Random(SEED))
        await rig.wait_for_recovery()
        results: list[_KillRound] = []
        for k in range(rounds):
            target, number = TARGETS[k % len(TARGETS)], SIGNALS[k // len(TARGETS) % len(SIGNALS)]
            results.append(await rig.run_round(target, number))
            rest_ns = results[-1].rest_ns
            rest_text = "" if rest_ns is None else f", at rest after {rest_ns / 1e6:.0f} ms"
            on_line(f"{k + 1} of {rounds}: {number.name} of {target}: job {results[-1].state}{rest_text}")
        rests = [result.rest_ns for result in results if result.rest_ns is not None]
        return KillFigures(
            rounds=len(results),
            rest=make_spread(rests or [0]),
            back=make_spread([result.back_ns for result in results]),
            lost=sum(result.lost for result in results),
            doubled=sum(result.doubled for result in results),
            moved_on=sum(rest_ns > (DECLARED_S * 1e9 + noise.make_spread().max_ms * 1e6) for rest_ns in rests),
            ends={
                state: sum(result.state == state for result in results) for state in sorted({e.state for e in results})
            },
            noise=noise.make_spread(),
        )


class _KillRig:
    """The running fleet."""

    def __init__(self, live: LiveFleet, tutti: Tutti, draw: Random) -> None:
        self._live = live
        self._tutti = tutti
        self._draw = draw
        self._truths = {name: TruthLog(live.state / "truth" / f"{name}.jsonl") for name in live.fleet.controllers}
        self._prepare = _make_job(
            "prepare", [{"do": "enable", "axes": list(live.fleet.controllers)}, {"do": "home"}, _make_move(5)]
        )

    async def run_round(self, target: str, number: signal.Signals) -> _KillRound:
        """Run one job and one fault."""
        key = self._tutti.new_id()
        steps = [_make_move(60 if k % 2 == 0 else 5) for k in range(MOVES)]
        began_ns = raw_ns()
        job = await self._tutti.submit(_make_job("work", steps), client_key=key)
        await asyncio.sleep(self._draw.uniform(*FAULT_WINDOW_S))
        pid, broken_ns = self._find_pid(target), raw_ns()
        os.kill(pid, number)
        if number is signal.SIGSTOP:
            await asyncio.sleep(STOPPED_S)
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        state = await self._wait_for_end(job)
        ends = [end_ns for truth in self._truths.values() for end_ns in truth.find_ends(broken_ns)]
        starts = max(truth.count_events("start", began_ns) for truth in self._truths.values())
        await self.wait_for_recovery()
        back_ns = raw_ns() - broken_ns
        # Submitting it again with its key must return the same job, and must not run it again.
        same_job = await self._tutti.submit(_make_job("work", steps), client_key=key)
        rest_ns = max(ends, default=broken_ns) - broken_ns if state != "done" else None
        return _KillRound(state, rest_ns, back_ns, lost=state == "lost", doubled=same_job != job or starts > 2 * MOVES)

    async def wait_for_recovery(self) -> None:
        """Wait until a job over all axes is done."""
        reason = ""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(RECOVERY_TIMEOUT_S):
                while True:
                    try:
                        report = await self._tutti.wait_for_job(await self._tutti.submit(self._prepare), poll_s=POLL_S)
                        if report.state == "done":
                            return
                        reason = report.reason
                    except Refusal as error:
                        reason = error.text
                    await asyncio.sleep(POLL_S)
        raise NothingHappened(f"the fleet does not recover within {RECOVERY_TIMEOUT_S:g} s: {reason}")

    async def _wait_for_end(self, job: str) -> str:
        """Return the final state of the job; `lost` when it is not in the journal."""
        try:
            async with asyncio.timeout(RECOVERY_TIMEOUT_S):
                report = await self._tutti.wait_for_job(job, poll_s=POLL_S)
        except Refusal:
            return "lost"
        except TimeoutError:
            raise NothingHappened(f"job {job} has not ended after {RECOVERY_TIMEOUT_S:g} s") from None
        return report.state if report.state in FINISHED_STATES else "lost"

    def _find_pid(self, target: str) -> int:
        children = self._live.children
        host = next(name for name in children if name.startswith("host/"))
        if target == "host":
            guardian = children[host].pid
            child_ids = list_children(guardian)
            # A guardian may be between two hosts; then the guardian itself gets the signal.
            return child_ids[0] if child_ids else guardian
        return children[{"guardian": host, "standby": STANDBY}.get(target, target)].pid


def _make_move(place: float) -> dict[str, object]:
    return {"do": "move", "to": {"gantry.x": place, "stage.u": place / 10}, "speed": 0.3}


def _make_job(name: str, steps: list[dict[str, object]]) -> Job:
    plain = {"schema": "tutti.job/1", "name": name, "max_start_skew": "50 ms", "steps": steps}
    return Job.model_validate(plain)
