"""The SYNCs of one bus that start steps: which drives each of them starts, and that no other one starts them.

A set-point waits in a synchronous RPDO for the next SYNC, whosever it is. So the steps of a bus go one after another:
what a step loads is sent when every earlier start of the bus is over, and one SYNC starts all drives of a step. Where
positions are streamed, the SYNCs behind it belong to the start as well.
"""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from adapters.cia402.bus import SYNC, Bus
from adapters.cia402.stream import Rider, Stream
from adapters.contract import CannotDo, Fired, FireOrder, Firer
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame, encode

APART_NS = 20 * NS_PER_MS
"""Two starts of a bus are at least so far apart: time for the second one's set-points to be sent."""


@dataclass(slots=True, eq=False)
class Shot:
    """One SYNC, and the stream behind it. until_ns: when its last SYNC is over. reserved: drives that are armed for it.
    held: frames that are to be sent before it, by drive."""

    t0_ns: int
    until_ns: int
    reserved: set[int] = field(default_factory=set[int])
    held: dict[int, tuple[CanFrame, ...]] = field(default_factory=dict[int, tuple[CanFrame, ...]])
    stream: Stream | None = None
    sent: set[int] = field(default_factory=set[int])
    order: FireOrder | None = None
    following: asyncio.Task[None] | None = None
    fired: "asyncio.Future[Fired | None]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    """When it was written; None: it was taken back."""


class Starts:
    """All starts of one bus that are still to come."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._shots: list[Shot] = []
        self._unknown: set[int] = set()

    def lost(self, node: int) -> None:
        """Nobody knows what waits in a drive: it was not met yet, or its link was lost."""
        self._unknown.add(node)

    def met(self, node: int) -> bool:
        """What waits in a drive was overwritten. Have it taken now; not if that could start one that was not met."""
        self._unknown.discard(node)
        return not self._unknown and self.flush()

    def reserve(self, node: int, t0_ns: int, until_ns: int) -> Shot:
        """A drive is armed for `t0_ns`, and needs SYNC until `until_ns`.

        Raises `CannotDo` (bus-busy) when another start of the bus is too near.
        """
        self._sweep()
        same = next((shot for shot in self._shots if shot.t0_ns == t0_ns), None)
        for shot in self._shots:
            apart = shot.until_ns + APART_NS <= t0_ns or until_ns + APART_NS <= shot.t0_ns
            if shot is not same and (not apart or (shot.sent and t0_ns < shot.t0_ns)):
                until = f", and streams positions for {(shot.until_ns - shot.t0_ns) / NS_PER_MS:.0f} ms"
                raise CannotDo(
                    "bus-busy",
                    f"the bus starts node {min(shot.reserved)} {(shot.t0_ns - t0_ns) / NS_PER_MS:+.3f} ms from that "
                    f"instant{until if shot.until_ns > shot.t0_ns else ''}; a SYNC starts every drive that is loaded",
                    f"start drives of one bus in one step, or {APART_NS // NS_PER_MS} ms apart",
                )
        if same is not None:
            same.reserved.add(node)
            same.until_ns = max(same.until_ns, until_ns)
            return same
        shot = Shot(t0_ns, until_ns, {node})
        self._shots.append(shot)
        self._shots.sort(key=lambda each: each.t0_ns)
        return shot

    def load(self, node: int, shot: Shot, frames: Sequence[CanFrame], firer: Firer, at_ns: int, latest_ns: int) -> None:
        """Send `frames` when no earlier start can take them, and have the SYNC written at `at_ns`.

        Raises `LinkClosed`.
        """
        shot.held[node] = tuple(frames)
        if shot.order is None:
            shot.order = firer.schedule(self._bus.can.link, encode(SYNC), at_ns, latest_ns)
            shot.following = asyncio.get_running_loop().create_task(self._follow(shot, shot.order))
        self._advance()

    def ride(self, node: int, shot: Shot, rider: Rider, firer: Firer, at_ns: int, period_ns: int) -> None:
        """More SYNCs follow the one of `shot`, which is written at `at_ns`, with positions for the drive."""
        if shot.stream is None:
            shot.stream = Stream(self._bus, firer, at_ns, period_ns)
        shot.stream.join(node, rider)

    def drop(self, node: int, shot: Shot) -> bool:
        """The drive is disarmed, or at its end. Whether frames had been sent to it that still wait for a SYNC."""
        shot.reserved.discard(node)
        shot.held.pop(node, None)
        waiting = node in shot.sent and not shot.fired.done()
        if shot.stream is not None and shot.stream.leave(node):
            waiting = True
            if not shot.stream.riding and shot.fired.done():
                self._over(shot, None)
        if not shot.reserved and not shot.fired.done():
            if shot.order is not None:
                shot.order.cancel()
            self._over(shot, None)
        return waiting

    def flush(self) -> bool:
        """Have what waits in a drive taken now; not if that would start others."""
        self._sweep()
        if any(shot.sent for shot in self._shots):
            return False
        self._bus.send(SYNC)
        return True

    async def _follow(self, shot: Shot, order: FireOrder) -> None:
        fired: Fired | None = None
        with suppress(asyncio.CancelledError, LinkClosed):
            fired = await order.done()
            if shot.stream is not None and shot.stream.riding and not fired.late:
                shot.fired.set_result(fired)
                await shot.stream.run(fired.written_ns)
        self._over(shot, fired)

    def _over(self, shot: Shot, fired: Fired | None) -> None:
        if not shot.fired.done():
            shot.fired.set_result(fired)
        if shot in self._shots:
            self._shots.remove(shot)
            self._advance()

    def _advance(self) -> None:
        """Send what the next start needs."""
        if self._shots and self._shots[0].held:
            first = self._shots[0]
            frames = [frame for node in sorted(first.held) for frame in first.held[node]]
            first.sent |= first.held.keys()
            first.held.clear()
            self._bus.send(*frames)

    def _sweep(self) -> None:
        """Forget those that nobody has released by their instant."""
        now_ns = self._bus.clock.now_ns()
        for shot in [each for each in self._shots if each.order is None and each.t0_ns < now_ns]:
            self._over(shot, None)
