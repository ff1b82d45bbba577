"""The speed of simulated SMC-4000 in virtual time, all moving and polled by their adapters, or idle.

The fleet is complete: simulators, links, an adapter host, the bus, the coordinator. Moves are long, so that only the
steady state counts. The profile is taken in a separate window, because the profiler slows everything down.
"""

import cProfile
import time
from math import inf
from typing import NamedTuple

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.controller import SimulatedController

MOTORS = "XYZW"
POLL_HZ = 10.0
TRAVEL_MM = 350.0
SPEED = 0.005  # of 200 mm/s: six minutes of motion
SETTLING_S = 2.0
PARTS = {
    "simulators": ("/sim/",),
    "wires": ("/orchestrator/link/",),
    "adapters": ("/adapters/",),
    "bus": ("/orchestrator/bus/", "/orchestrator/model/", "/pydantic/", "/json/"),
    "coordinator": ("/orchestrator/coordinator/",),
    "loop": ("/orchestrator/clock/", "/asyncio/"),
}
"""Folder of the sources of each part; states are made for the bus, and read from it, by the model."""
OTHER = "other"


WINDOWS = 5  # of which the fastest counts: other load on the machine only slows it down


class SpeedWindow(NamedTuple):
    """fleet_s: time that passed in the fleet. cpu_s: processor time of this machine for it.

    speedup: factor relative to real time. controller_s: controller seconds per processor second.
    """

    fleet_s: float
    cpu_s: float
    speedup: float
    controller_s: float


class SimFigures(NamedTuple):
    """The figures of one fleet.

    idle: nothing moves.
    moving: all axes move, commanded by another host.
    step: they move in a step of a job, where adapters poll twice as often, and a program guards each controller;
    None when it was not requested.
    shares: of the processor's time while they move, for each part of Tutti, in percent.
    """

    controllers: int
    axes: int
    poll_hz: float
    idle: SpeedWindow
    moving: SpeedWindow
    step: SpeedWindow | None
    shares: dict[str, float]


def make_sim_fleet(count: int) -> Fleet:
    """Return `count` controllers of four axes, all on one adapter host."""
    axes = {
        motor.lower(): {
            "motors": [motor],
            "unit": "mm",
            "scale": 1000,
            "soft_limits": {"min": -10, "max": 400},
            "limits": {"velocity": 200, "acceleration": 1000},
            "homing": {"speed": 20},
        }
        for motor in MOTORS
    }
    controllers = {
        f"c{number}": {
            "adapter": "smc4000",
            "link": {"kind": "tcp", "host": "127.0.0.1", "port": number},
            "axes": axes,
            "state": {"moving_hz": POLL_HZ, "idle_hz": POLL_HZ},
            "simulate": {
                "options": {"home_edge": dict.fromkeys(MOTORS, -200), "index_every": dict.fromkeys(MOTORS, 2000)},
                "drift_ppm": number % 100 - 50,
            },
        }
        for number in range(1, count + 1)
    }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "bench", "controllers": controllers})


def bench_sim(controllers: int, seconds: float, *, step: bool = False, seed: int = 1) -> SimFigures:
    """Measure `controllers` of them, for `seconds` of fleet time each. Raises `RuntimeError` when a job fails.

    step: also in a step of a job; homing all axes first takes much longer than the rest.
    """
    fleet = make_sim_fleet(controllers)

    async def measure_fleet(clock: VirtualClock) -> SimFigures:
        virtual = VirtualFleet(fleet, clock, seed)
        await virtual.start()
        idle = await _measure_window(clock, controllers, seconds)
        await _start_motion(virtual)
        moving_window = await _measure_window(clock, controllers, seconds)
        shares = await _measure_shares(clock, seconds / WINDOWS)
        in_step = None
        if step:
            await _stop_motion(virtual)
            await _start_job(virtual)
            in_step = await _measure_window(clock, controllers, seconds)
        return SimFigures(
            controllers=controllers,
            axes=controllers * len(MOTORS),
            poll_hz=POLL_HZ,
            idle=idle,
            moving=moving_window,
            step=in_step,
            shares=shares,
        )

    return run_virtual(measure_fleet)


def _send_to_all(virtual: VirtualFleet, text: bytes) -> None:
    """Send a command of another host to all controllers, on a separate connection."""

    def send_to_controller(controller: SimulatedController) -> None:
        line = controller.connect("tcp", lambda reply: None, lambda: None)
        line.receive_bytes(text)

    for name in virtual.controllers:
        virtual.act_on_controller(name, send_to_controller)


async def _start_motion(virtual: VirtualFleet) -> None:
    _send_to_all(virtual, b"SH\rSP*=1000\rPR*=300000\rBG\r")
    await virtual.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))


async def _stop_motion(virtual: VirtualFleet) -> None:
    _send_to_all(virtual, b"ST\r")
    await virtual.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))


async def _start_job(virtual: VirtualFleet) -> None:
    """Bring all axes into one long move of a job. Raises `RuntimeError` when a job fails."""
    client, names = virtual.make_client(), list(virtual.fleet.controllers)
    prepare = Job.model_validate(
        {"schema": "tutti.job/1", "name": "prepare", "steps": [{"do": "enable", "axes": names}, {"do": "home"}]}
    )
    report = await client.wait_for_job(await client.submit(prepare), poll_s=60.0)
    if report.state != "done":
        raise RuntimeError(f"the benchmark's job is {report.state}: {report.reason}")
    move = {"do": "move", "to": dict.fromkeys(virtual.fleet.axis_names, TRAVEL_MM), "speed": SPEED}
    await client.submit(Job.model_validate({"schema": "tutti.job/1", "name": "long move", "steps": [move]}))
    await virtual.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))


async def _measure_window(clock: VirtualClock, controllers: int, seconds: float) -> SpeedWindow:
    await sleep_ns(clock, round(SETTLING_S * NS_PER_S))
    part_s = seconds / WINDOWS
    cpu_s = inf
    for _ in range(WINDOWS):
        began_s = time.process_time()
        await sleep_ns(clock, round(part_s * NS_PER_S))
        cpu_s = min(cpu_s, time.process_time() - began_s)
    speedup = part_s / max(cpu_s, 1e-9)
    return SpeedWindow(round(part_s, 3), round(cpu_s, 4), round(speedup, 2), round(speedup * controllers, 1))


async def _measure_shares(clock: VirtualClock, seconds: float) -> dict[str, float]:
    """Return the share of time spent in the sources of each part; built-in functions count for their callers."""
    profile = cProfile.Profile(builtins=False)
    profile.enable()
    await sleep_ns(clock, round(seconds * NS_PER_S))
    profile.disable()
    time_s = dict.fromkeys((*PARTS, OTHER), 0.0)
    for entry in profile.getstats():
        code = entry.code
        time_s[OTHER if isinstance(code, str) else _find_part(code.co_filename)] += entry.inlinetime
    total = sum(time_s.values()) or 1.0
    return {part: round(100 * share / total, 1) for part, share in time_s.items()}


def _find_part(source: str) -> str:
    return next((part for part, places in PARTS.items() if any(part_path in source for part_path in places)), OTHER)
