"""A fleet of light controllers live: router, coordinator, adapter hosts under guardians, all as processes of this
computer, and a client.

Times are those of the client, which asks again and again where it waits for states: with many controllers a question
takes a part of a second. Processor times of a host include those of its guardian, and of its controllers, which are
simulated in its process. All share this computer's processors.
"""

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

from orchestrator.bench.fleet import Steps, run_measured_fleet, wait_until
from orchestrator.bench.processes import iterate_tree, read_cpu_s, read_resident_bytes
from orchestrator.bench.scale import DISTANCE, LEARNING_STEPS, REST_S
from orchestrator.bench.truth import NothingHappened
from orchestrator.client import SubmittedJob, Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.live import raw_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.operation.commands import MAX_LISTED
from orchestrator.model.report import FINISHED_STATES, JobReport
from orchestrator.runtime.live.fleet import LiveFleet
from orchestrator.runtime.readiness import find_origin_host_ns
from orchestrator.runtime.simulated_fleets import make_light_fleet

CONTROLLERS = 50  # of a run without another number
MANY_CONTROLLERS = 1000  # from which on more jobs run at once
JOBS, MANY_JOBS = 50, 200
COUNTED_STEPS = 5
MAX_REASON = 300  # characters: a reason may name each axis
MAX_SUBMISSIONS = 20  # of one job, with one key: it runs once
LIMIT_S = 300.0
SLOW = 0.1  # the part of its speed at which a move lasts long enough for an e-stop
MOVING_S = 0.5  # from the commit of this move to the e-stop
LOSSES = ("left out", "were not taken", "may be lost", "are lost")
"""What a line of a log says of messages that a process did not take, or could not send."""


class LiveScale(NamedTuple):
    """A fleet of `controllers`, live.

    adopted_s: from the start of its first process. home_s: enabling and homing of all axes, in one job.
    first_start_ms: from the submission to T0, of the first step over all. start_ms: likewise, the median of the last
    `COUNTED_STEPS`; done_s: their median from the submission to the report; start_skew_ms: the largest upper bound of
    their skews, by the evidence.
    jobs: on controllers of their own; jobs_submitted_s: until all are accepted; jobs_done_s: until all have ended, of
    which jobs_failed were not done.
    latched_s: from the put of an e-stop until all report it; reset_s: from the reset until all are released.
    coordinator_cpu_ms, host_cpu_ms: at rest, ms of processor time a second and controller; router_cpu_ms: a second.
    coordinator_mb, host_mb, router_mb: resident; of a host, its largest process, the mean of all hosts.
    refusals: of commands, by the coordinator or controllers, and submissions without an answer in time, which are
    repeated. losses: lines of logs that say that messages are missing."""

    controllers: int
    hosts: int
    adopted_s: float
    home_s: float
    first_start_ms: float
    start_ms: float
    done_s: float
    start_skew_ms: float
    jobs: int
    jobs_submitted_s: float
    jobs_done_s: float
    jobs_failed: int
    latched_s: float
    reset_s: float
    coordinator_cpu_ms: float
    host_cpu_ms: float
    router_cpu_ms: float
    coordinator_mb: float
    host_mb: float
    router_mb: float
    refusals: int
    alarms: int
    losses: int

    @property
    def has_failed(self) -> bool:
        """Whether anything has failed, was refused, alarmed or lost."""
        return bool(self.jobs_failed or self.refusals or self.alarms or self.losses)


async def bench_scale_live(state: Path, controllers: int, hosts: int, say: Callable[[str], None]) -> LiveScale:
    """Measure a fleet once. Raises `UpFailed`, `Refusal`, `NothingHappened`; then too its processes have ended."""
    fleet = make_light_fleet(controllers, hosts)
    own_losses = _LossLog()
    logging.getLogger("orchestrator.bus").addHandler(own_losses)
    began_ns = raw_ns()
    say(f"{controllers} controllers on {hosts} hosts start")
    try:
        async with run_measured_fleet(fleet, state, timeout_s=LIMIT_S) as (live, tutti):
            adopted_s = _measure_s(began_ns)
            rig = _ScaleRig(live, tutti, await find_origin_host_ns(tutti), say)
            home_s = await rig.home()
            usage = await rig.measure_rest()
            steps = await rig.run_steps(LEARNING_STEPS + COUNTED_STEPS)
            counted_steps = steps[-COUNTED_STEPS:]
            jobs = min(controllers, MANY_JOBS if controllers >= MANY_CONTROLLERS else JOBS)
            submitted_s, jobs_done_s, jobs_failed = await rig.run_jobs(jobs)
            latched_s, reset_s = await rig.run_estop()
            return LiveScale(
                controllers=controllers,
                hosts=len(fleet.hosts),
                adopted_s=adopted_s,
                home_s=home_s,
                first_start_ms=steps[0].start_ms,
                start_ms=median(step.start_ms for step in counted_steps),
                done_s=median(step.done_s for step in counted_steps),
                start_skew_ms=max(step.skew_ms for step in counted_steps),
                jobs=jobs,
                jobs_submitted_s=submitted_s,
                jobs_done_s=jobs_done_s,
                jobs_failed=jobs_failed,
                latched_s=latched_s,
                reset_s=reset_s,
                **usage,
                refusals=rig.refusals + await rig.count_refused_commands(),
                alarms=await rig.count_alarms(),
                losses=_count_losses(state / "log") + own_losses.count,
            )
    finally:
        logging.getLogger("orchestrator.bus").removeHandler(own_losses)


class _LossLog(logging.Handler):
    """Counts what the client's bus has left out."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += _states_loss(record.getMessage())


class _MeasuredStep(NamedTuple):
    """A step over all axes, see `LiveScale`."""

    start_ms: float
    done_s: float
    skew_ms: float


class _ScaleRig:
    """The running fleet. origin_ns: this computer's instant of fleet time 0."""

    def __init__(self, live: LiveFleet, tutti: Tutti, origin_ns: int, say: Callable[[str], None]) -> None:
        self._live = live
        self._tutti = tutti
        self._origin_ns = origin_ns
        self._say = say
        self.refusals = 0

    async def home(self) -> float:
        """Enable and home all; return the duration, s."""
        names = list(self._live.fleet.controllers)
        self._say("enable and home all")
        began_ns = raw_ns()
        job = await self._submit([{"do": "enable", "axes": names}, {"do": "home", "axes": ["hall"]}])
        _require_done(await job.result())
        return _measure_s(began_ns)

    async def measure_rest(self) -> dict[str, float]:
        """What the processes use at rest: the fields of `LiveScale`."""
        self._say(f"at rest for {REST_S} s")
        await asyncio.sleep(1)
        began_ns, begin_s = raw_ns(), self._read_cpu_s()
        await asyncio.sleep(REST_S)
        end_s, took_s = self._read_cpu_s(), _measure_s(began_ns)
        used_ms = {part: (end_s[part] - begin_s[part]) / took_s * 1e3 for part in end_s}
        controllers = len(self._live.fleet.controllers)
        hosts = [max(map(read_resident_bytes, iterate_tree(pid))) for pid in self._list_pids("host")]
        return {
            "coordinator_cpu_ms": used_ms["coordinator"] / controllers,
            "host_cpu_ms": used_ms["host"] / controllers,
            "router_cpu_ms": used_ms["router"],
            "coordinator_mb": read_resident_bytes(*self._list_pids("coordinator")) / 1e6,
            "host_mb": sum(hosts) / len(hosts) / 1e6,
            "router_mb": read_resident_bytes(*self._list_pids("router")) / 1e6,
        }

    async def run_steps(self, count: int) -> list[_MeasuredStep]:
        """Move all axes to and fro, by one job a step."""
        self._say(f"{count} steps over all")
        return [await self._run_step(number) for number in range(count)]

    async def _run_step(self, number: int) -> _MeasuredStep:
        asked_ns = raw_ns()
        job = await self._submit([_make_move(self._live.fleet.axis_names, number)])
        report = _require_done(await job.result())
        step = report.steps[0]
        assert step.t0_fleet_ns is not None and step.start_skew is not None
        return _MeasuredStep(
            start_ms=(step.t0_fleet_ns + self._origin_ns - asked_ns) / NS_PER_MS,
            done_s=_measure_s(asked_ns),
            skew_ms=step.start_skew.at_most_ns / NS_PER_MS,
        )

    async def run_jobs(self, count: int) -> tuple[float, float, int]:
        """Run so many jobs at once, each on controllers of its own; return when all were accepted and had ended, s, and
        how many were not done."""
        self._say(f"{count} jobs at once")
        axes: list[list[str]] = [[] for _ in range(count)]
        for number, controller in enumerate(self._live.fleet.controllers):
            axes[number % count] += [f"{controller}.{axis}" for axis in self._live.fleet.controllers[controller].axes]
        began_ns = raw_ns()
        jobs = await asyncio.gather(*(self._submit([_make_move(own_axes, 0)]) for own_axes in axes))
        submitted_s = _measure_s(began_ns)
        reports = await asyncio.gather(*(job.result() for job in jobs))
        done_s = _measure_s(began_ns)
        failures = Counter(report.reason[:MAX_REASON] for report in reports if report.state != "done")
        for reason, number in failures.items():
            self._say(f"{number} of the jobs not done: {reason}")
        return submitted_s, done_s, failures.total()

    async def run_estop(self) -> tuple[float, float]:
        """Stop all in a long move by an e-stop, and reset it; return how long each took to be reported by all, s."""
        self._say("e-stop and reset")
        job = await self._submit([{**_make_move(self._live.fleet.axis_names, 0), "speed": SLOW}])
        async for event in job.events():
            if event.state == "running":
                break
            if event.state in FINISHED_STATES:
                raise NothingHappened(f"the job to be stopped is {event.state}: {event.reason}")
        await asyncio.sleep(MOVING_S)
        put_ns = raw_ns()
        latches = await self._tutti.estop("benchmark", LIMIT_S)
        latched_s = _measure_s(put_ns)
        if not all(latches.values()) or len(latches) < len(self._live.fleet.controllers):
            raise NothingHappened(f"not within {LIMIT_S:g} s: all controllers report the e-stop")
        await job.result()
        reset_ns = raw_ns()
        self.refusals += sum(refusal is not None for refusal in (await self._tutti.reset()).values())

        async def all_released() -> bool:
            states = (await self._tutti.status()).values()
            return len(states) == len(latches) and all(state.estop is None for state in states)

        await wait_until(all_released, "the e-stop is reset", LIMIT_S)
        return latched_s, _measure_s(reset_ns)

    async def count_refused_commands(self) -> int:
        """How many commands the coordinator has refused."""
        return sum(bool(command.refused) for command in await self._tutti.list_commands(MAX_LISTED))

    async def count_alarms(self) -> int:
        """How many alarms there were but that of the e-stop."""
        return sum(alarm.count for alarm in await self._tutti.list_alarm_history(MAX_LISTED) if alarm.kind != "estop")

    async def _submit(self, steps: Steps) -> SubmittedJob:
        plain = {"schema": "tutti.job/1", "name": "scale", "max_start_skew": "200 ms", "steps": steps}
        job, client_key = Job.model_validate(plain), self._tutti.new_id()
        for _ in range(MAX_SUBMISSIONS):
            try:
                return await self._tutti.submit(job, client_key)
            except Refusal as refusal:
                if refusal.code != "no-answer":
                    raise
                self.refusals += 1
        raise NothingHappened(f"no answer to {MAX_SUBMISSIONS} submissions of a job")

    def _list_pids(self, part: str) -> list[int]:
        return [child.pid for child in self._live.children.values() if child.part == part]

    def _read_cpu_s(self) -> dict[str, float]:
        """The processor time of each part, s."""
        return {
            part: sum(read_cpu_s(pid) for root in self._list_pids(part) for pid in iterate_tree(root))
            for part in ("coordinator", "host", "router")
        }


def _make_move(axes: Sequence[str], number: int) -> dict[str, object]:
    return {"do": "move", "by": dict.fromkeys(axes, -DISTANCE if number % 2 else DISTANCE)}


def _require_done(report: JobReport) -> JobReport:
    if report.state != "done":
        raise NothingHappened(f"the benchmark's job is {report.state}: {report.reason[:MAX_REASON]}")
    return report


def _measure_s(begin_ns: int) -> float:
    return (raw_ns() - begin_ns) / NS_PER_S


def _states_loss(line: str) -> bool:
    return any(words in line for words in LOSSES)


def _count_losses(folder: Path) -> int:
    """How many lines of the logs of all processes say that messages are missing."""
    lines = (line for path in folder.iterdir() for line in path.read_text(encoding="utf-8").splitlines())
    return sum(map(_states_loss, lines))
