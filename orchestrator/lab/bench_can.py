"""Eight CiA 402 drives on one CAN bus at 1 Mbit/s: how far apart they begin, by the simulator's truth, and how long
arming them takes against the frames that it needs, in virtual time.

Two ways to begin: the controlword written to one after another by SDO as soon as the one before has answered, as a
script does; and by the adapter, whose set-points wait in the drives for one SYNC. Each drive has a crystal, a phase of
its control loop and times of its firmware of its own.
"""

import asyncio
from contextvars import copy_context
from dataclasses import dataclass
from math import ceil
from random import Random
from typing import Any, NamedTuple

from adapters.contract import Driver, Setup
from adapters.firing import LoopFirer
from adapters.host import find_make
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.virtual import run_virtual
from orchestrator.link.can import CanFrame, CanLink
from orchestrator.link.memory import MemoryWire, can_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartWay
from orchestrator.plan.step import AxisMove, plan_step
from sim.cia402 import CIA402
from sim.cia402.unit import CanSegment
from sim.core.controller import Branch, SimulatedController, Timing
from sim.core.oscillator import Oscillator

MAKE = "cia402"
BITRATE = 1_000_000
NODES = range(1, 9)
CRYSTAL_PPM = 100.0
WAKE_US = 60  # how late a process is woken that writes at an instant, at most
MEASURED = {"cycle_us": 100, "start_us": 50, "start_spread_us": 50}
"""What a person has measured of these drives."""
COUNTS, VELOCITY, ACCELERATION = 20_000, 80_000.0, 400_000.0
ASKED_SKEW_MS, ASKED_ARM = 0.15, 1.2
STARTS = 20  # of the same drives; from one to the next the ticks of their control loops drift apart
IDLE_NS = 1000 * NS_PER_MS
_STATE = (0x180, 0x280, 0x380, 0x480, 0x700, 0x080)  # what drives send unasked


class CanRow(NamedTuple):
    """A spread over `n` starts, in `unit`. asked: what it should keep, in words; met: whether it does."""

    what: str
    n: int
    p50: float
    p99: float
    max: float
    unit: str
    asked: str = ""
    met: bool | None = None


@dataclass(slots=True)
class _World:
    clock: Clock
    segment: CanSegment
    units: list[SimulatedController]
    drivers: list[Driver]
    wire: MemoryWire
    draw: Random
    ordered_ns: int = 0
    """How long frames that were sent because of an order have been on the bus."""

    def watch(self, frame: CanFrame, begin_ns: int, end_ns: int) -> None:
        if frame.id & ~0x7F not in _STATE:
            self.ordered_ns += end_ns - begin_ns

    def starts(self) -> list[int]:
        return [unit.motions[-1].start_ns for unit in self.units]


class _Round(NamedTuple):
    """One start. off_ms: the furthest motion from T0. moving, load: the part of the time that the bus was busy while
    all moved, and at rest."""

    skew_ms: float
    off_ms: float
    arm_ms: float
    frames_ms: float
    moving: float
    load: float


def bench_can(rounds: int, seed: int = 11) -> list[CanRow]:
    """`rounds` starts each way, with new drives and a new bus every `STARTS` of them."""
    by_script: list[float] = []
    found: list[_Round] = []
    for number in range(ceil(rounds / STARTS)):
        starts = min(STARTS, rounds - number * STARTS)
        by_script += run_virtual(lambda clock, s=seed + number, n=starts: _scripted(clock, s, n))
        found += run_virtual(lambda clock, s=seed + number, n=starts: _together(clock, s, n))
    return [
        _row("start skew, 6040h by SDO one after another", by_script, "ms"),
        _row("start skew, one SYNC", [each.skew_ms for each in found], "ms", ASKED_SKEW_MS),
        _row("distance of the furthest start from T0", [each.off_ms for each in found], "ms"),
        _row("arming all", [each.arm_ms for each in found], "ms"),
        _row("frames of arming on the bus", [each.frames_ms for each in found], "ms"),
        _row("arming against its frames", [each.arm_ms / each.frames_ms for each in found], "times", ASKED_ARM),
        _row("bus load by states, all moving", [100 * each.moving for each in found], "%"),
        _row("bus load by states, at rest", [100 * each.load for each in found], "%"),
    ]


def _row(what: str, values: list[float], unit: str, asked: float | None = None) -> CanRow:
    ordered = sorted(values)
    p50, p99 = (ordered[ceil(share * len(ordered)) - 1] for share in (0.5, 0.99))
    row = CanRow(what, len(ordered), round(p50, 4), round(p99, 4), round(ordered[-1], 4), unit)
    return row if asked is None else row._replace(asked=f"p99<={asked:g}", met=row.p99 <= asked)


def _build(clock: Clock, seed: int) -> _World:
    draw = Random(seed)

    def branch(node: int) -> Branch:
        crystal = Oscillator(draw.randrange(10**9), draw.uniform(-CRYSTAL_PPM, CRYSTAL_PPM))
        return Branch(
            node, {"bitrate": BITRATE}, crystal, Timing(300 * NS_PER_US, 400 * NS_PER_US), draw.randrange(10**9)
        )

    segment, units = CIA402.build_shared(clock, [branch(node) for node in NODES])
    wire = MemoryWire(clock, can_wire(), segment, "can", "bus", copy_context(), seed)
    make, shared = find_make(MAKE), dict[str, Any]()
    firer = LoopFirer(clock, lambda: draw.randrange(WAKE_US * NS_PER_US))
    drivers: list[Driver] = []
    for node in NODES:
        config = Controller.model_validate(_config(node))
        options = make.options.model_validate(config.options)
        drivers.append(make.driver(Setup(f"d{node}", config, options, clock, wire.open, firer, shared)))
    world = _World(clock, segment, list(units), drivers, wire, draw)
    segment.bus.watch(world.watch)
    return world


def _config(node: int) -> dict[str, Any]:
    axis = {"motors": ["1"], "unit": "counts", "limits": {"velocity": VELOCITY, "acceleration": ACCELERATION}}
    link = {"kind": "can", "interface": "socketcan", "channel": "can0", "bitrate": BITRATE, "unit": node}
    return {"adapter": MAKE, "link": link, "options": MEASURED, "axes": {"a": axis}}


async def _ready(world: _World) -> None:
    await asyncio.gather(*(driver.connect() for driver in world.drivers))
    await asyncio.gather(*(driver.configure() for driver in world.drivers))
    await asyncio.gather(*(driver.enable(["a"], True) for driver in world.drivers))


async def _together(clock: Clock, seed: int, starts: int) -> list[_Round]:
    """Steps of all eight by their drivers, as a coordinator has them made, to and fro. One more is made before, because
    it brings the drives into their mode."""
    world = _build(clock, seed)
    await _ready(world)
    busy_ns = world.segment.bus.busy_ns
    await sleep_ns(clock, IDLE_NS)
    load = (world.segment.bus.busy_ns - busy_ns) / IDLE_NS
    found = [await _step(world, *((COUNTS, 0) if number % 2 else (0, COUNTS))) for number in range(starts + 1)]
    for driver in world.drivers:
        await driver.close()
    return [each._replace(load=load) for each in found[1:]]


async def _step(world: _World, begin: int, end: int) -> _Round:
    profiles = dict(plan_step([AxisMove("a", begin, end, VELOCITY / 2, ACCELERATION / 2)]).profiles)
    clock, drivers = world.clock, world.drivers
    lowered = [driver.lower(profiles, StartWay(), None) for driver in drivers]
    lead_ns = max(each.costs.arm_ns + each.costs.disarm_ns for each in lowered)
    t0_ns = clock.now_ns() + lead_ns + 100 * NS_PER_MS + world.draw.randrange(10 * NS_PER_MS)
    began_ns, ordered_ns = clock.now_ns(), world.ordered_ns
    pairs = list(zip(drivers, lowered, strict=True))
    await asyncio.gather(*(driver.arm(each, t0_ns, None) for driver, each in pairs))
    arm_ms, frames_ms = (clock.now_ns() - began_ns) * 1e-6, (world.ordered_ns - ordered_ns) * 1e-6
    await asyncio.gather(*(driver.verify() for driver in drivers))
    await asyncio.gather(*(driver.go() for driver in drivers))
    spans = await asyncio.gather(*(driver.started() for driver in drivers))
    busy_ns, moving_ns = world.segment.bus.busy_ns, clock.now_ns()
    outcomes = await asyncio.gather(*(driver.outcome() for driver in drivers))
    moving = (world.segment.bus.busy_ns - busy_ns) / (clock.now_ns() - moving_ns)
    starts = world.starts()
    for span, began, outcome in zip(spans, starts, outcomes, strict=True):
        if outcome.state != "done" or not span["a"].earliest_ns <= began <= span["a"].latest_ns:
            raise RuntimeError(f"a start of the benchmark is not as its driver says: {outcome.reason or span}")
    off_ms = max(abs(each - t0_ns) for each in starts) * 1e-6
    return _Round((max(starts) - min(starts)) * 1e-6, off_ms, arm_ms, frames_ms, moving, 0.0)


async def _scripted(clock: Clock, seed: int, count: int) -> list[float]:
    """The skews when each drive gets its controlword by SDO, as soon as the one before has answered."""
    world = _build(clock, seed)
    await _ready(world)
    can = CanLink(await world.wire.open(), BITRATE)
    skews: list[float] = []
    for number in range(count):
        target = 0 if number % 2 else COUNTS
        for node in NODES:
            for index, value, size in ((0x6060, 1, 1), (0x6040, 0x0F, 2), (0x607A, target, 4), (0x6081, 40_000, 4)):
                await _written(can, node, index, 0, value, size)
        await sleep_ns(clock, 100 * NS_PER_MS)
        for node in NODES:
            await _written(can, node, 0x6040, 0, 0x1F, 2)
        await sleep_ns(clock, 1500 * NS_PER_MS)
        starts = world.starts()
        skews.append((max(starts) - min(starts)) * 1e-6)
    await can.close()
    for driver in world.drivers:
        await driver.close()
    return skews


async def _written(can: CanLink, node: int, index: int, sub: int, value: int, size: int) -> None:
    address = index.to_bytes(2, "little") + bytes([sub])
    can.send(CanFrame(0x600 + node, bytes([0x23 | (4 - size) << 2]) + address + value.to_bytes(4, "little")))
    while True:
        frame = (await can.read()).frame
        if frame.id == 0x580 + node and frame.data[1:4] == address:
            if frame.data[0] != 0x60:
                raise RuntimeError(f"a write of the benchmark was refused: {frame}")
            return
