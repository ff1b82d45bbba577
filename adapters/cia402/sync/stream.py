"""Streamed positions, kept ahead of the drives: after the SYNC that starts them, one more position per period.

All writes happen at instants that were set with the first SYNC, so that the period does not drift against this
computer's clock, and are scheduled some periods ahead, so that a busy event loop does no harm. One write contains a
SYNC, and after it the positions for the next one, each twice, so that the loss of a single frame has no effect. In the
middle of each period the drives' answers are checked: all must have received the SYNC and followed.

Outputs may travel with the positions. A drive that leaves the stream must not be given those that are scheduled: these
writes are replaced. One that is too near for that is followed by a frame that makes the outputs passive, before the
SYNC that would apply them.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from math import inf
from typing import NamedTuple, Protocol

from adapters.cia402.canopen import states
from adapters.cia402.canopen.bus import SYNC, Cia402Bus
from adapters.cia402.canopen.node import BusDrive, SyncAnswer
from adapters.cia402.shapes.course import SetpointTrajectory
from adapters.cia402.shapes.switching import EdgeLog, OutputSchedule
from adapters.contract import TimedWrite, TimedWriter
from orchestrator.clock.base import NS_PER_MS, sleep_until_ns
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame, encode_frames

PERIODS_AHEAD = 5
"""Periods that are scheduled ahead."""
TAIL_SYNCS = 3
"""SYNCs after the last position: a SYNC may come before the drive has quite arrived, so that it takes one more
period."""
ANSWERED_WITHIN = 2 * PERIODS_AHEAD
"""Periods after which nothing is compared with a position that was sent."""
COPIES = 2
_NEAR_NS = 3 * NS_PER_MS
"""A write that is due within this time cannot be relied on to be cancelled: a process may wait for its instant."""


class StreamFollower(Protocol):
    """One drive in a stream. SYNCs, and the positions that they apply, are numbered from 0."""

    @property
    def position_count(self) -> int:
        """Return the number of its positions."""
        ...

    def position_frame(self, number: int) -> CanFrame:
        """Return the frame of a position, which the SYNC of that number applies."""
        ...

    @property
    def passive_frame(self) -> CanFrame | None:
        """The frame that makes its outputs passive at the next SYNC; None: no output is switched in the stream."""
        ...

    def record_write(self, number: int, at_ns: int) -> None:
        """Record that a SYNC was written at host time `at_ns`."""
        ...

    def check_answer(self, number: int) -> None:
        """Check its answer to a SYNC, which must have arrived."""
        ...

    def fail_stream(self, text: str) -> None:
        """Handle a stream that cannot continue, because of `text`."""
        ...

    def end_stream(self) -> None:
        """Handle the end of the stream: no further SYNC comes."""
        ...


class _ScheduledWrite(NamedTuple):
    """One write. number: of its SYNC; 0: it has none, only positions for SYNC 1."""

    number: int
    at_ns: int
    write: TimedWrite


class PositionStream:
    """The SYNCs of one start. first_ns: when the first is written. period_ns: from one to the next."""

    def __init__(self, bus: Cia402Bus, timed_writer: TimedWriter, first_ns: int, period_ns: int) -> None:
        self._bus = bus
        self._timed_writer = timed_writer
        self._first_ns = first_ns
        self._period_ns = period_ns
        self._followers: dict[int, StreamFollower] = {}
        self._writes: deque[_ScheduledWrite] = deque()
        self._overwriting: set[asyncio.Task[None]] = set()

    @property
    def has_followers(self) -> bool:
        return bool(self._followers)

    def add_follower(self, node: int, follower: StreamFollower) -> None:
        """Add a drive, before the first SYNC."""
        self._followers[node] = follower

    def remove_follower(self, node: int) -> StreamFollower | None:
        """Remove a drive: it gets no further position beyond the scheduled ones, and none of these if outputs are
        switched with them; return it, if it was part of the stream. No SYNC is sent without drives."""
        follower = self._followers.pop(node, None)
        if follower is None:
            return None
        passive = follower.passive_frame
        if passive is not None:
            self._overwrite_near(passive)
        if not self._followers:
            self.cancel_writes()
        elif passive is not None:
            self._replace_writes()
        return follower

    def cancel_writes(self) -> None:
        """Cancel the scheduled writes."""
        while self._writes:
            self._writes.popleft().write.cancel_write()

    async def run_stream(self, written_ns: int) -> None:
        """Run from the first SYNC, which was written at `written_ns`, to the last one. Raises `LinkClosed`."""
        # The drives were unknown when the first SYNC was scheduled: the second positions follow separately.
        self._writes.append(self._schedule_write(0))
        ordered_count = number = 0
        try:
            while (
                self._followers
                and number < max(rider.position_count for rider in self._followers.values()) + TAIL_SYNCS
            ):
                while ordered_count < number + PERIODS_AHEAD:
                    ordered_count += 1
                    self._writes.append(self._schedule_write(ordered_count))
                await sleep_until_ns(self._bus.clock, self._at_ns(number) + self._period_ns // 2)
                if not self._followers:
                    return
                write = await self._writes.popleft().write.wait_until_written()
                if write.late:
                    self._fail_all(
                        f"had no SYNC in period {number} of its stream: this computer was too busy (underrun)"
                    )
                    return
                self._check_answers(number, write.written_ns if number else written_ns)
                number += 1
        finally:
            self.cancel_writes()
            for rider in list(self._followers.values()):
                rider.end_stream()

    # Internals

    def _at_ns(self, number: int) -> int:
        return self._first_ns + number * self._period_ns

    def _schedule_write(self, number: int) -> _ScheduledWrite:
        """Schedule SYNC `number` and the positions for the next one; for 0, only these, a quarter of a period later."""
        at_ns = self._at_ns(number) if number else self._at_ns(0) + self._period_ns // 4
        data = (encode_frames(SYNC) if number else b"") + self._position_bytes(number + 1)
        return _ScheduledWrite(number, at_ns, self._schedule_bytes(at_ns, data))

    def _schedule_bytes(self, at_ns: int, data: bytes) -> TimedWrite:
        """Schedule a write; a delay of more than a quarter of the period could collide with the next write."""
        latest_ns = at_ns + self._period_ns // 4
        return self._timed_writer.schedule_write(self._bus.can_link.byte_link, data, at_ns, latest_ns)

    def _is_near(self, each: _ScheduledWrite) -> bool:
        return each.at_ns < self._bus.clock.now_ns() + _NEAR_NS

    def _replace_writes(self) -> None:
        """Schedule anew, with the positions of the present drives, what is not too near for that."""
        for index, queued_write in enumerate(self._writes):
            if not self._is_near(queued_write):
                queued_write.write.cancel_write()
                self._writes[index] = self._schedule_write(queued_write.number)

    def _overwrite_near(self, passive: CanFrame) -> None:
        """Write `passive` half a period after each write that may still happen as it is."""
        for queued_write in self._writes:
            # One that has just been written has been overwritten by the caller.
            if self._is_near(queued_write) and queued_write.at_ns + self._period_ns // 4 >= self._bus.clock.now_ns():
                write = self._schedule_bytes(queued_write.at_ns + self._period_ns // 2, encode_frames(passive))
                task = asyncio.get_running_loop().create_task(self._await_write(write))
                self._overwriting.add(task)
                task.add_done_callback(self._overwriting.discard)

    async def _await_write(self, write: TimedWrite) -> None:
        """Take the result of a write that no other part of the program waits for."""
        with suppress(LinkClosed):
            await write.wait_until_written()

    def _position_bytes(self, number: int) -> bytes:
        frames = [
            rider.position_frame(number)
            for rider in self._followers.values()
            if number < rider.position_count + TAIL_SYNCS
        ]
        return encode_frames(*frames * COPIES)

    def _check_answers(self, number: int, written_ns: int) -> None:
        late_ns = self._bus.clock.now_ns() - self._at_ns(number) - self._period_ns // 2
        for rider in list(self._followers.values()):
            rider.record_write(number, written_ns)
            # After a late check, an answer cannot be assigned to its SYNC.
            if late_ns < self._period_ns // 4:
                rider.check_answer(number)

    def _fail_all(self, text: str) -> None:
        for rider in list(self._followers.values()):
            rider.fail_stream(text)


class StreamedMove:
    """The motion of a drive along its set-point trajectory, with the outputs that are switched on the way. failed:
    called once, when the motion cannot continue; the reason is `failure`."""

    def __init__(
        self, node: BusDrive, trajectory: SetpointTrajectory, switched: OutputSchedule, failed: Callable[[], None]
    ) -> None:
        self._node = node
        self._switched = switched
        self.edges = EdgeLog(switched)
        self._outputs = self._outputs_before = node.outputs
        self._outputs_from = 0
        self._courses: list[tuple[float, Callable[[int], int]]] = [(-inf, trajectory.setpoint_function())]
        """Positions by their numbers, from a number on, up to that of the next course."""
        self._sent = -1
        self._failed = failed
        self._written_ns = 0
        self._set_count(trajectory)
        self.failure = ""
        self.has_arrived = False
        self.last_written_ns = 0
        """When the SYNC of its end position was written."""
        self.last_answer_ns = 0
        """When its answer to that SYNC arrived; 0: it was not checked in time."""

    def _set_count(self, trajectory: SetpointTrajectory) -> None:
        self._end_number = trajectory.point_count - 1
        # At the end it stands until the last output is passive.
        self.position_count = max(trajectory.point_count, self._switched.last)

    @property
    def is_done(self) -> bool:
        """Whether it has arrived, or failed."""
        return self.has_arrived or bool(self.failure)

    def _setpoint_at(self, number: int) -> int:
        return next(position_at for begin, position_at in reversed(self._courses) if number >= begin)(number)

    @property
    def next_number(self) -> int:
        """The first position that is not sent yet."""
        return self._sent + 1

    def continue_with(self, trajectory: SetpointTrajectory, number: int, switched: OutputSchedule) -> None:
        """Take the positions from `number` on from another trajectory, and the outputs from another schedule; none of
        what differs is sent yet. It may replace one that has not begun: the positions before `number` stay as they
        were."""
        sent_courses = sum(begin <= self._sent - ANSWERED_WITHIN for begin, _ in self._courses)
        kept_courses = [course for course in self._courses[max(0, sent_courses - 1) :] if course[0] < number]
        self._courses = [*kept_courses, (number, trajectory.setpoint_function())]
        self._switched = switched
        self.edges.follow_schedule(switched)
        self._set_count(trajectory)

    def change_outputs(self, outputs: int) -> int:
        """Switch other outputs with the next position that is not sent yet, and return its number."""
        self._outputs_before, self._outputs, self._outputs_from = self._outputs, outputs, self.next_number
        return self.next_number

    def position_frame(self, number: int) -> CanFrame:
        self._sent = max(self._sent, number)
        other_outputs = self._outputs if number >= self._outputs_from else self._outputs_before
        return self._node.position_frame(self._setpoint_at(number), self._switched.outputs_at(other_outputs, number))

    @property
    def passive_frame(self) -> CanFrame | None:
        return self._node.position_frame(self._node.given) if self._node.switches_with_positions else None

    def record_write(self, number: int, at_ns: int) -> None:
        self._written_ns = at_ns
        self._node.given = self._setpoint_at(number)
        self.edges.record_write(number, at_ns)
        if number == self._end_number:
            self.last_written_ns = at_ns

    def check_answer(self, number: int) -> None:
        """Check its answer to a SYNC, which contains its demanded position: at that time, the position of the previous
        SYNC."""
        node, answer = self._node, self._node.answer
        if self.is_done or not node.is_enabled:
            return  # its state shows what has happened
        if answer.at_ns <= self._written_ns:
            self.fail_stream(f"has not answered SYNC {number} of its stream (underrun)")
        elif not answer.status & states.FOLLOWS:
            self.fail_stream("does not follow the positions of its stream: bit 12 of its statusword is off")
        elif abs(answer.demand - self._setpoint_at(number - 2)) < abs(answer.demand - self._setpoint_at(number - 1)):
            self.fail_stream(f"had no position with SYNC {number - 1} of its stream (underrun)")
        else:
            self._take_answer(number, answer)

    def _take_answer(self, number: int, answer: SyncAnswer) -> None:
        self.edges.record_answer(number, answer.at_ns)
        if number == self._end_number:
            self.last_answer_ns = answer.at_ns
        elif number > self.position_count and answer.demand == self._setpoint_at(number):
            self.has_arrived = True
            self._node.demand = answer.demand  # its unsolicited message may come later
            self._node.wake_waiting()

    def fail_stream(self, text: str) -> None:
        if not self.is_done:
            self.failure = text
            self._failed()
            self._node.wake_waiting()

    def end_stream(self) -> None:
        self.fail_stream("has not reached the end of its stream")
