"""Fleets of light controllers in virtual time: what passes on the bus, what is written, and what it costs.

All processes of a fleet are one here, so that processor times are those of coordinator, hosts, controllers and medium
together. Counts are exact.
"""

import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from orchestrator.bus.memory.traffic import BusTraffic
from orchestrator.client.api import Tutti
from orchestrator.client.jobs import SubmittedJob
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.motion.lead_time import KNOWN_AFTER
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

SIZES = (10, 50, 200, 1000)
CONTROLLERS_PER_HOST = 50
LEARNING_STEPS = KNOWN_AFTER + 1
REST_S = 5
DISTANCE = 10.0  # mm
ESTOP_WITHIN_S = 0.25  # after the start of a step


class Load(NamedTuple):
    """What was counted in a span. Messages, bytes, wake-ups of the coordinator's loop, writes of the journal, tasks,
    and s of processor time."""

    messages: int
    size: int
    wakes: int
    writes: int
    tasks: int
    cpu_s: float


class ScaleRow(NamedTuple):
    """A fleet of `controllers`. First figures: at rest, a second; then of one step over all.

    messages, wakes, declared: a host; size (bytes), cpu_ms, tasks: a controller. start_ms: from the submission to T0,
    of the last step; first_start_ms: of the first step after a restart of the coordinator. estop_ms: from the put until
    the last controller slows down. skew_us: between the true starts of the controllers."""

    controllers: int
    hosts: int
    declared: float
    rest_messages: float
    rest_size: float
    rest_wakes: float
    rest_writes: int
    rest_tasks: float
    rest_cpu_ms: float
    step_messages: float
    step_size: float
    step_wakes: float
    step_writes: int
    step_tasks: float
    step_cpu_ms: float
    start_ms: float
    first_start_ms: float
    estop_ms: float
    skew_us: float


def measure_scale(
    controllers: Sequence[int], hosts: int | None, say: Callable[[str], None], learning: int = LEARNING_STEPS
) -> list[ScaleRow]:
    """Measure a row for each number of controllers. hosts: how many carry them; None: one for 50. learning: how many
    steps run before the one that is counted."""
    rows: list[ScaleRow] = []
    for count in controllers:
        say(f"{count} controllers in virtual time")
        host_count = hosts or -(-count // CONTROLLERS_PER_HOST)
        rows.append(
            run_virtual(lambda clock, count=count, host_count=host_count: _measure(clock, count, host_count, learning))
        )
    return rows


@dataclass(slots=True)
class _Subject:
    """The fleet that is measured, with its counts."""

    clock: VirtualClock
    virtual: VirtualFleet
    traffic: BusTraffic
    tutti: Tutti

    async def measure(self, act: Callable[[], Awaitable[None]]) -> Load:
        """Count while `act` runs."""
        self.traffic.clear()
        writes, tasks = self.virtual.journal_calls.writes, self.clock.loop.created_tasks
        begun_s = time.process_time()
        await act()
        took_s = time.process_time() - begun_s
        return Load(
            messages=sum(n for name, n in (self.traffic.sent + self.traffic.received).items() if _is_host(name)),
            size=sum(size for name, size in self.traffic.sent_bytes.items() if _is_host(name)),
            wakes=sum(n for name, n in self.traffic.wakes.items() if name.startswith("coordinator-")),
            writes=self.virtual.journal_calls.writes - writes,
            tasks=self.clock.loop.created_tasks - tasks,
            cpu_s=took_s,
        )

    async def run_step(self, way: int) -> tuple[JobReport, int]:
        """Move all axes there or back; return the report, and when it was submitted."""
        asked_ns = self.clock.now_ns()
        job = await self.submit([{"do": "move", "by": dict.fromkeys(self.virtual.fleet.axis_names, way * DISTANCE)}])
        return await job.result(), asked_ns

    async def submit(self, steps: list[dict[str, Any]]) -> SubmittedJob:
        """Submit a job."""
        plain = {"schema": "tutti.job/1", "name": "scale", "max_start_skew": "5 ms", "steps": steps}
        return await self.tutti.submit(Job.model_validate(plain))

    def find_start_ms(self, asked_ns: int) -> float:
        """From a submission to the first motion since then."""
        return (min(self.list_starts()) - asked_ns) / NS_PER_MS

    def list_starts(self) -> list[int]:
        """When each controller has begun its last motion."""
        return [controller.commanded_motions[-1].start_ns for controller in self.virtual.controllers.values()]


async def _measure(clock: VirtualClock, controllers: int, hosts: int, learning: int) -> ScaleRow:
    virtual = VirtualFleet(make_light_fleet(controllers, hosts), clock, 1, guardian=False)
    traffic = virtual.net.traffic = BusTraffic()
    await virtual.start()
    subject = _Subject(clock, virtual, traffic, virtual.make_client())
    names = list(virtual.fleet.controllers)
    await (await subject.submit([{"do": "enable", "axes": names}, {"do": "home", "axes": names}])).result()
    await sleep_ns(clock, NS_PER_S)
    declarations = sum(count for name, count in traffic.declared.items() if _is_host(name))
    idle = await subject.measure(lambda: sleep_ns(clock, REST_S * NS_PER_S))
    for step in range(learning):
        await subject.run_step(1 if step % 2 else -1)
    loads: list[Load] = []
    start_ms = 0.0

    async def run_once() -> None:
        nonlocal start_ms
        report, asked_ns = await subject.run_step(-1 if len(loads) % 2 else 1)
        assert report.state == "done", report.reason
        start_ms = subject.find_start_ms(asked_ns)

    for _ in range(3):
        await sleep_ns(clock, NS_PER_S)
        loads.append(await subject.measure(run_once))
    step = min(loads, key=lambda load: load.cpu_s)
    starts = subject.list_starts()
    estop_ms = await _measure_estop(subject)
    first_start_ms = await _measure_first_start(subject)
    return ScaleRow(
        controllers=controllers,
        hosts=hosts,
        declared=declarations / hosts,
        rest_messages=idle.messages / hosts / REST_S,
        rest_size=idle.size / controllers / REST_S,
        rest_wakes=idle.wakes / hosts / REST_S,
        rest_writes=idle.writes,
        rest_tasks=idle.tasks / controllers,
        rest_cpu_ms=idle.cpu_s / controllers / REST_S * 1e3,
        step_messages=step.messages / hosts,
        step_size=step.size / controllers,
        step_wakes=step.wakes / hosts,
        step_writes=step.writes,
        step_tasks=step.tasks / controllers,
        step_cpu_ms=step.cpu_s / controllers * 1e3,
        start_ms=start_ms,
        first_start_ms=first_start_ms,
        estop_ms=estop_ms,
        skew_us=(max(starts) - min(starts)) / 1e3,
    )


async def _measure_estop(subject: _Subject) -> float:
    """From the put of an e-stop in a step until the last controller slows down, ms; everything is reset behind it."""
    clock, tutti = subject.clock, subject.tutti
    job = await subject.submit([{"do": "move", "by": dict.fromkeys(subject.virtual.fleet.axis_names, 20 * DISTANCE)}])
    while not all(_moves(controller) for controller in subject.virtual.controllers.values()):
        await sleep_ns(clock, 10 * NS_PER_MS)
    put_ns = clock.now_ns()
    await tutti.estop("benchmark")
    await job.result()
    slowings_ns = [
        motion.slowing_ns or motion.end_ns or clock.now_ns()
        for controller in subject.virtual.controllers.values()
        for motion in controller.commanded_motions[-4:]
    ]
    await sleep_ns(clock, NS_PER_S)
    await tutti.reset()
    await sleep_ns(clock, NS_PER_S)
    names = list(subject.virtual.fleet.controllers)
    await tutti.start_queue()
    await (await subject.submit([{"do": "enable", "axes": names}])).result()
    return (max(slowings_ns) - put_ns) / NS_PER_MS


async def _measure_first_start(subject: _Subject) -> float:
    """The time from submission to T0 of the first step after a restart of the coordinator, ms."""
    virtual = subject.virtual
    virtual.kill("coordinator/first")
    await sleep_ns(subject.clock, NS_PER_S)
    virtual.start_coordinator("second")
    await virtual.wait_until(lambda states: all(state.epoch > 1 and state.mode == "idle" for state in states.values()))
    await subject.tutti.start_queue()
    report, asked_ns = await subject.run_step(-1)
    assert report.state == "done", report.reason
    return subject.find_start_ms(asked_ns)


def _moves(controller: Any) -> bool:
    return any(controller.is_moving(axis) for axis in controller.axis_names)


def _is_host(process: str) -> bool:
    return process.startswith("host-")
