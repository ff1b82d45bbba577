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

from orchestrator.bench.fleet import Steps, measured_fleet, run_steps, until
from orchestrator.bench.spread import Noise, Spread, spread
from orchestrator.bench.sync_fleets import shrc203, smc2000, smc4000
from orchestrator.bench.truth import NothingHappened, Truth
from orchestrator.client import Job, SubmittedJob, Tutti
from orchestrator.clock.live import raw_ns
from orchestrator.clock.realtime import Urgency, calm, hurry
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import FINISHED_STATES
from orchestrator.runtime.live import LiveFleet

CONTROLLERS = 16
P99_MS, SHELL_MAX_MS = 20.0, 500.0
MIDDLE, DISTANCE, SPEED = 50.0, 40.0, 0.02  # mm; a step of some ten seconds, of which only a small part is executed
MOVING_S = (0.1, 0.4)  # from the first motion to the e-stop
SHELLS = 5
SPOILT = 20  # rounds to be repeated; more of them indicate another problem
SERIAL = ("b", "c")
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
    last: Spread
    uploading: Spread
    first: Spread
    shell: Spread
    smc2000_19200: Spread
    shrc203_38400: Spread
    noise: Spread
    spoilt: int


def estop_fleet() -> Fleet:
    """Return a fleet in which half of the controllers plan trapezoids, the other half contours; plus one of each
    serial make."""
    controllers: dict[str, dict[str, Any]] = {}
    for k in range(CONTROLLERS):
        plain = smc4000(k)
        axis = plain["axes"]["x"]
        jerk = {"jerk": 20_000.0} if k % 2 else {}
        controllers[f"a{k}"] = {**plain, "inputs": {}, "axes": {"x": {**axis, "limits": {**axis["limits"], **jerk}}}}
    for name, make in (("b", smc2000), ("c", shrc203)):
        plain = make(0)
        controllers[name] = {**plain, "inputs": {}, "link": {**plain["link"], "device": f"/dev/{name}"}}
    groups = {"all": [f"{name}.x" for name in controllers]}
    return Fleet.model_validate(
        {"schema": "tutti.fleet/1", "fleet": "estop", "controllers": controllers, "groups": groups}
    )


async def bench_estop(state: Path, rounds: int, command: Sequence[str]) -> EstopFigures:
    """Run `rounds` e-stops. command: the shell command of `tutti`. Raises `UpFailed`, `Refusal`, `NothingHappened`."""
    hurry(Urgency.BUS)  # because it represents a client on a machine of its own
    fleet, draw = estop_fleet(), Random(SEED)
    axes = fleet.axis_names
    async with measured_fleet(fleet, state) as (live, tutti), Noise() as noise:
        rig = _Rig(live, tutti, draw)
        await run_steps(tutti, [{"do": "enable", "axes": ["all"]}, {"do": "home", "axes": ["all"]}])
        # A few at a time: no current machine runs contours on sixteen simulators as punctually as the hardware.
        await run_steps(tutti, [{"do": "move", "to": dict.fromkeys(axes[k::4], MIDDLE / 4)} for k in range(4)])
        tcp: list[list[int]] = []
        uploading: list[int] = []
        serial: dict[str, list[int]] = {name: [] for name in SERIAL}
        for k in range(rounds):
            slowing = await rig.round(arming=k % 2 == 1, serial=k % SERIAL_EVERY == 0)
            of_tcp = [ns for name, ns in slowing.items() if name not in serial]
            tcp.append(of_tcp)
            if k % 2:
                uploading.append(max(of_tcp))
            for name in serial.keys() & slowing.keys():
                serial[name].append(slowing[name])
        shells = [await rig.round(arming=False, serial=True, command=command) for _ in range(SHELLS)]
        return EstopFigures(
            controllers=len(fleet.controllers),
            last=spread([max(each) for each in tcp], p99_ms=P99_MS),
            uploading=spread(uploading, p99_ms=P99_MS),
            first=spread([min(each) for each in tcp]),
            shell=spread([max(each.values()) for each in shells], max_ms=SHELL_MAX_MS),
            smc2000_19200=spread(serial["b"]),
            shrc203_38400=spread(serial["c"]),
            noise=noise.spread(),
            spoilt=rig.spoilt,
        )


class _Rig:
    """The running fleet."""

    def __init__(self, live: LiveFleet, tutti: Tutti, draw: Random) -> None:
        self._live = live
        self._tutti = tutti
        self._draw = draw
        self._truths = {name: Truth(live.state / "truth" / f"{name}.jsonl") for name in live.fleet.controllers}
        on_tcp = [name for name in live.fleet.controllers if name not in SERIAL]
        self._movers, self._others = on_tcp[::2], on_tcp[1::2]
        self._way = DISTANCE / 4
        self.spoilt = 0

    async def round(self, arming: bool, serial: bool, command: Sequence[str] = ()) -> dict[str, int]:
        """Run one e-stop; return the time to deceleration by moving controller, ns. The fleet is ready again
        afterwards."""
        while True:
            if serial:
                await self._to_the_middle()
            self._way = -self._way
            movers = [*self._movers, *SERIAL] if serial else self._movers
            jobs: list[SubmittedJob] = []
            try:
                await self._move(movers, arming, jobs)
            except NothingHappened:
                # A delay led to a refusal or a stop: the measured situation did not occur.
                self.spoilt += 1
                if self.spoilt > SPOILT:
                    raise
                await self._tutti.estop("benchmark")
                await self._recover(jobs)
            else:
                return await self._stop(movers, jobs, command)

    async def _move(self, movers: Sequence[str], arming: bool, jobs: list[SubmittedJob]) -> None:
        """Move `movers`, and arm the others if requested; the submitted jobs are appended to `jobs`."""
        began_ns = raw_ns()
        jobs.append(await self._submit(movers, SPEED))
        await self._reach(jobs[0], "running")
        await asyncio.gather(*(self._truths[name].after("start", began_ns) for name in movers))
        if arming:
            jobs.append(await self._submit(self._others, SPEED))
            await self._reach(jobs[1], "arming")
        else:
            await asyncio.sleep(self._draw.uniform(*MOVING_S))

    async def _stop(
        self, movers: Sequence[str], jobs: Sequence[SubmittedJob], command: Sequence[str]
    ) -> dict[str, int]:
        put_ns = raw_ns()
        shell: subprocess.Popen[bytes] | None = None
        if command:
            shell = subprocess.Popen(
                [*command, "estop", "--connect", self._live.connect],
                stdout=subprocess.DEVNULL,
                preexec_fn=calm,
            )
        else:
            await self._tutti.estop("benchmark", timeout_s=0.0)
        slowing = await asyncio.gather(*(self._truths[name].after("slowing", put_ns) for name in movers))
        if shell is not None:
            # The command checks whether all controllers are latched.
            await asyncio.to_thread(shell.wait)
        await self._recover(jobs)
        return {name: ns - put_ns for name, ns in zip(movers, slowing, strict=True)}

    async def _submit(self, names: Sequence[str], speed: float) -> SubmittedJob:
        step = {"do": "move", "by": {f"{name}.x": self._way for name in names}, "speed": speed}
        plain = {"schema": "tutti.job/1", "name": "estop", "max_start_skew": "200 ms", "max_end_skew": "5 s"}
        return await self._tutti.submit(Job.model_validate({**plain, "steps": [step]}))

    async def _reach(self, job: SubmittedJob, state: str) -> None:
        async for event in job.events():
            if event.state == state:
                return
            if event.state in FINISHED_STATES:
                raise NothingHappened(f"the job to be stopped is {event.state}: {event.reason}")

    async def _recover(self, jobs: Sequence[SubmittedJob]) -> None:
        """Reset the latch, and switch the motors on."""
        for job in jobs:
            await job.result()

        async def latched() -> bool:
            return all(each.estop is not None for each in (await self._tutti.status()).values())

        await until(latched, "all are latched")

        async def released() -> bool:
            await self._tutti.reset()
            return all(each.estop is None and each.mode == "idle" for each in (await self._tutti.status()).values())

        await until(released, "the e-stop is reset")
        await run_steps(self._tutti, [{"do": "enable", "axes": ["all"]}])

    async def _to_the_middle(self) -> None:
        middle = {f"{name}.x": MIDDLE / 4 for name in [*self._movers, *SERIAL]}
        states = await self._tutti.status()
        # A stepper that was stopped at once loses its reference.
        lost = [f"{name}.x" for name, each in states.items() if not each.axes["x"].referenced]
        home: Steps = [{"do": "home", "axes": [axis]} for axis in lost]
        back: dict[str, object] = {"do": "move", "to": middle, "sync": "none", "max_start_skew": "500 ms"}
        await run_steps(self._tutti, [*home, back])
