"""The double buffer (chapter 2 of the manual): execution buffer, prebuffer, and what migrates when.

An operation that completes takes the prebuffer's value over into the execution buffer, empties the
prebuffer, sends its completion character, and then starts what has migrated (L177-L179).
"""

from collections.abc import Sequence

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from sim.core.devicetime import DeviceTime
from sim.shrc203.axis import Axis, Phase
from sim.shrc203.drive import Cause, Drive
from sim.shrc203.entries import Arc, Entry, WaitInput, WaitTime
from sim.shrc203.inputs import Inputs
from sim.shrc203.launch import launch
from sim.shrc203.line import Reply
from sim.shrc203.options import Options

_TENTH_NS = NS_PER_S // 10


class Chain:
    """Both buffers of every axis, and the operations started from them."""

    def __init__(self, axes: Sequence[Axis], time: DeviceTime, drive: Drive, inputs: Inputs, options: Options) -> None:
        self._axes = axes
        self._time = time
        self._drive = drive
        self._inputs = inputs
        self._options = options

    # Setting

    def set_execution(self, entry: Entry) -> None:
        """Write the execution buffer (M, A, E, K, J); the last value wins (decision 22)."""
        for axis in entry.axes:
            self.clear_execution(axis)
            axis.execution, axis.executed = entry, False

    def set_pre(self, entry: Entry) -> None:
        """Write or overwrite the prebuffer (L201-L203); never refused, never noticed (decision 23)."""
        for axis in entry.axes:
            if axis.pre is not None:
                self._forget(axis.pre)
            axis.pre = entry
        # An interpolation that has just lost an axis may have been what another one waited for.
        for axis in self._axes:
            if axis.phase is Phase.AWAITING and axis.timer is None:
                self._try_start(axis, self._time.now_ns())

    def clear_execution(self, axis: Axis) -> None:
        """Delete the execution buffer's value (GC:); an interpolation goes on all its axes."""
        if axis.execution is not None:
            self._forget(axis.execution)

    def deferred(self, axes: Sequence[Axis]) -> bool:
        """Whether an operation started from the double buffer is running: prebuffer replies are OK_D (L235)."""
        return any(
            axis.phase is Phase.AWAITING or (axis.operation is not None and axis.operation.from_pre) for axis in axes
        )

    # Starting

    def start(self, axes: Sequence[Axis], reply: Reply) -> bool:
        """G: execute what is set on the addressed axes. False when there is nothing (decision 21)."""
        chosen: list[Axis] = []
        for axis in axes:
            if self._options.repeat_executed and axis.execution is not None and axis.pre is None:
                axis.executed = False
            entry = self._next(axis)
            if entry is None:
                continue
            lettered = entry.plane if isinstance(entry, Arc) else entry.axes
            members = entry.axes
            if all(member in axes for member in lettered) and all(m.excited and not m.busy for m in members):
                chosen.extend(member for member in members if member not in chosen)
        for axis in chosen:
            axis.phase, axis.reply = Phase.AWAITING, reply
        now_ns = self._time.now_ns()
        for axis in chosen:
            self._try_start(axis, now_ns)
        return bool(chosen)

    def _next(self, axis: Axis) -> Entry | None:
        """What would run next: the execution buffer first, then the prebuffer (decision 19)."""
        return axis.execution if axis.execution is not None and not axis.executed else axis.pre

    def _migrate(self, axis: Axis) -> None:
        if axis.pre is not None and (axis.execution is None or axis.executed):
            axis.execution, axis.executed, axis.pre = axis.pre, False, None

    def _try_start(self, axis: Axis, at_ns: int) -> None:
        if axis.phase is not Phase.AWAITING:
            return
        entry = self._next(axis)
        if entry is None:
            axis.phase = Phase.IDLE
            return
        for member in entry.axes:
            taken = member.busy and not (member.phase is Phase.AWAITING and member.timer is None)
            if taken or self._next(member) is not entry:
                return
        for member in entry.axes:
            self._migrate(member)
            member.executed, member.operation = True, entry
            member.reply = member.reply or axis.reply
        if isinstance(entry, WaitTime | WaitInput):
            self._stand_by(entry, at_ns)
            return
        if not all(member.excited for member in entry.axes):
            for member in entry.axes:
                member.phase, member.operation = Phase.IDLE, None
                self._discard(member)
            return
        launch(self._drive, entry, at_ns, lambda _, ready_ns, cause: self._completed(entry, ready_ns, cause))

    def _completed(self, entry: Entry, at_ns: int, cause: Cause) -> None:
        ended = cause is Cause.END
        for axis in entry.axes:
            axis.operation = None
            if not ended:
                self._discard(axis)
        speaks = entry.from_pre and (
            ended or (self._options.completion_after_stop and cause in (Cause.STOPPED, Cause.LIMIT, Cause.SOFT_LIMIT))
        )
        going_on = [axis for axis in entry.axes if self._hand_over(axis, speaks, ended)]
        handover_ns = round(self._options.handover_ms * NS_PER_MS)
        for axis in (axis for axis in going_on if axis.phase is Phase.AWAITING):
            self._start_later(axis, at_ns + handover_ns)
        if ended:
            self._wake_waiting(at_ns)
        else:
            self._release_orphans()

    def _hand_over(self, axis: Axis, speaks: bool, ended: bool) -> bool:
        """Migrate, empty the prebuffer, send the character (L177); whether something is to start."""
        # After a stop nothing goes on by itself, even if the prebuffer survives (decision 17).
        going_on = ended and axis.pre is not None
        if going_on:
            self._migrate(axis)
            axis.phase = Phase.AWAITING
        if speaks and axis.reply is not None:
            axis.reply(axis.name)
        return going_on

    def _start_later(self, axis: Axis, at_ns: int) -> None:
        def go() -> None:
            axis.timer = None
            self._try_start(axis, at_ns)

        if at_ns <= self._time.now_ns():
            self._try_start(axis, at_ns)
        else:
            axis.timer = self._time.call_at(at_ns, go)

    def _wake_waiting(self, at_ns: int) -> None:
        """Interpolations that waited for an axis now free."""
        for axis in self._axes:
            if axis.phase is Phase.AWAITING and axis.timer is None:
                self._try_start(axis, at_ns)

    def _release_orphans(self) -> None:
        """Axes that waited for an interpolation that is gone."""
        for axis in self._axes:
            if axis.phase is Phase.AWAITING and self._next(axis) is None:
                self._end_waits(axis)
                axis.phase = Phase.IDLE

    # Standby

    def _stand_by(self, entry: WaitTime | WaitInput, at_ns: int) -> None:
        axis = entry.axis
        axis.phase = Phase.STANDBY
        if isinstance(entry, WaitTime):
            end_ns = at_ns + entry.tenths * _TENTH_NS

            def over() -> None:
                axis.timer = None
                self._stand_by_over(axis, end_ns)

            axis.timer = self._time.call_at(end_ns, over)
        else:
            self._inputs.wait(axis, entry.pattern, lambda released_ns: self._stand_by_over(axis, released_ns))

    def cancel_standby(self, axis: Axis, kind: type[WaitTime] | type[WaitInput]) -> None:
        """WT:a,0, WT:a,C, WI:a,C: release; what is in the prebuffer is executed at once (L215, L219)."""
        if axis.phase is Phase.STANDBY and isinstance(axis.execution, kind):
            self._end_waits(axis)
            self._stand_by_over(axis, self._time.now_ns())

    def _stand_by_over(self, axis: Axis, at_ns: int) -> None:
        axis.phase, axis.operation = Phase.IDLE, None
        if self._hand_over(axis, self._options.standby_completion, True):
            self._try_start(axis, at_ns)
        self._wake_waiting(at_ns)

    # Stopping

    def stop(self, axis: Axis) -> None:
        """L: on one axis (L2955, decision 17)."""
        if axis.run is not None:
            self._drive.stop(axis.run)
        elif axis.busy:
            self._end_waits(axis)
            axis.phase, axis.operation = Phase.IDLE, None
            self._discard(axis)
            self._release_orphans()

    def abort(self, axis: Axis, cause: Cause) -> None:
        """Stop dead and forget everything on this axis, without a word (L:E, errors, power)."""
        self._end_waits(axis)
        if axis.run is not None:
            self._drive.halt(axis.run, cause)
        axis.phase, axis.operation = Phase.IDLE, None
        self._discard(axis)

    def clear(self, axis: Axis) -> None:
        """Both buffers empty, nothing runs; for power-down."""
        self._end_waits(axis)
        if axis.run is not None:
            self._drive.drop(axis.run)
        axis.phase = Phase.IDLE
        axis.execution, axis.executed, axis.pre = None, False, None
        axis.operation, axis.reply = None, None

    def _end_waits(self, axis: Axis) -> None:
        self._inputs.forget(axis)
        if axis.timer is not None:
            axis.timer.cancel()
            axis.timer = None

    def _discard(self, axis: Axis) -> None:
        self.clear_execution(axis)
        if axis.pre is not None and not self._options.stop_keeps_prebuffer:
            self._forget(axis.pre)

    def _forget(self, entry: Entry) -> None:
        for axis in entry.axes:
            if axis.execution is entry and not axis.run:
                axis.execution, axis.executed = None, False
            if axis.pre is entry:
                axis.pre = None
