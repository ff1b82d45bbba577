"""The timed write that starts a move, or switches its output: scheduled, cancelled, and awaited."""

from adapters.contract import TimedWrite, WriteResult
from adapters.shrc203.loaded import ArmedMove
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.wire.reply_queue import EOL
from adapters.shrc203.wire.session import ShrcSession
from adapters.toolkit.firing import missed_write_fault
from adapters.toolkit.host_start import MoverTools, require_time_left, wait_for_write


class ShrcStartWrite:
    """The timed writes of one connection."""

    def __init__(self, options: ShrcOptions, tools: MoverTools, session: ShrcSession) -> None:
        self._options = options
        self._clock = tools.clock
        self._timed_writer = tools.timed_writer
        self._session = session

    def schedule_lines(self, move: ArmedMove, lines: list[str], start_tolerance_ns: int) -> None:
        """Have these lines written together, so that the move or its edge is at T0. Raises `Refusal`."""
        data = "".join(line + EOL for line in lines).encode()
        at_ns = move.t0_ns - self._session.wire_ns(len(lines[0] + EOL)) - move.lowered.lead_ns
        latest_ns = self._options.latest_write_ns(at_ns, start_tolerance_ns)
        require_time_left(self._clock.now_ns(), at_ns)
        self._session.keep_quiet(latest_ns, at_ns)
        promised_ns = self._options.latest_write_ns(at_ns, 0)
        places = [self._session.replies.expect_reply(line, promised_ns, latest_ns) for line in lines]
        move.order = self._timed_writer.schedule_write(self._session.link, data, at_ns, latest_ns)
        if move.output is not None:
            move.switching = places.pop()
            edge_ns = move.lowered.edge_window_ns[1]
            move.output.follow_write(move.order, move.t0_ns + edge_ns + move.output.port.drive.active_ns)
        move.pending = places[0] if places else None

    def cancel_start(self, move: ArmedMove) -> bool:
        """Cancel the timed write; return whether no axis has started or will start."""
        if move.waits_for_input and move.released:
            self._session.completions.expect_none()
        if move.order is None or not move.order.cancel_write():
            return False
        move.cancelled = True
        for pending in move.expected_replies:
            self._session.replies.remove_expected(pending)
        self._session.end_quiet()
        if not move.waits_for_input:
            self._session.completions.expect_none()
        return not move.waits_for_input

    async def wait_for_write(self, move: ArmedMove, order: TimedWrite) -> WriteResult:
        """Return the write, once it has happened in time. Raises `ControllerFault`."""
        write = await wait_for_write(order, lambda: move.cancelled)
        if write.late:
            for pending in move.expected_replies:
                self._session.replies.remove_expected(pending)
            self._session.completions.expect_none()
            raise missed_write_fault("the starting command", self._session.link, write)
        for pending in move.expected_replies:
            self._session.replies.record_write(pending, write.written_ns)
        self._session.end_quiet()
        return write
