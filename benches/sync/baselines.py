"""Baseline methods of starting controllers together: bytes on simulated links, without any part of Tutti.

Moves are loaded manually; then a chain gets its broadcast, or each controller its start command.
"""

from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

from orchestrator.bench import scripted
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock
from orchestrator.link.base import Link
from orchestrator.runtime.simulated_fleets import DRIFT_PPM, HOLD_MS, WANDER_PPM
from sim.core.controller import DeviceSpec, SimulatedController, build_line
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

COUNT = 8
_LOAD = ("SHX", "SPX=50000", "ACX=500000", "DCX=500000", "PRX=20000")
_SETTLE_NS = 200 * NS_PER_MS
_HOLD_NS = round(HOLD_MS * NS_PER_MS)
_WRITE_NS = (20_000, 60_000)  # duration of a script's write to a socket or port


@dataclass(frozen=True, slots=True)
class BaselineMethod:
    """A row: fleet, method, and the function that runs one trial and returns its start skew in ns."""

    fleet: str
    way: str
    trial: Callable[[VirtualClock, Random], Coroutine[Any, Any, int]]


def _draw_crystal(draw: Random) -> Oscillator:
    return Oscillator(draw.randrange(10**11), draw.uniform(-DRIFT_PPM, DRIFT_PPM), WANDER_PPM, draw.randrange(2**31))


def _draw_age(draw: Random) -> int:
    """Return a time since power-up after which the phases of the servo ticks are random."""
    return draw.randrange(200 * NS_PER_S, 600 * NS_PER_S)


def _measure_skew(units: list[SimulatedController]) -> int:
    starts = [unit.commanded_motions[-1].start_ns for unit in units]
    return max(starts) - min(starts)


async def _wait_for_acknowledgement(link: Link, ends: bytes) -> None:
    """Read until an acknowledgement has arrived."""
    reply = b""
    while not reply.endswith(ends):
        reply += (await link.read()).data


async def _start_by_broadcast(clock: VirtualClock, draw: Random, *, shared: bool) -> int:
    """Send `!BG` to a daisy chain; with shared sample clock, `TM -1` in all controllers but the first (SMC-2000,
    L975)."""
    branches = {
        f"u{k}": DeviceSpec(
            k, {"axes": 2, "echo": False}, _draw_crystal(draw), scripted.YASKAWA_TIMING, draw.randrange(2**31)
        )
        for k in range(COUNT)
    }
    line = build_line(find_simulator("smc2000"), clock, branches)
    if shared:
        line.endpoint.share_clock()  # type: ignore[attr-defined]  # of a chain
    link = await scripted.open_link(clock, line, 19200, draw, _HOLD_NS)
    await sleep_ns(clock, _draw_age(draw))
    for k in range(COUNT):
        external = ("TM -1",) if shared and k else ()
        link.write("".join(f"{command}\r" for command in (f"%{k}", *external, *_LOAD)).encode())
        await sleep_ns(clock, _SETTLE_NS + draw.randrange(NS_PER_MS))
    link.write(b"!BGX\r")
    await sleep_ns(clock, _SETTLE_NS)
    await link.close()
    return _measure_skew(list(line.devices.values()))


@dataclass(frozen=True, slots=True)
class _ManualMake:
    """The manual commands of a make. load: lines; go: the start command; ends: the end of its acknowledgement."""

    controller: scripted.ScriptedController
    load: tuple[str, ...]
    go: str
    ends: bytes


_SMC4000 = _ManualMake(scripted.SMC4000, ("EO 0", *_LOAD), "BGX", b":")
_SMC2000 = _ManualMake(scripted.SMC2000, ("EO 0", *_LOAD), "BGX", b":")
_SHRC203 = _ManualMake(scripted.SHRC203, ("C:11", "MP:1+P20000,S100F20000R100"), "G:1", b"OK\r\n")


async def _start_one_by_one(clock: VirtualClock, draw: Random, makes: Sequence[_ManualMake], *, waits: bool) -> int:
    """Send the start command to each controller on its own link; waits: only after the previous one has
    acknowledged."""
    units: list[SimulatedController] = []
    links: list[Link] = []
    for k, make in enumerate(makes):
        line = make.controller.build(clock, f"u{k}", _draw_crystal(draw), draw)
        units += line.devices.values()
        links.append(await scripted.open_link(clock, line, make.controller.baud, draw, _HOLD_NS))
        for text in make.load:
            links[-1].write((text + make.controller.eol).encode())
            await sleep_ns(clock, _SETTLE_NS)
    await sleep_ns(clock, _draw_age(draw))
    for link in links:
        await scripted.discard_input(link)
    for make, link in zip(makes, links, strict=True):
        await sleep_ns(clock, draw.randrange(*_WRITE_NS))
        link.write((make.go + make.controller.eol).encode())
        if waits:
            await _wait_for_acknowledgement(link, make.ends)
    await sleep_ns(clock, _SETTLE_NS)
    for link in links:
        await link.close()
    return _measure_skew(units)


def _make_manual_baselines(fleet: str, makes: Sequence[_ManualMake]) -> tuple[BaselineMethod, BaselineMethod]:
    return (
        BaselineMethod(
            fleet, "old: go, then wait", lambda clock, draw: _start_one_by_one(clock, draw, makes, waits=True)
        ),
        BaselineMethod(fleet, "old: go to all", lambda clock, draw: _start_one_by_one(clock, draw, makes, waits=False)),
    )


BASELINES = (
    BaselineMethod(
        "8 SMC-2000, one chain", "old: !BG", lambda clock, draw: _start_by_broadcast(clock, draw, shared=False)
    ),
    BaselineMethod(
        "8 SMC-2000, one chain",
        "old: !BG, shared clock",
        lambda clock, draw: _start_by_broadcast(clock, draw, shared=True),
    ),
    *_make_manual_baselines("8 SMC-4000", [_SMC4000] * COUNT),
    *_make_manual_baselines("8 SMC-2000, own ports", [_SMC2000] * COUNT),
    # of controllers started by one trigger line
    *_make_manual_baselines("mixed", [_SMC4000, _SMC4000, _SMC2000, _SMC2000, _SHRC203, _SHRC203]),
)
