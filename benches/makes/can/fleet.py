"""Eight simulated CiA 402 drives on one CAN bus at 1 Mbit/s, each with its driver, in virtual time.

Each drive has its own crystal, phase of the control loop and firmware delays; each timed write is late by the
wake-up delay of a process.
"""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from random import Random
from typing import Any

from adapters.contract import Driver
from benches.makes.drivers import connect_wire, make_drivers
from benches.makes.figures import BenchFigure, make_figure
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.virtual import VirtualClock
from orchestrator.link.can import CanFrame, CanLink
from orchestrator.link.memory import MemoryWire, can_wire
from orchestrator.model.fleet import Controller
from sim.cia402 import CIA402
from sim.cia402.unit import CanSegment
from sim.core.controller import DeviceSpec, FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator

MAKE = "cia402"
BITRATE = 1_000_000
NODES = range(1, 9)
CRYSTAL_PPM = 100.0
MEASURED_OPTIONS = {"cycle_us": 100, "start_us": 50, "start_spread_us": 50}
"""Measured properties of these drives."""
VELOCITY, ACCELERATION = 80_000.0, 400_000.0
_STATE_OPTIONS = (0x180, 0x280, 0x380, 0x480, 0x700, 0x080)  # sent by the drives without a request


def make_can_row(what: str, values: list[float], unit: str, target: float | None = None) -> BenchFigure:
    """Make a row of figures; asked: target for the 99th percentile."""
    if target is None:
        return make_figure(what, values, unit)
    return make_figure(what, values, unit, f"p99<={target:g}", lambda figure: figure.p99 <= target)


@dataclass(slots=True)
class CanBusBench:
    """The bus, its drives and their drivers."""

    clock: VirtualClock
    segment: CanSegment
    drives: list[SimulatedController]
    drivers: list[Driver]
    wire: MemoryWire
    draw: Random
    command_ns: int = 0
    """Total transmission time of frames that were sent because of a command."""

    def count_frame(self, frame: CanFrame, begin_ns: int, end_ns: int) -> None:
        if frame.id & ~0x7F not in _STATE_OPTIONS:
            self.command_ns += end_ns - begin_ns

    def find_starts(self) -> list[int]:
        return [unit.commanded_motions[-1].start_ns for unit in self.drives]

    async def wait_until_ready(self) -> None:
        await asyncio.gather(*(driver.connect() for driver in self.drivers))
        await asyncio.gather(*(driver.configure() for driver in self.drivers))
        await asyncio.gather(*(driver.set_enabled(["a"], on=True) for driver in self.drivers))

    async def close_drivers(self) -> None:
        for driver in self.drivers:
            await driver.close()


def make_can_bench(
    clock: VirtualClock, seed: int, limits: Mapping[str, float] | None = None, simulate: Mapping[str, Any] | None = None
) -> CanBusBench:
    """Build the environment. limits: more limits of the axes, such as `jerk`. simulate: more options of the
    simulated drives."""
    draw = Random(seed)

    def make_device(node: int) -> DeviceSpec:
        crystal = Oscillator(draw.randrange(10**9), draw.uniform(-CRYSTAL_PPM, CRYSTAL_PPM))
        options = {"bitrate": BITRATE, **(simulate or {})}
        return DeviceSpec(
            node, options, crystal, FirmwareTiming(300 * NS_PER_US, 400 * NS_PER_US), draw.randrange(10**9)
        )

    segment, units = CIA402.build_shared(clock, [make_device(node) for node in NODES])
    wire = connect_wire(clock, can_wire(), segment, "can", seed)
    drivers = make_drivers(wire, {f"d{node}": _make_config(node, limits or {}) for node in NODES}, draw)
    world = CanBusBench(clock=clock, segment=segment, drives=list(units), drivers=drivers, wire=wire, draw=draw)
    segment.bus.add_listener(world.count_frame)
    return world


def _make_config(node: int, limits: Mapping[str, float]) -> Controller:
    most = {"velocity": VELOCITY, "acceleration": ACCELERATION, **limits}
    link = {"kind": "can", "interface": "socketcan", "channel": "can0", "bitrate": BITRATE, "address": node}
    axis = {"motors": ["1"], "unit": "counts", "limits": most}
    return Controller.model_validate({"adapter": MAKE, "link": link, "options": MEASURED_OPTIONS, "axes": {"a": axis}})


async def write_object(can: CanLink, node: int, entry: tuple[int, int], value: int, size: int) -> None:
    """Write an entry (index, subindex) by SDO, as a script does. size: bytes."""
    index, sub = entry
    address = index.to_bytes(2, "little") + bytes([sub])
    can.send_frames(CanFrame(0x600 + node, bytes([0x23 | (4 - size) << 2]) + address + value.to_bytes(4, "little")))
    while True:
        frame = (await can.read_frame()).frame
        if frame.id == 0x580 + node and frame.data[1:4] == address:
            if frame.data[0] != 0x60:
                raise RuntimeError(f"a write of the benchmark was refused: {frame}")
            return
