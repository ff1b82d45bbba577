"""The time from an e-stop's publication to the deceleration of the last axis, live: 16 controllers on TCP, two on
serial lines, and the shell command.

Half of the controllers move when it comes; in every other round the others are being armed with contours, so that
their links are busy with uploads. The serial ones take part only in some rounds: a stepper that was stopped at once
must be homed again. The times come from the simulators' own logs, on one kernel's clock.
"""

import asyncio
import subprocess
from collections.abc import Sequence
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from orchestrator.bench.fleet import Steps, run_measured_fleet, run_steps, wait_until
from orchestrator.bench.spread import DurationSpread, WakeUpNoise, make_spread
from orchestrator.bench.truth import NothingHappened, TruthLog
from orchestrator.client import SubmittedJob, Tutti
from orchestrator.clock.live import raw_ns
from orchestrator.clock.realtime import RealtimePriority, reset_priority, set_realtime_priority
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import FINISHED_STATES
from orchestrator.runtime.live.fleet import LiveFleet
from orchestrator.runtime.simulated_fleets import make_shrc203, make_smc2000, make_smc4000

CONTROLLERS = 16
P99_MS, SHELL_MAX_MS = 20.0, 500.0
MIDDLE, DISTANCE, SPEED = 50.0, 40.0, 0.02  # mm; a step of some ten seconds, of which only a small part is executed
MOVING_S = (0.1, 0.4)  # from the first motion to the e-stop
SHELL_ROUNDS = 5
MAX_REPEATED_ROUNDS = 20  # rounds to be repeated; more of them indicate another problem
SERIAL_CONTROLLERS = ("b", "c")
SERIAL_EVERY = 9  # rounds; odd, so that every other one is combined with uploads
SEED = 17


class EstopFigures(NamedTuple):
    """The figures of all rounds.

    last, first: publication → the last and the first axis on TCP decelerates.
    uploading: the last, in rounds in which others were being armed.
    shell: start of `tutti estop` → the last axis of all.
    smc2000_19200, shrc203_38400: publication → the axes on serial lines.
    spoilt: rounds that were repeated because their axes had not started."""

    controllers: int
    last: DurationSpread
    uploading: DurationSpread
    first: DurationSpread
    shell: DurationSpread
    smc2000_19200: DurationSpread
    shrc203_38400: DurationSpread
    noise: DurationSpread
    spoilt: int


def make_estop_fleet() -> Fleet:
    """Return a fleet in which half of the controllers plan trapezoids, the other half contours; plus one of each
    serial make."""
    controllers: dict[str, dict[str, Any]] = {}
    for k in range(CONTROLLERS):
        plain = make_smc4000(k)
        axis = plain["axes"]["x"]
        jerk = {"jerk": 20_000.0} if k % 2 else {}
        controllers[f"a{k}"] = {**plain, "inputs": {}, "axes": {"x": {**axis, "limits": {**axis["limits"], **jerk}}}}
    for name, make in (("b", make_smc2000), ("c", make_shrc203)):
        plain = make(0)
        controllers[name] = {**plain, "inputs": {}, "link": {**plain["link"], "device": f"/dev/{name}"}}
    groups = {"everything": [f"{name}.x" for name in controllers]}
    return Fleet.model_validate(
        {"schema": "tutti.fleet/1", "fleet": "estop", "controllers": controllers, "groups": groups}
    )


async def bench_estop(state: Path, rounds: int, command: Sequence[str]) -> EstopFigures:
    """Run `rounds` e-stops. command: the shell command of `tutti`. Raises `UpFailed`, `Refusal`, `NothingHappened`."""
    set_realtime_priority(RealtimePriority.BUS)  # because it represents a client on a machine of its own
    fleet, draw = make_estop_fleet(), Random(SEED)
    axes = fleet.axis_names
    async with run_measured_fleet(fleet, state) as (live, tutti), WakeUpNoise() as noise:
        rig = _EstopRig(live, tutti, draw)
        await run_steps(tutti, [{"do": "enable", "axes": ["everything"]}, {"do": "home", "axes": ["everything"]}])
        # A few at a time: no current machine runs contours on sixteen simulators as punctually as the hardware.
        await run_steps(tutti, [{"do": "move", "to": dict.fromkeys(axes[k::4], MIDDLE / 4)} for k in range(4)])
        tcp: list[list[int]] = []
        uploading: list[int] = []
        serial: dict[str, list[int]] = {name: [] for name in SERIAL_CONTROLLERS}
        for k in range(rounds):
            slowing = await rig.run_round(arming=k % 2 == 1, serial=k % SERIAL_EVERY == 0)
            of_tcp = [ns for name, ns in slowing.items() if name not in serial]
            tcp.append(of_tcp)
            if k % 2:
                uploading.append(max(of_tcp))
            for name in serial.keys() & slowing.keys():
                serial[name].append(slowing[name])
        shells = [await rig.run_round(arming=False, serial=True, command=command) for _ in range(SHELL_ROUNDS)]
        return EstopFigures(
            controllers=len(fleet.controllers),
            last=make_spread([max(delays) for delays in tcp], p99_ms=P99_MS),
            uploading=make_spread(uploading, p99_ms=P99_MS),
            first=make_spread([min(delays) for delays in tcp]),
            shell=make_spread([max(shell.values()) for shell in shells], max_ms=SHELL_MAX_MS),
            smc2000_19200=make_spread(serial["b"]),
            shrc203_38400=make_spread(serial["c"]),
            noise=noise.make_spread(),
            spoilt=rig.spoilt,
        )


class _EstopRig:
    """The running fleet."""

    def __init__(self, live: LiveFleet, tutti: Tutti, draw: Random) -> None:
        self._live = live
        self._tutti = tutti
        self._draw = draw
        self._truths = {name: TruthLog(live.state / "truth" / f"{name}.jsonl") for name in live.fleet.controllers}
        on_tcp = [name for name in live.fleet.controllers if name not in SERIAL_CONTROLLERS]
        self._movers, self._others = on_tcp[::2], on_tcp[1::2]
        self._way = DISTANCE / 4
        self.spoilt = 0

    async def run_round(self, command: Sequence[str] = (), *, arming: bool, serial: bool) -> dict[str, int]:
        """Run one e-stop; return the time to deceleration by moving controller, ns. The fleet is ready again
        afterwards."""
        while True:
            if serial:
                await self._move_to_middle()
            self._way = -self._way
            movers = [*self._movers, *SERIAL_CONTROLLERS] if serial else self._movers
            jobs: list[SubmittedJob] = []
            try:
                await self._start_moves(movers, arming=arming, jobs=jobs)
            except NothingHappened:
                # A delay led to a refusal or a stop: the measured situation did not occur.
                self.spoilt += 1
                if self.spoilt > MAX_REPEATED_ROUNDS:
                    raise
                await self._tutti.estop("benchmark")
                await self._reset_fleet(jobs)
            else:
                return await self._measure_stop(movers, jobs, command)

    async def _start_moves(self, movers: Sequence[str], jobs: list[SubmittedJob], *, arming: bool) -> None:
        """Move `movers`, and arm the others if requested; the submitted jobs are appended to `jobs`."""
        began_ns = raw_ns()
        jobs.append(await self._submit_move(movers, SPEED))
        await self._wait_for_state(jobs[0], "running")
        await asyncio.gather(*(self._truths[name].wait_for_event("start", began_ns) for name in movers))
        if arming:
            jobs.append(await self._submit_move(self._others, SPEED))
            await self._wait_for_state(jobs[1], "arming")
        else:
            await asyncio.sleep(self._draw.uniform(*MOVING_S))

    async def _measure_stop(
        self, movers: Sequence[str], jobs: Sequence[SubmittedJob], command: Sequence[str]
    ) -> dict[str, int]:
        put_ns = raw_ns()
        shell: subprocess.Popen[bytes] | None = None
        if command:
            shell = subprocess.Popen(
                [*command, "estop", "--connect", self._live.connect],
                stdout=subprocess.DEVNULL,
                preexec_fn=reset_priority,
            )
        else:
            await self._tutti.estop("benchmark", timeout_s=0.0)
        slowing = await asyncio.gather(*(self._truths[name].wait_for_event("slowing", put_ns) for name in movers))
        if shell is not None:
            # The command checks whether all controllers are latched.
            await asyncio.to_thread(shell.wait)
        await self._reset_fleet(jobs)
        return {name: ns - put_ns for name, ns in zip(movers, slowing, strict=True)}

    async def _submit_move(self, names: Sequence[str], speed: float) -> SubmittedJob:
        step = {"do": "move", "by": {f"{name}.x": self._way for name in names}, "speed": speed}
        plain = {"schema": "tutti.job/1", "name": "estop", "max_start_skew": "200 ms", "max_end_skew": "5 s"}
        return await self._tutti.submit(Job.model_validate({**plain, "steps": [step]}))

    async def _wait_for_state(self, job: SubmittedJob, state: str) -> None:
        async for event in job.events():
            if event.state == state:
                return
            if event.state in FINISHED_STATES:
                raise NothingHappened(f"the job to be stopped is {event.state}: {event.reason}")

    async def _reset_fleet(self, jobs: Sequence[SubmittedJob]) -> None:
        """Reset the latch, and switch the motors on."""
        for job in jobs:
            await job.result()

        async def all_latched() -> bool:
            return all(status.estop is not None for status in (await self._tutti.status()).values())

        await wait_until(all_latched, "all are latched")

        async def all_released() -> bool:
            await self._tutti.reset()
            return all(
                status.estop is None and status.mode == "idle" for status in (await self._tutti.status()).values()
            )

        await wait_until(all_released, "the e-stop is reset")
        await run_steps(self._tutti, [{"do": "enable", "axes": ["everything"]}])

    async def _move_to_middle(self) -> None:
        middle = {f"{name}.x": MIDDLE / 4 for name in [*self._movers, *SERIAL_CONTROLLERS]}
        states = await self._tutti.status()
        # A stepper that was stopped at once loses its reference.
        lost_axes = [f"{name}.x" for name, state in states.items() if not state.axes["x"].referenced]
        home: Steps = [{"do": "home", "axes": [axis]} for axis in lost_axes]
        return_step: dict[str, object] = {"do": "move", "to": middle, "sync": "none", "max_start_skew": "500 ms"}
        await run_steps(self._tutti, [*home, return_step])
