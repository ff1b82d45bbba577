"""Simulated controllers as a script without Tutti uses them: lines of text on simulated links, in virtual time."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass
from random import Random

from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.clock.virtual import VirtualClock
from orchestrator.link.base import Link
from orchestrator.link.memory import LAN, MemoryWire, serial_wire
from sim.core.controller import DeviceSpec, FirmwareTiming, SimulatedLine, build_line
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

SILENCE_S = 0.1
YASKAWA_TIMING = FirmwareTiming(500 * NS_PER_US, 50 * NS_PER_US)


@dataclass(frozen=True, slots=True)
class ScriptedController:
    """A simulated controller, and how it is wired. baud: 0: TCP. eol: the end of a line that is sent."""

    model: str
    baud: int
    options: Mapping[str, object]
    timing: FirmwareTiming
    eol: str = "\r"

    def build(self, clock: VirtualClock, name: str, crystal: Oscillator, draw: Random) -> SimulatedLine:
        """Return the controller on a line of its own."""
        spec = DeviceSpec(None, self.options, crystal, self.timing, draw.randrange(2**31))
        return build_line(find_simulator(self.model), clock, {name: spec})


SMC4000 = ScriptedController("smc4000", 0, {"axes": 2}, YASKAWA_TIMING)
SMC2000 = ScriptedController("smc2000", 19200, {"axes": 2}, YASKAWA_TIMING)
SHRC203 = ScriptedController(
    "shrc203",
    38400,
    {"divide": 20, "speed": [100, 20000, 100]},
    FirmwareTiming(NS_PER_MS, 800 * NS_PER_US),
    "\r\n",
)


async def open_link(clock: VirtualClock, line: SimulatedLine, baud: int, draw: Random, hold_ns: int = 0) -> Link:
    """Return an open link to a line. baud: 0: TCP. hold_ns: how long a serial adapter keeps received bytes."""
    model, port = (serial_wire(baud, hold_ns=hold_ns), "serial") if baud else (LAN, "tcp")
    return await MemoryWire(
        clock=clock,
        model=model,
        far=line.endpoint,
        port=port,
        endpoint=port,
        far_context=copy_context(),
        seed=draw.randrange(2**31),
    ).open_link()


async def discard_input(link: Link) -> None:
    """Read what arrives until the link is silent, e.g. a greeting."""
    with suppress(TimeoutError):
        while True:
            async with asyncio.timeout(SILENCE_S):
                await link.read()
