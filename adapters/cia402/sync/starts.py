"""The SYNCs of one bus that start steps: which drives each of them starts, and that no other drive starts with it.

A set-point waits in a synchronous RPDO for the next SYNC, whatever its purpose. So the steps of a bus are started in
sequence: the frames of a step are sent when every earlier start of the bus is over, and one SYNC starts all drives of a
step. If positions are streamed, the following SYNCs belong to the start as well.
"""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from adapters.cia402.canopen.bus import SYNC, Cia402Bus
from adapters.cia402.sync.stream import PositionStream, StreamFollower
from adapters.contract import TimedWrite, TimedWriter, WriteResult
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame, encode_frames
from orchestrator.model.errors import Refusal

START_SPACING_NS = 20 * NS_PER_MS
"""Shortest time between two starts of a bus: time to send the set-points of the second one."""


@dataclass(slots=True, eq=False)
class SyncStart:
    """One SYNC, and the stream after it.

    until_ns: when its last SYNC is over.
    reserved: drives that are armed for it.
    pending_frames: frames that are to be sent before it, by drive."""

    t0_ns: int
    until_ns: int
    reserved: set[int] = field(default_factory=set[int])
    pending_frames: dict[int, tuple[CanFrame, ...]] = field(default_factory=dict[int, tuple[CanFrame, ...]])
    stream: PositionStream | None = None
    sent: set[int] = field(default_factory=set[int])
    order: TimedWrite | None = None
    following: asyncio.Task[None] | None = None
    fired: "asyncio.Future[WriteResult | None]" = field(
        default_factory=lambda: asyncio.get_running_loop().create_future()
    )
    """When it was written; None: it was cancelled."""


class SyncScheduler:
    """All pending starts of one bus."""

    def __init__(self, bus: Cia402Bus, timed_writer: TimedWriter) -> None:
        self._bus = bus
        self._timed_writer = timed_writer
        self._starts: list[SyncStart] = []
        self._unknown: set[int] = set()
        self._left: dict[int, StreamFollower] = {}
        """Drives that have left a stream since they were started last: outputs may still wait in them."""

    def mark_unknown(self, node: int) -> None:
        """Mark a drive with unknown waiting commands: it was not connected yet, or its link was lost."""
        self._unknown.add(node)
        self._left.pop(node, None)

    def mark_connected(self, node: int) -> bool:
        """Mark a drive whose waiting commands were overwritten. Apply them by a SYNC now, unless that could start an
        unconnected drive; return whether the SYNC was sent."""
        self._unknown.discard(node)
        return not self._unknown and self.apply_waiting()

    def reserve_start(self, node: int, t0_ns: int, until_ns: int) -> SyncStart:
        """Reserve a start: a drive is armed for `t0_ns`, and needs SYNC until `until_ns`.

        Raises `Refusal` (bus-busy) when another start of the bus is too near.
        """
        self._drop_expired()
        same_start = next((shot for shot in self._starts if shot.t0_ns == t0_ns), None)
        for shot in self._starts:
            is_apart = shot.until_ns + START_SPACING_NS <= t0_ns or until_ns + START_SPACING_NS <= shot.t0_ns
            if shot is not same_start and (not is_apart or (shot.sent and t0_ns < shot.t0_ns)):
                stream_text = f", and streams positions for {(shot.until_ns - shot.t0_ns) / NS_PER_MS:.0f} ms"
                raise Refusal(
                    "bus-busy",
                    f"the bus starts node {min(shot.reserved)} {(shot.t0_ns - t0_ns) / NS_PER_MS:+.3f} ms "
                    f"from that instant{stream_text if shot.until_ns > shot.t0_ns else ''}; a SYNC starts every "
                    "drive that is loaded",
                    f"start drives of one bus in one step, or {START_SPACING_NS // NS_PER_MS} ms apart",
                )
        if same_start is not None:
            same_start.reserved.add(node)
            same_start.until_ns = max(same_start.until_ns, until_ns)
            return same_start
        shot = SyncStart(t0_ns, until_ns, {node})
        self._starts.append(shot)
        self._starts.sort(key=lambda shot: shot.t0_ns)
        return shot

    def extend_start(self, start: SyncStart, until_ns: int) -> None:
        """Let a stream last until `until_ns`. Raises `Refusal` (bus-busy) when another start is reserved until then."""
        if any(start.t0_ns < shot.t0_ns < until_ns + START_SPACING_NS for shot in self._starts):
            text = "the bus is to start other drives before the stream would end"
            raise Refusal("bus-busy", text, "start drives of one bus in one step")
        start.until_ns = max(start.until_ns, until_ns)

    def load_frames(
        self,
        node: int,
        start: SyncStart,
        frames: Sequence[CanFrame],
        at_ns: int,
        latest_ns: int,
    ) -> None:
        """Send `frames` when no earlier start can apply them, and schedule the SYNC at `at_ns`.

        Raises `LinkClosed`.
        """
        self._left.pop(node, None)
        start.pending_frames[node] = tuple(frames)
        if start.order is None:
            start.order = self._timed_writer.schedule_write(
                self._bus.can_link.byte_link, encode_frames(SYNC), at_ns, latest_ns
            )
            start.following = asyncio.get_running_loop().create_task(self._follow_start(start, start.order))
        self._send_next_frames()

    def join_stream(
        self,
        node: int,
        start: SyncStart,
        follower: StreamFollower,
        at_ns: int,
        period_ns: int,
    ) -> None:
        """Add a drive to the stream: more SYNCs, with its positions, follow the one of `start`, which is written at
        `at_ns`."""
        if start.stream is None:
            start.stream = PositionStream(self._bus, self._timed_writer, at_ns, period_ns)
        start.stream.add_follower(node, follower)

    def remove_drive(self, node: int, start: SyncStart) -> bool:
        """Remove a drive that is disarmed, or at its end. Return whether frames had been sent to it that still wait for
        a SYNC."""
        start.reserved.discard(node)
        start.pending_frames.pop(node, None)
        is_waiting = node in start.sent and not start.fired.done()
        follower = None if start.stream is None else start.stream.remove_follower(node)
        if start.stream is not None and follower is not None:
            is_waiting = True
            self._left[node] = follower
            if not start.stream.has_followers and start.fired.done():
                self._finish_start(start, None)
        if not start.reserved and not start.fired.done():
            if start.order is not None:
                start.order.cancel_write()
            self._finish_start(start, None)
        return is_waiting

    def apply_waiting(self) -> bool:
        """Send a SYNC that applies the commands waiting in drives, unless it would start others; return whether it was
        sent."""
        self._drop_expired()
        if any(shot.sent for shot in self._starts):
            return False
        # A position that was too near to be withdrawn may have arrived after the frame that overwrites it.
        passive = [frame for left_drive in self._left.values() if (frame := left_drive.passive_frame) is not None]
        self._bus.send_frames(*passive, SYNC)
        return True

    async def _follow_start(self, start: SyncStart, order: TimedWrite) -> None:
        write: WriteResult | None = None
        with suppress(asyncio.CancelledError, LinkClosed):
            write = await order.wait_until_written()
            if start.stream is not None and start.stream.has_followers and not write.late:
                start.fired.set_result(write)
                await start.stream.run_stream(write.written_ns)
        self._finish_start(start, write)

    def _finish_start(self, start: SyncStart, fired: WriteResult | None) -> None:
        if not start.fired.done():
            start.fired.set_result(fired)
        if start in self._starts:
            self._starts.remove(start)
            self._send_next_frames()

    def _send_next_frames(self) -> None:
        """Send the frames of the next start."""
        if self._starts and self._starts[0].pending_frames:
            first = self._starts[0]
            frames = [frame for node in sorted(first.pending_frames) for frame in first.pending_frames[node]]
            first.sent |= first.pending_frames.keys()
            first.pending_frames.clear()
            self._bus.send_frames(*frames)

    def _drop_expired(self) -> None:
        """Drop starts that were not released by their instant."""
        now_ns = self._bus.clock.now_ns()
        for shot in [start for start in self._starts if start.order is None and start.t0_ns < now_ns]:
            self._finish_start(shot, None)
