"""The old ways of starting controllers together, as real baselines: bytes on simulated wires, nothing of Tutti between.

Moves are loaded by hand; then a chain gets its broadcast, or each controller its go.
"""

from collections.abc import Callable, Coroutine
from contextvars import copy_context
from dataclasses import dataclass
from random import Random
from typing import Any

from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.lab.sync_fleets import DRIFT_PPM, HOLD_MS, SPREAD_US, WANDER_PPM
from orchestrator.link.base import Link
from orchestrator.link.memory import LAN, MemoryWire, serial_wire
from sim.core.controller import Branch, Port, SimulatedController, Timing, build_line
from sim.core.oscillator import Oscillator
from sim.core.vectors import simulator

COUNT = 8
_LOAD = ("SHX", "SPX=50000", "ACX=500000", "DCX=500000", "PRX=20000")
_TIMING = Timing(500 * NS_PER_US, SPREAD_US * NS_PER_US)
_SETTLE_NS = 200 * NS_PER_MS
_HOLD_NS = round(HOLD_MS * NS_PER_MS)


@dataclass(frozen=True, slots=True)
class Baseline:
    """A row: fleet, way, and what runs one trial and gives its start skew in ns."""

    fleet: str
    way: str
    trial: Callable[[Clock, Random], Coroutine[Any, Any, int]]


def _crystal(draw: Random) -> Oscillator:
    return Oscillator(draw.randrange(10**11), draw.uniform(-DRIFT_PPM, DRIFT_PPM), WANDER_PPM, draw.randrange(2**31))


def _skew(units: list[SimulatedController]) -> int:
    starts = [unit.motions[-1].start_ns for unit in units]
    return max(starts) - min(starts)


async def _answered(link: Link, count: int) -> None:
    """Read until so many colons have come."""
    while count > 0:
        count -= (await link.read()).data.count(b":")


async def _broadcast(clock: Clock, draw: Random, shared: bool) -> int:
    """`!BG` to a daisy chain; with shared sample clock, `TM -1` in all units but the first (SMC-2000, L975)."""
    branches = {
        f"u{k}": Branch(k, {"axes": 2, "echo": False}, _crystal(draw), _TIMING, draw.randrange(2**31))
        for k in range(COUNT)
    }
    line = build_line(simulator("smc2000"), clock, branches)
    if shared:
        line.far.share_clock()  # type: ignore[attr-defined]  # of a chain
    link = await _wire(clock, line.far, "serial", draw, 19200).open()
    for k in range(COUNT):
        external = ("TM -1",) if shared and k else ()
        link.write("".join(f"{command}\r" for command in (f"%{k}", *external, *_LOAD)).encode())
        await sleep_ns(clock, _SETTLE_NS + draw.randrange(NS_PER_MS))
    link.write(b"!BGX\r")
    await sleep_ns(clock, _SETTLE_NS)
    await link.close()
    return _skew(list(line.units.values()))


async def _one_by_one(clock: Clock, draw: Random, model: str, waits: bool) -> int:
    """Each controller on a link of its own is told to go; waits: only when the one before has acknowledged."""
    units: list[SimulatedController] = []
    links: list[Link] = []
    for k in range(COUNT):
        branch = Branch(None, {"axes": 2}, _crystal(draw), _TIMING, draw.randrange(2**31))
        line = build_line(simulator(model), clock, {f"u{k}": branch})
        units += line.units.values()
        port = "tcp" if model == "smc4000" else "serial"
        links.append(await _wire(clock, line.far, port, draw, 0 if port == "tcp" else 19200).open())
        links[-1].write("".join(f"{command}\r" for command in ("EO 0", *_LOAD)).encode())
    await sleep_ns(clock, 2 * _SETTLE_NS + draw.randrange(NS_PER_MS))
    for link in links:
        if waits:
            await _drain(clock, link)
        link.write(b"BGX\r")
        if waits:
            await _answered(link, 1)
    await sleep_ns(clock, _SETTLE_NS)
    for link in links:
        await link.close()
    return _skew(units)


async def _drain(clock: Clock, link: Link) -> None:
    """Take what has been answered so far."""
    await _answered(link, len(_LOAD) + 1)
    await sleep_ns(clock, NS_PER_MS)


def _wire(clock: Clock, far: Port, port: str, draw: Random, baud: int) -> MemoryWire:
    model = serial_wire(baud, hold_ns=_HOLD_NS) if baud else LAN
    return MemoryWire(clock, model, far, port, port, copy_context(), draw.randrange(2**31))


BASELINES = (
    Baseline("8 SMC-2000, one chain", "old: !BG", lambda clock, draw: _broadcast(clock, draw, False)),
    Baseline("8 SMC-2000, one chain", "old: !BG, shared clock", lambda clock, draw: _broadcast(clock, draw, True)),
    Baseline("8 SMC-4000", "old: go, then wait", lambda clock, draw: _one_by_one(clock, draw, "smc4000", True)),
    Baseline("8 SMC-4000", "old: go to all", lambda clock, draw: _one_by_one(clock, draw, "smc4000", False)),
    Baseline(
        "8 SMC-2000, own ports", "old: go, then wait", lambda clock, draw: _one_by_one(clock, draw, "smc2000", True)
    ),
    Baseline("8 SMC-2000, own ports", "old: go to all", lambda clock, draw: _one_by_one(clock, draw, "smc2000", False)),
)
