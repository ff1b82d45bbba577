"""The time from the submission of a job to the first motion: 16 controllers of four axes on TCP, live and in virtual
time.

Each round submits one step over all 64 axes. The first rounds are not counted: in them the coordinator learns the
arming times of this fleet. The parts come from the journal's transitions; the first motion from the simulators.
"""

import asyncio
import os
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from adapters.yaskawa.common.gate import GateTiming
from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.bench.fleet import Steps, run_measured_fleet, run_steps
from orchestrator.bench.processes import iterate_tree, read_cpu_s
from orchestrator.bench.spread import DurationSpread, WakeUpNoise, make_spread
from orchestrator.bench.truth import NothingHappened, TruthLog
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.live import raw_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.motion.lead_time import KEPT_STEPS, KNOWN_AFTER
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport, JobTransition
from orchestrator.runtime.live.fleet import LiveFleet
from orchestrator.runtime.simulated_fleets import make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

CONTROLLERS = 16
AXES = {"x": "X", "y": "Y", "z": "Z", "w": "W"}
DISTANCE = 2.0  # mm
P99_MS = 300.0
LEAD_MS = 100.0
PARTS = {
    "accept": ("", "queued"),
    "plan": ("queued", "arming"),
    "arm": ("arming", "armed"),
    "release": ("armed", "running"),
}
"""Parts by name, with the transitions at their begin and end; the client waits for "accepted"."""


class DispatchFigures(NamedTuple):
    """The figures of all rounds.

    first_motion: of any axis, after the submission.
    lead: from the instant that T0 was settled, after all members had armed and promised, to T0.
    armed_to_t0: from the beginning of the arming to T0.
    virtual_ms, virtual_path_ms: first motion in virtual time, and the time that links and firmware need of it: to
    the last reply to `go`, and from there the samples before a start in which an SMC-4000 accepts no release any
    more.
    simulators_cpu: the simulators' share of the processor time of all processes."""

    controllers: int
    first_motion: DurationSpread
    lead: DurationSpread
    armed_to_t0: DurationSpread
    parts: dict[str, DurationSpread]
    virtual_ms: float
    virtual_lead_ms: float
    virtual_path_ms: float
    simulators_cpu: float
    noise: DurationSpread


class _DispatchRound(NamedTuple):
    """One round, ns: from the submission to the first motion; from the settling of T0, and from the arming, to T0;
    each part."""

    first_ns: int
    lead_ns: int
    armed_to_t0_ns: int
    parts: dict[str, int]


def make_dispatch_fleet(count: int = CONTROLLERS) -> Fleet:
    """Return a fleet of `count` SMC-4000 with four axes each."""
    controllers: dict[str, dict[str, Any]] = {}
    for k in range(count):
        plain = make_smc4000(k)
        axis = plain["axes"]["x"]
        options = {
            "axes": 4,
            "home_edge": dict.fromkeys(AXES.values(), -2000),
            "index_every": dict.fromkeys(AXES.values(), 200),
        }
        controllers[f"a{k}"] = {
            **plain,
            "inputs": {},
            "axes": {name: {**axis, "motors": [motor]} for name, motor in AXES.items()},
            "simulate": {**plain["simulate"], "options": options},
        }
    groups = {"everything": [f"{name}.{axis}" for name in controllers for axis in AXES]}
    return Fleet.model_validate(
        {"schema": "tutti.fleet/1", "fleet": "dispatch", "controllers": controllers, "groups": groups}
    )


async def bench_dispatch(state: Path, rounds: int) -> DispatchFigures:
    """Run `rounds` jobs live, and some in virtual time. Raises `UpFailed`, `Refusal`, `NothingHappened`."""
    fleet = make_dispatch_fleet()
    virtual = await asyncio.to_thread(lambda: run_virtual(lambda clock: _measure_virtual(fleet, clock)))
    results: list[_DispatchRound] = []
    async with run_measured_fleet(fleet, state) as (live, tutti), WakeUpNoise() as noise:
        await run_steps(tutti, _make_preparation(fleet))
        truths = [TruthLog(live.state / "truth" / f"{name}.jsonl") for name in fleet.controllers]
        used_s = _read_cpu_s(live)
        for k in range(KEPT_STEPS + 1 + rounds):
            asked_ns = raw_ns()
            job = await tutti.submit(_make_job(fleet, k % 2))
            accepted_ns = raw_ns() - asked_ns
            report = await tutti.wait_for_job(job, poll_s=0.1)
            if report.state != "done":
                raise NothingHappened(f"the benchmark's job is {report.state}: {report.reason}")
            first_ns = min(await asyncio.gather(*(truth.wait_for_event("start", asked_ns) for truth in truths)))
            parts = _measure_parts((await tutti.show_job(job)).transitions, accepted_ns)
            results.append(_DispatchRound(first_ns - asked_ns, *_measure_leads_ns(report), parts))
        sims_s, all_s = (end_s - begin_s for begin_s, end_s in zip(used_s, _read_cpu_s(live), strict=True))
    counted_rounds = results[KEPT_STEPS + 1 :]
    options = YaskawaOptions()
    release_ns = GateTiming.for_options(options).release_before * options.tick_ns
    return DispatchFigures(
        controllers=len(fleet.controllers),
        first_motion=make_spread([dispatch.first_ns for dispatch in counted_rounds], p99_ms=P99_MS),
        lead=make_spread([dispatch.lead_ns for dispatch in counted_rounds], max_ms=LEAD_MS),
        armed_to_t0=make_spread([dispatch.armed_to_t0_ns for dispatch in counted_rounds]),
        parts={name: make_spread([dispatch.parts[name] for dispatch in counted_rounds]) for name in PARTS},
        virtual_ms=round(virtual.first_ns / 1e6, 1),
        virtual_lead_ms=round(virtual.lead_ns / 1e6, 1),
        virtual_path_ms=round((sum(virtual.parts.values()) + release_ns) / 1e6, 1),
        simulators_cpu=round(sims_s / all_s, 2) if all_s else 0.0,
        noise=noise.make_spread(),
    )


async def _measure_virtual(fleet: Fleet, clock: VirtualClock) -> _DispatchRound:
    """Return the last of some rounds, when the fleet's times are learned; with the mean of the parts of all rounds,
    because a gate is checked only every few samples, and one round says little about that."""
    virtual = VirtualFleet(fleet, clock, 1, guardian=False)
    await virtual.start()
    tutti = virtual.make_client()
    await run_steps(tutti, _make_preparation(fleet))
    rounds: list[_DispatchRound] = []
    for k in range(KNOWN_AFTER + 1):
        await sleep_ns(clock, NS_PER_S)
        motion_counts = {name: len(controller.commanded_motions) for name, controller in virtual.controllers.items()}
        asked_ns = clock.now_ns()
        job = await tutti.submit(_make_job(fleet, k % 2))
        accepted_ns = clock.now_ns() - asked_ns
        report = await job.result()
        first_ns = min(
            controller.commanded_motions[motion_counts[name]].start_ns
            for name, controller in virtual.controllers.items()
        )
        parts = _measure_parts((await job.show()).transitions, accepted_ns)
        rounds.append(_DispatchRound(first_ns - asked_ns, *_measure_leads_ns(report), parts))
    means = {name: sum(dispatch.parts[name] for dispatch in rounds) // len(rounds) for name in PARTS}
    return rounds[-1]._replace(parts=means)


def _make_preparation(fleet: Fleet) -> Steps:
    return [{"do": "enable", "axes": list(fleet.controllers)}, {"do": "home", "axes": ["everything"]}]


def _make_job(fleet: Fleet, way: int) -> Job:
    steps = [{"do": "move", "by": dict.fromkeys(fleet.axis_names, -DISTANCE if way else DISTANCE)}]
    return Job.model_validate({"schema": "tutti.job/1", "name": "dispatch", "max_start_skew": "50 ms", "steps": steps})


def _measure_leads_ns(report: JobReport) -> tuple[int, int]:
    """Return T0 relative to its settling, and to the beginning of the arming."""
    step = report.steps[0]
    assert step.t0_fleet_ns is not None and step.settled_fleet_ns is not None and step.arming_fleet_ns is not None
    return step.t0_fleet_ns - step.settled_fleet_ns, step.t0_fleet_ns - step.arming_fleet_ns


def _measure_parts(transitions: list[JobTransition], accepted_ns: int) -> dict[str, int]:
    """Return the duration of each part; of a step that was armed twice, the last one."""
    at = {transition.state: datetime.fromisoformat(transition.utc) for transition in transitions}
    parts = {"accept": accepted_ns}
    for name, (first, last) in PARTS.items():
        if first:
            parts[name] = round((at[last] - at[first]).total_seconds() * 1e9)
    return parts


def _read_cpu_s(live: LiveFleet) -> tuple[float, float]:
    """Return the processor time of the simulators, and of all processes of the fleet and this one."""
    by_child = {name: sum(read_cpu_s(pid) for pid in iterate_tree(child.pid)) for name, child in live.children.items()}
    simulators = sum(value for name, value in by_child.items() if name.startswith("sim/"))
    own_times = os.times()
    return simulators, sum(by_child.values()) + own_times.user + own_times.system
