"""The timed write that starts a move, or switches its output: scheduled, cancelled, awaited and proven."""

import asyncio

from adapters.contract import TimedWrite, WriteResult
from adapters.ppsmc.batches import EOL, PendingBatch
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.output import PpSmcOutput
from adapters.ppsmc.replies import ASK_OUTPUTS, ASK_POSITIONS, ASK_STATUS, FormattedQuery
from adapters.ppsmc.session import PpSmcSession
from adapters.ppsmc.step import LoadedMove
from adapters.toolkit.firing import missed_write_fault
from adapters.toolkit.host_start import MoverTools, cancelled_write_fault, require_time_left, wait_for_write
from orchestrator.model.errors import ControllerFault


class PpSmcStartWrite:
    """The timed writes of one connection."""

    def __init__(self, options: PpSmcOptions, tools: MoverTools, session: PpSmcSession) -> None:
        self._options = options
        self._clock = tools.clock
        self._timed_writer = tools.timed_writer
        self._session = session

    def schedule_line(self, move: LoadedMove, line: str, start_tolerance_ns: int) -> None:
        """Have this line written so that it is executed at T0. Raises `Refusal`."""
        at_ns = move.t0_ns - self._session.wire_ns(len(line + EOL)) - move.lowered.lead_ns
        latest_ns = self._options.latest_write_ns(at_ns, start_tolerance_ns)
        require_time_left(self._clock.now_ns(), at_ns)
        queries: list[FormattedQuery] = [ASK_STATUS, ASK_POSITIONS]
        if move.output is not None:
            queries.append(ASK_OUTPUTS)
        self._session.keep_quiet(latest_ns, at_ns)
        move.pending = self._session.batches.expect_batch((line,), queries, latest_ns)
        move.order = self._timed_writer.schedule_write(self._session.link, move.pending.data, at_ns, latest_ns)
        if move.output is not None:
            edge_ns = move.lowered.edge_window_ns[1]
            move.output.follow_write(move.order, move.t0_ns + edge_ns + move.output.port.drive.active_ns)

    def cancel_start(self, move: LoadedMove) -> bool:
        """Cancel the timed write; return whether no axis has started or will start."""
        if move.order is None or not move.order.cancel_write():
            return False
        move.cancelled = True
        if move.pending is not None:
            self._session.batches.remove_expected(move.pending)
            move.pending.answer.set_failure(cancelled_write_fault())
        self._session.end_quiet()
        return not move.waits_for_input

    async def wait_for_write(self, move: LoadedMove, order: TimedWrite) -> WriteResult:
        """Return the write, once it has happened in time. Raises `ControllerFault`."""
        write = await wait_for_write(order, lambda: move.cancelled)
        if write.late:
            if move.pending is not None:
                self._session.batches.remove_expected(move.pending)
            raise missed_write_fault("the starting command", self._session.link, write)
        if move.pending is not None:
            self._session.batches.record_write(move.pending, write.written_ns)
        self._session.end_quiet()
        return write

    async def require_edge(self, move: LoadedMove, output: PpSmcOutput, pending: PendingBatch) -> None:
        """Raise `ControllerFault` when the output was not switched; a lost answer proves nothing."""
        try:
            reply = await asyncio.shield(pending.answer.future)
        except ControllerFault:
            return
        if move.stopped_ns is None:
            output.require_switched(int(reply.first_text(ASK_OUTPUTS)))
