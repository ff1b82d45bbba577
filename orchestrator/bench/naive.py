"""A script of the kind that Tutti replaces: it sends moves, begins them, and queries until all controllers rest.

Bytes on simulated links in virtual time, without any part of Tutti: no agreed start, no check, no evidence. Its gap
between two moves is what a query and a write cost.
"""

import asyncio
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from random import Random

from orchestrator.bench import scripted
from orchestrator.bench.truth import NothingHappened
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import Link
from sim.core.controller import FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator

ANSWER_S = 2.0
LOOKS_MOST = 5000  # for the end of one move


@dataclass(frozen=True, slots=True)
class NaiveMake:
    """What the script sends to a controller of one make.

    setup: lines at its beginning. begin: lines of a move to `{target}` counts. query, rests: a query, and the end of
    its reply at rest. ends: the end of any reply.
    """

    controller: scripted.ScriptedController
    setup: tuple[str, ...]
    begin: tuple[str, ...]
    query: str
    rests: bytes
    ends: bytes = b"\r\n"


SMC4000 = NaiveMake(
    scripted.SMC4000,
    ("EO 0", "SHX", "SPX=200000", "ACX=1000000", "DCX=1000000"),
    ("PAX={target}", "BGX"),
    "MG_BGX",
    b"0.0000\r\n:",
    ends=b":",
)
SHRC203 = NaiveMake(
    scripted.SHRC203,
    ("C:11", "D:1S100F100000R200"),
    ("A:1+P{target}", "G:1"),
    "!:",
    b"R\r\n",
)
SMC30 = NaiveMake(
    scripted.ScriptedController(
        "smc30", 9600, {"travel_steps": [-20_000, 400_000]}, FirmwareTiming(NS_PER_MS, 200 * NS_PER_US)
    ),
    ("K", "S400", "T10000", "R1000", "CS1000", "CT1000", "CR1000"),
    ("G+{target}",),
    "F",
    b"R\r",
    ends=b"\r",
)
PPSMC = NaiveMake(
    scripted.ScriptedController(
        "ppsmc",
        0,
        {"axes": 1, "org_steps": {"1": [-9000, -2000]}},
        FirmwareTiming(5 * NS_PER_MS, 15 * NS_PER_MS),
        "\r\n",
    ),
    ("txdel3", "echo0", "frun1:4000", "ffast1:80000"),
    ("tbc", "tbs1:a{target}", "tbg"),
    "?s",
    b"",
)


@dataclass(frozen=True, slots=True)
class NaiveMove:
    """One controller of the script, and how far it moves to and fro, counts. hold_ns: how long its serial adapter keeps
    received bytes, as in the fleet beside it."""

    make: NaiveMake
    counts: int
    hold_ns: int = 0


def measure_naive_gaps(moves: Sequence[NaiveMove], steps: int, seed: int = 1) -> list[int]:
    """Run `steps` moves of all controllers; return the times from the last end of a move to the first start of the
    next, ns."""
    return run_virtual(lambda clock: _run_script(clock, moves, steps, Random(seed)))


async def _run_script(clock: VirtualClock, moves: Sequence[NaiveMove], steps: int, draw: Random) -> list[int]:
    units: list[SimulatedController] = []
    ports: list[tuple[NaiveMove, _ScriptPort]] = []
    for number, move in enumerate(moves):
        make = move.make
        crystal = Oscillator(0, draw.uniform(-50, 50), 0.05, draw.randrange(2**31))
        line = make.controller.build(clock, f"u{number}", crystal, draw)
        units += line.devices.values()
        ports.append(
            (move, _ScriptPort(await scripted.open_link(clock, line, make.controller.baud, draw, move.hold_ns), make))
        )
    for _, port in ports:
        for text in port.make.setup:
            await port.send(text)
        await scripted.discard_input(port.link)
    for step in range(steps):
        for move, port in ports:
            target = move.counts if step % 2 == 0 else 0
            for text in port.make.begin:
                await port.send(text.format(target=target))
        for _, port in ports:
            for _ in range(LOOKS_MOST):
                if await port.is_at_rest():
                    break
                await sleep_ns(clock, NS_PER_MS)
            else:
                raise NothingHappened(f"the script's {port.make.controller.model} does not come to rest")
    for _, port in ports:
        await port.link.close()
    return find_gaps(
        [(motion.start_ns, motion.end_ns) for motion in unit.commanded_motions if motion.end_ns is not None]
        for unit in units
    )


class _ScriptPort:
    """The script's end of one link."""

    def __init__(self, link: Link, make: NaiveMake) -> None:
        self.link = link
        self.make = make

    async def send(self, text: str) -> bytes:
        """Write a line; return what arrives until a reply is complete. A make that acknowledges nothing is not waited
        for."""
        self.link.write((text + self.make.controller.eol).encode())
        if not self.make.rests and not text.startswith("?"):
            return b""
        return await self._read_reply()

    async def _read_reply(self) -> bytes:
        reply = b""
        with suppress(TimeoutError):
            async with asyncio.timeout(ANSWER_S):
                while not reply.endswith(self.make.ends):
                    reply += (await self.link.read()).data
        return reply

    async def is_at_rest(self) -> bool:
        """Whether a query shows the controller at rest."""
        reply = await self.send(self.make.query)
        return reply.endswith(self.make.rests) if self.make.rests else _is_ready(reply)


def _is_ready(reply: bytes) -> bool:
    """Whether the status of a pp-electronic SMC has the ready bit of its only axis."""
    text = reply.decode("ascii", "replace").partition(":")[2].split(";")[0].strip()
    return bool(text) and bool(int(text) & 1)


def find_gaps(motions: Iterable[list[tuple[int, int]]]) -> list[int]:
    """Return the times from the last end of one step to the first start of the next, ns.

    motions: by axis, start and end of each of its motions; every axis moves in every step."""
    by_axis = list(motions)
    count = min(map(len, by_axis))
    gaps: list[int] = []
    for step in range(1, count):
        last_ns = max(axis[step - 1][1] for axis in by_axis)
        gaps.append(min(axis[step][0] for axis in by_axis) - last_ns)
    return gaps
