"""The skew of simulated fleets with real sockets, pseudo-terminals and processes of this machine, including its noise.

Adapters, firing process, bus and coordinator are the real ones; simulated controllers are delayed like every process
here, unlike hardware: the result is this machine's figure, not the fleet's.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from orchestrator.bench.fleet import run_measured_fleet
from orchestrator.bench.spread import DurationSpread, WakeUpNoise, make_spread
from orchestrator.bench.truth import NothingHappened
from orchestrator.clock.live import raw_ns
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.runtime.live.demo_truth import check_verdicts
from orchestrator.runtime.simulated_fleets import make_sync_fleet

FLEETS = ("8 SMC-4000", "mixed")


class LiveSync(NamedTuple):
    """start: skews of true starts.
    outside: steps with a start outside its evidence.
    noise: wake-up delay of a process on this machine."""

    fleet: str
    start: DurationSpread
    outside: int
    noise: DurationSpread


async def bench_sync_live(steps: int, state: Path, on_line: Callable[[str], None]) -> list[LiveSync]:
    """Run `steps` steps on each fleet. Raises `UpFailed`, `Refusal`, `NothingHappened`."""
    return [await _run_fleet(name, steps, state / str(number), on_line) for number, name in enumerate(FLEETS)]


async def _run_fleet(name: str, steps: int, state: Path, on_line: Callable[[str], None]) -> LiveSync:
    on_line(f"{name}: {steps} steps")
    fleet = make_sync_fleet(name, 1)
    names = list(fleet.controllers)
    targets = {f"{name}.x": fleet.controllers[name].axes["x"].limits.velocity * 0.5 for name in names}
    moves: list[dict[str, object]] = [
        {"do": "move", "to": targets if k % 2 == 0 else dict.fromkeys(targets, 0.0), "speed": 0.5} for k in range(steps)
    ]
    job = Job.model_validate(
        {
            "schema": "tutti.job/1",
            "name": "sync, live",
            "max_start_skew": "500 ms",
            "max_end_skew": "1 s",
            "steps": [{"do": "enable", "axes": names}, {"do": "home"}, *moves],
        }
    )
    async with run_measured_fleet(fleet, state) as (live, tutti), WakeUpNoise() as noise:
        began_ns = raw_ns()
        report = await tutti.wait_for_job(await tutti.submit(job), poll_s=0.2)
        if report.state != "done":
            raise NothingHappened(f"{name}: the job is {report.state}: {report.reason}")
        async with tutti.subscribe_samples(tutti.keys.leader) as heartbeats:
            origin_ns = LeaderHeartbeat.read_message((await heartbeats.get()).payload).origin_host_ns
        checks = check_verdicts(fleet, report, live.state / "truth", origin_ns)
        on_line(f"{name}: {(raw_ns() - began_ns) / 1e9:.0f} s")
        return LiveSync(
            name,
            make_spread([check.skew_ns for check in checks]),
            sum(not check.held for check in checks),
            noise.make_spread(),
        )
