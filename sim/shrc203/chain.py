"""Double buffer (chapter 2 of the manual): execution buffer, prebuffer, and the migration between them.

An operation that completes moves the prebuffer's value into the execution buffer, empties the prebuffer, sends its
completion character, and then starts the migrated operation (L177-L179).
"""

from collections.abc import Sequence

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import AxisPhase, EndCause, StageAxis
from sim.shrc203.drive import PathGenerator
from sim.shrc203.entries import ArcMove, AxisBuffers, Entry, InputStandby, TimedStandby
from sim.shrc203.inputs import InputScanner
from sim.shrc203.launch import start_entry
from sim.shrc203.line import Reply
from sim.shrc203.options import Shrc203Options

_TENTH_NS = NS_PER_S // 10


class DoubleBuffer:
    """Both buffers of every axis, and the operations started from them."""

    def __init__(
        self,
        axes: Sequence[StageAxis],
        time: DeviceTime,
        drive: PathGenerator,
        inputs: InputScanner,
        options: Shrc203Options,
    ) -> None:
        self._axes = axes
        self._time = time
        self._drive = drive
        self._inputs = inputs
        self._options = options
        self.buffers = {axis: AxisBuffers() for axis in axes}

    # Setting

    def set_execution(self, entry: Entry) -> None:
        """Write the execution buffer (M, A, E, K, J); the last value wins (decision 22)."""
        for axis in entry.axes:
            self.clear_execution(axis)
            buffers = self.buffers[axis]
            buffers.execution, buffers.executed = entry, False

    def set_pre(self, entry: Entry) -> None:
        """Write or overwrite the prebuffer (L201-L203); never refused, never reported (decision 23)."""
        for axis in entry.axes:
            buffers = self.buffers[axis]
            if buffers.pre is not None:
                self._forget_entry(buffers.pre)
            buffers.pre = entry
        # An interpolation that has just lost an axis may have blocked another one.
        for axis in self._axes:
            if axis.phase is AxisPhase.AWAITING and axis.timer is None:
                self._try_start(axis, self._time.now_ns())

    def clear_execution(self, axis: StageAxis) -> None:
        """Delete the execution buffer's value (GC:); an interpolation is deleted on all its axes."""
        entry = self.buffers[axis].execution
        if entry is not None:
            self._forget_entry(entry)

    def is_deferred(self, axes: Sequence[StageAxis]) -> bool:
        """Return whether an operation started from the double buffer is running: prebuffer replies are OK_D (L235)."""
        return any(
            axis.phase is AxisPhase.AWAITING or (operation is not None and operation.from_pre)
            for axis, operation in ((axis, self.buffers[axis].operation) for axis in axes)
        )

    # Starting

    def start_operations(self, axes: Sequence[StageAxis], reply: Reply) -> bool:
        """G: execute the buffered operations of the addressed axes. False when there are none (decision 21)."""
        chosen_axes: list[StageAxis] = []
        for axis in axes:
            buffers = self.buffers[axis]
            if self._options.repeat_executed and buffers.execution is not None and buffers.pre is None:
                buffers.executed = False
            entry = self._next_entry(axis)
            if entry is None:
                continue
            lettered_axes = entry.plane if isinstance(entry, ArcMove) else entry.axes
            members = entry.axes
            if all(member in axes for member in lettered_axes) and all(m.excited and not m.is_busy for m in members):
                chosen_axes.extend(member for member in members if member not in chosen_axes)
        for axis in chosen_axes:
            axis.phase, axis.reply = AxisPhase.AWAITING, reply
        now_ns = self._time.now_ns()
        for axis in chosen_axes:
            self._try_start(axis, now_ns)
        return bool(chosen_axes)

    def _next_entry(self, axis: StageAxis) -> Entry | None:
        """Return the operation that would run next: the execution buffer first, then the prebuffer (decision 19)."""
        buffers = self.buffers[axis]
        return buffers.execution if buffers.execution is not None and not buffers.executed else buffers.pre

    def _migrate_entry(self, axis: StageAxis) -> None:
        buffers = self.buffers[axis]
        if buffers.pre is not None and (buffers.execution is None or buffers.executed):
            buffers.execution, buffers.executed, buffers.pre = buffers.pre, False, None

    def _try_start(self, axis: StageAxis, at_ns: int) -> None:
        if axis.phase is not AxisPhase.AWAITING:
            return
        entry = self._next_entry(axis)
        if entry is None:
            axis.phase = AxisPhase.IDLE
            return
        for member in entry.axes:
            is_busy = member.is_busy and not (member.phase is AxisPhase.AWAITING and member.timer is None)
            if is_busy or self._next_entry(member) is not entry:
                return
        for member in entry.axes:
            self._migrate_entry(member)
            buffers = self.buffers[member]
            buffers.executed, buffers.operation = True, entry
            member.reply = member.reply or axis.reply
        if isinstance(entry, TimedStandby | InputStandby):
            self._stand_by(entry, at_ns)
            return
        if not all(member.excited for member in entry.axes):
            for member in entry.axes:
                member.phase, self.buffers[member].operation = AxisPhase.IDLE, None
                self._discard_entries(member)
            return
        start_entry(
            self._drive, entry, at_ns, lambda _, ready_ns, cause: self._handle_completion(entry, ready_ns, cause)
        )

    def _handle_completion(self, entry: Entry, at_ns: int, cause: EndCause) -> None:
        has_ended = cause is EndCause.END
        for axis in entry.axes:
            self.buffers[axis].operation = None
            if not has_ended:
                self._discard_entries(axis)
        speaks = entry.from_pre and (
            has_ended
            or (
                self._options.completion_after_stop and cause in (EndCause.STOPPED, EndCause.LIMIT, EndCause.SOFT_LIMIT)
            )
        )
        going_on = [axis for axis in entry.axes if self._migrate_and_notify(axis, speaks=speaks, ended=has_ended)]
        handover_ns = round(self._options.handover_ms * NS_PER_MS)
        for axis in (axis for axis in going_on if axis.phase is AxisPhase.AWAITING):
            self._start_later(axis, at_ns + handover_ns)
        if has_ended:
            self._wake_waiting(at_ns)
        else:
            self._free_orphans()

    def _migrate_and_notify(self, axis: StageAxis, *, speaks: bool, ended: bool) -> bool:
        """Migrate, empty the prebuffer, send the character (L177); return whether an operation is to start."""
        # After a stop no operation starts by itself, even if the prebuffer survives (decision 17).
        going_on = ended and self.buffers[axis].pre is not None
        if going_on:
            self._migrate_entry(axis)
            axis.phase = AxisPhase.AWAITING
        if speaks and axis.reply is not None:
            axis.reply(axis.name)
        return going_on

    def _start_later(self, axis: StageAxis, at_ns: int) -> None:
        def start_migrated() -> None:
            axis.timer = None
            self._try_start(axis, at_ns)

        if at_ns <= self._time.now_ns():
            self._try_start(axis, at_ns)
        else:
            axis.timer = self._time.call_at(at_ns, start_migrated)

    def _wake_waiting(self, at_ns: int) -> None:
        """Start interpolations that waited for an axis that is now free."""
        for axis in self._axes:
            if axis.phase is AxisPhase.AWAITING and axis.timer is None:
                self._try_start(axis, at_ns)

    def _free_orphans(self) -> None:
        """Free axes that waited for an interpolation that no longer exists."""
        for axis in self._axes:
            if axis.phase is AxisPhase.AWAITING and self._next_entry(axis) is None:
                self._cancel_waits(axis)
                axis.phase = AxisPhase.IDLE

    # Standby

    def _stand_by(self, entry: TimedStandby | InputStandby, at_ns: int) -> None:
        axis = entry.axis
        axis.phase = AxisPhase.STANDBY
        if isinstance(entry, TimedStandby):
            end_ns = at_ns + entry.tenths * _TENTH_NS

            def finish_standby() -> None:
                axis.timer = None
                self._finish_standby(axis, end_ns)

            axis.timer = self._time.call_at(end_ns, finish_standby)
        else:
            self._inputs.wait_for_pattern(
                axis, entry.pattern, lambda released_ns: self._finish_standby(axis, released_ns)
            )

    def cancel_standby(self, axis: StageAxis, kind: type[TimedStandby] | type[InputStandby]) -> None:
        """Execute WT:a,0, WT:a,C, WI:a,C: end the standby; the content of the prebuffer is executed at once (L215,
        L219)."""
        if axis.phase is AxisPhase.STANDBY and isinstance(self.buffers[axis].execution, kind):
            self._cancel_waits(axis)
            self._finish_standby(axis, self._time.now_ns())

    def _finish_standby(self, axis: StageAxis, at_ns: int) -> None:
        axis.phase, self.buffers[axis].operation = AxisPhase.IDLE, None
        if self._migrate_and_notify(axis, speaks=self._options.standby_completion, ended=True):
            self._try_start(axis, at_ns)
        self._wake_waiting(at_ns)

    # Stopping

    def stop_axis(self, axis: StageAxis) -> None:
        """L: on one axis (L2955, decision 17)."""
        if axis.run is not None:
            self._drive.stop_run(axis.run)
        elif axis.is_busy:
            self._cancel_waits(axis)
            axis.phase, self.buffers[axis].operation = AxisPhase.IDLE, None
            self._discard_entries(axis)
            self._free_orphans()

    def abort_axis(self, axis: StageAxis, cause: EndCause) -> None:
        """Stop dead and discard the whole state of this axis, without a reply (L:E, errors, power)."""
        self._cancel_waits(axis)
        if axis.run is not None:
            self._drive.halt_run(axis.run, cause)
        axis.phase, self.buffers[axis].operation = AxisPhase.IDLE, None
        self._discard_entries(axis)

    def clear_axis(self, axis: StageAxis) -> None:
        """Empty both buffers and end everything; for power-down."""
        self._cancel_waits(axis)
        if axis.run is not None:
            self._drive.discard_run(axis.run)
        axis.phase = AxisPhase.IDLE
        self.buffers[axis], axis.reply = AxisBuffers(), None

    def _cancel_waits(self, axis: StageAxis) -> None:
        self._inputs.cancel_wait(axis)
        if axis.timer is not None:
            axis.timer.cancel()
            axis.timer = None

    def _discard_entries(self, axis: StageAxis) -> None:
        self.clear_execution(axis)
        entry = self.buffers[axis].pre
        if entry is not None and not self._options.stop_keeps_prebuffer:
            self._forget_entry(entry)

    def _forget_entry(self, entry: Entry) -> None:
        for axis in entry.axes:
            buffers = self.buffers[axis]
            if buffers.execution is entry and not axis.run:
                buffers.execution, buffers.executed = None, False
            if buffers.pre is entry:
                buffers.pre = None
