"""A script of the kind that Tutti replaces: it sends moves, begins them, and queries until all controllers rest.

Bytes on the simulated links of a fleet in virtual time, without any part of Tutti: no agreed start, no check, no
evidence. Its gap between two moves is what a query and a write cost. The loops of each make are in
`orchestrator.bench.field_scripts`.
"""

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple, Protocol

from orchestrator.bench.scripted import discard_input
from orchestrator.bench.truth import NothingHappened
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import Link
from orchestrator.model.fleet import CanBusLink, Fleet, SerialLink, group_by_link
from orchestrator.model.names import controller_of
from orchestrator.runtime.virtual.fleet import VirtualFleet

ANSWER_S = 2.0
REST_NS = 60 * NS_PER_S  # the longest wait for the end of a move

Motions = dict[str, list[tuple[int, int]]]
"""By axis: start and end of each of its motions, ns."""


class ScriptPort:
    """The script's end of one link, which controllers may share: it asks one of them at a time."""

    def __init__(self, link: Link) -> None:
        self.link = link

    async def read_until(self, ends: bytes) -> bytes:
        """Read a reply up to its end; what there is after 2 s without it."""
        reply = b""
        with suppress(TimeoutError):
            async with asyncio.timeout(ANSWER_S):
                while not reply.endswith(ends):
                    reply += (await self.link.read()).data
        return reply


class ScriptLoop(Protocol):
    """How a script moves one controller of a make. name: of the row; source: where the loop is published."""

    @property
    def name(self) -> str: ...

    @property
    def source(self) -> str: ...

    @property
    def pause_ns(self) -> int:
        """Between two queries for the end."""
        ...

    @property
    def settle_ns(self) -> int:
        """From the begin of a move to the first query."""
        ...

    async def set_up(self, port: ScriptPort, address: int | None) -> None:
        """What the script sends once, at its beginning."""
        ...

    async def begin_move(self, port: ScriptPort, address: int | None, target: int) -> None:
        """Send a move to `target` counts, and begin it."""
        ...

    async def is_at_rest(self, port: ScriptPort, address: int | None) -> bool:
        """Whether a query shows the controller at rest."""
        ...


class _ScriptMember(NamedTuple):
    """One controller of the script."""

    name: str
    loop: ScriptLoop
    port: ScriptPort
    address: int | None


def measure_script(
    fleet: Fleet, loops: Mapping[str, ScriptLoop], moves: Sequence[Mapping[str, int]], seed: int = 1
) -> Motions:
    """Run `moves` of a fleet's axes one after the other; return the motions by the simulators' ground truth.

    loops: by adapter. moves: by axis, one axis of each controller, the target in counts. Raises `NothingHappened`."""
    return run_virtual(lambda clock: _run_script(VirtualFleet(fleet, clock, seed), loops, moves))


async def _run_script(
    virtual: VirtualFleet, loops: Mapping[str, ScriptLoop], moves: Sequence[Mapping[str, int]]
) -> Motions:
    axes = {controller_of(axis): axis for axis in moves[0]}
    members = await _open_members(virtual, loops)
    for member in members:
        await member.loop.set_up(member.port, member.address)
        await discard_input(member.port.link)
    for move in moves:
        for member in members:
            await member.loop.begin_move(member.port, member.address, move[axes[member.name]])
        for member in members:
            await _wait_for_rest(virtual.clock, member)
    for port in {id(member.port): member.port for member in members}.values():
        await port.link.close()
    return read_virtual_motions(virtual, axes.values())


async def _open_members(virtual: VirtualFleet, loops: Mapping[str, ScriptLoop]) -> list[_ScriptMember]:
    members: list[_ScriptMember] = []
    for names in group_by_link(virtual.fleet.controllers):
        port = ScriptPort(await virtual.wires[names[0]].open_link())
        for name in names:
            config = virtual.fleet.controllers[name]
            address = config.link.address if isinstance(config.link, SerialLink | CanBusLink) else None
            members.append(_ScriptMember(name, loops[config.adapter], port, address))
    return members


async def _wait_for_rest(clock: VirtualClock, member: _ScriptMember) -> None:
    began_ns = clock.now_ns()
    if member.loop.settle_ns:
        await sleep_ns(clock, member.loop.settle_ns)
    while not await member.loop.is_at_rest(member.port, member.address):
        if clock.now_ns() > began_ns + REST_NS:
            raise NothingHappened(f"the script's controller {member.name} does not come to rest")
        if member.loop.pause_ns:
            await sleep_ns(clock, member.loop.pause_ns)


def read_virtual_motions(virtual: VirtualFleet, axes: Iterable[str]) -> Motions:
    """The motions of axes that have ended, by the simulators' ground truth."""
    return {
        axis: [
            (motion.start_ns, motion.end_ns)
            for motion in virtual.controllers[controller_of(axis)].commanded_motions
            if motion.axis == virtual.fleet.axis(axis).motors[0] and motion.end_ns is not None
        ]
        for axis in axes
    }


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


def find_whole_ns(motions: Iterable[list[tuple[int, int]]]) -> int:
    """From the first start to the last end, ns."""
    by_axis = list(motions)
    return max(axis[-1][1] for axis in by_axis) - min(axis[0][0] for axis in by_axis)
