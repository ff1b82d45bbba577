"""Seven SMC30 on one bus at 9,600 baud: the spread of their starts, by the simulator's ground truth, in virtual
time.

Three methods: E to one after another, each as soon as the previous one has replied; the drivers' start commands in
time slots, with the delay in the programs; and a trigger line that all wait for. Each controller has its own
crystal, firmware delays and phase of polling its inputs.
"""

import asyncio
from dataclasses import dataclass
from math import ceil
from random import Random
from typing import NamedTuple

from adapters.contract import Driver
from benches.makes.drivers import connect_wire, load_moves, make_drivers, release_moves
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, sleep_ns, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import Link
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions, TriggerWait
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import DeviceSpec, FirmwareTiming, SimulatedController, build_line
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

MAKE = "smc30"
BAUD = 9600
CONTROLLERS = range(1, 8)
SPREAD = 0.1  # of the firmware's delays around their typical values
CRYSTAL_PPM = 100.0
DECODE_US, LINE_MS, START_MS, FILTER_MS, POLL_MS = 1000, 1.0, 1.0, 0.16, 1.0
STEPS, VELOCITY, ACCELERATION = 400, 2000.0, 20_000.0
ASKED_SLOTS_MS, ASKED_LINE_MS = 12.0, 1.3
EDGE_NS = 20 * NS_PER_US  # largest distance of the trigger edge from T0
LINE_INPUT = 1


class BusRow(NamedTuple):
    """One method to start seven controllers: from the first motion to the last, in ms, over `n` starts. off: largest
    distance of a motion's start from T0, in ms; None without a T0."""

    way: str
    n: int
    p50_ms: float
    p99_ms: float
    max_ms: float
    off_ms: float | None
    asked: str = ""
    met: bool | None = None


@dataclass(slots=True)
class _Smc30Bus:
    clock: VirtualClock
    simulators: list[SimulatedController]
    drivers: list[Driver]
    wire: MemoryWire
    draw: Random
    at: int = 0

    def find_starts(self, before: int) -> list[int]:
        """Return the instant of the motion after the first `before`, of every controller."""
        return [unit.commanded_motions[before].start_ns for unit in self.simulators]


def bench_smc30_bus(rounds: int, seed: int = 11) -> list[BusRow]:
    """Measure `rounds` starts of each method, with new controllers and a new line every time."""
    one_by_one = [_run_start(seed + number, "E")[0] for number in range(rounds)]
    slots = [_run_start(seed + number, "slots") for number in range(rounds)]
    line = [_run_start(seed + number, "line") for number in range(rounds)]
    return [
        _make_row("E to one after another", [(skew, None) for skew in one_by_one], None),
        _make_row("slots, compensated", slots, ASKED_SLOTS_MS),
        _make_row("wired line", line, ASKED_LINE_MS),
    ]


def _make_row(
    way: str, found: "list[tuple[float, float]] | list[tuple[float, None]]", asked_ms: float | None
) -> BusRow:
    skews = sorted(skew for skew, _ in found)
    p50, p99 = (skews[ceil(share * len(skews)) - 1] for share in (0.5, 0.99))
    offs = [off for _, off in found if off is not None]
    row = BusRow(
        way=way, n=len(skews), p50_ms=round(p50, 3), p99_ms=round(p99, 3), max_ms=round(skews[-1], 3), off_ms=None
    )
    if offs:
        row = row._replace(off_ms=round(max(offs), 3))
    return row if asked_ms is None else row._replace(asked=f"p99<={asked_ms:g}", met=row.p99_ms <= asked_ms)


def _run_start(seed: int, way: str) -> tuple[float, float]:
    """Return the skew of one start, and the largest distance of a motion's start from T0, in ms."""

    async def measure(clock: VirtualClock) -> tuple[float, float]:
        bus = _build_bus(clock, seed)
        if way == "E":
            return await _one_by_one(bus), 0.0
        starts, t0_ns = await _start_together(bus, line=way == "line")
        return (max(starts) - min(starts)) * 1e-6, max(abs(start - t0_ns) for start in starts) * 1e-6

    return run_virtual(measure)


def _build_bus(clock: VirtualClock, seed: int) -> _Smc30Bus:
    draw = Random(seed)

    def draw_around(value: float) -> float:
        return value * draw.uniform(1 - SPREAD, 1 + SPREAD)

    def make_device(address: int) -> DeviceSpec:
        options = {
            "checksum": True,
            "line_ms": draw_around(LINE_MS),
            "start_latency_ms": draw_around(START_MS),
            "input_filter_ms": draw_around(FILTER_MS),
            "input_poll_ms": POLL_MS,
        }
        crystal = Oscillator(draw.randrange(10**9), draw.uniform(-CRYSTAL_PPM, CRYSTAL_PPM))
        least_us = DECODE_US * (1 - SPREAD)
        timing = FirmwareTiming(round(least_us * NS_PER_US), round(2 * SPREAD * DECODE_US * NS_PER_US))
        return DeviceSpec(address, options, crystal, timing, draw.randrange(10**9))

    line = build_line(find_simulator(MAKE), clock, {f"u{address}": make_device(address) for address in CONTROLLERS})
    wire = connect_wire(clock, serial_wire(BAUD), line.endpoint, "serial", seed)
    drivers = make_drivers(wire, {f"u{address}": _make_config(address) for address in CONTROLLERS}, draw)
    return _Smc30Bus(clock, [line.devices[f"u{address}"] for address in CONTROLLERS], drivers, wire, draw)


def _make_config(address: int) -> Controller:
    link = {"kind": "serial", "device": "/dev/ttyS0", "baud": BAUD, "data_bits": 7, "parity": "odd", "address": address}
    axis = {
        "motors": ["1"],
        "unit": "counts",
        "limits": {"velocity": VELOCITY, "acceleration": ACCELERATION},
        "start_rate": {"min": 100, "max": 400},
    }
    fields = {"adapter": MAKE, "link": link, "axes": {"a": axis}, "inputs": {"go": {"number": LINE_INPUT}}}
    return Controller.model_validate(fields)


async def _start_together(bus: _Smc30Bus, *, line: bool) -> tuple[list[int], int]:
    """Run one step of all seven through their drivers, armed in parallel, like a coordinator; return starts and T0."""
    for driver in bus.drivers:
        await driver.connect()
        await driver.configure()
        await driver.set_enabled(["a"], on=True)
    profiles = dict(plan_step([AxisMove("a", 0, STEPS, VELOCITY, ACCELERATION)]).profiles)
    start_options = (
        StartOptions(wait=TriggerWait(input="go", earliest_ns=-EDGE_NS, latest_ns=EDGE_NS))
        if line
        else StartOptions(start_class="host")
    )
    lowered_profiles = [driver.lower_profiles(profiles, start_options, None) for driver in bus.drivers]
    lead_ns = sum(lowering.costs.arm_ns for lowering in lowered_profiles) + max(
        lowering.costs.disarm_ns for lowering in lowered_profiles
    )
    t0_ns = bus.clock.now_ns() + lead_ns + 100 * NS_PER_MS + bus.draw.randrange(10 * NS_PER_MS)
    await load_moves(bus.drivers, lowered_profiles, t0_ns)
    await release_moves(bus.drivers)
    if line:
        await sleep_until_ns(bus.clock, t0_ns + bus.draw.randint(-EDGE_NS, EDGE_NS))
        for unit in bus.simulators:
            unit.set_input(LINE_INPUT, level=True)
    spans = await asyncio.gather(*(driver.slots.present.wait_for_start() for driver in bus.drivers))
    for driver, span, unit in zip(bus.drivers, spans, bus.simulators, strict=True):
        outcome, began_ns = await driver.slots.present.wait_for_end(), unit.commanded_motions[0].start_ns
        if outcome.state != "done" or not span["a"].earliest_ns <= began_ns <= span["a"].latest_ns:
            raise RuntimeError(f"a start of the benchmark differs from its driver's report: {outcome.reason or span}")
        await driver.close()
    return bus.find_starts(0), t0_ns


async def _one_by_one(bus: _Smc30Bus) -> float:
    """Send E to each, as soon as the previous one has replied, by a program with the same move."""
    link = await bus.wire.open_link()
    for address in CONTROLLERS:
        for text in ("PO", "S100", "T2000", "R99", f"G+{STEPS}", "PX"):
            await _send_line(link, address, text)
    for address in CONTROLLERS:
        await _send_line(link, address, "E")
    await sleep_ns(bus.clock, 500 * NS_PER_MS)
    await link.close()
    starts = bus.find_starts(0)
    return (max(starts) - min(starts)) * 1e-6


async def _send_line(link: Link, address: int, text: str) -> None:
    """Send a line with its checksum; return when its reply has arrived."""
    line = f"{address}{text}".encode()
    link.write(line + bytes((sum(line) % 128,)) + b"\r")
    answer = (await link.read()).data
    if answer != b"YY\r":
        raise RuntimeError(f"{address}{text} was answered {answer!r}")
