"""The start of a move, by the controller's own evidence."""

from collections.abc import Callable

from adapters.contract import HostInterval, WriteResult
from adapters.shrc203.loaded import ArmedMove
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import REFUSALS, STATUS, parse_entries, parse_status, pulse_list
from adapters.shrc203.wire.reply_queue import EOL, ShrcPending
from adapters.shrc203.wire.session import ShrcSession
from adapters.toolkit.wired_points import WiredInput
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock
from orchestrator.model.errors import ControllerFault

_QUIET_NS = 60 * NS_PER_MS  # no exchange begins this shortly before T0
_OK_CHARACTERS = len("OK\r\n")


class ShrcStarts:
    """Starts of the moves of one connection. drop_move: drops the move, which will not start."""

    def __init__(self, options: ShrcOptions, clock: Clock, unit: ShrcState, drop_move: Callable[[], None]) -> None:
        self._options = options
        self._clock = clock
        self._unit = unit
        self._drop_move = drop_move

    @property
    def _session(self) -> ShrcSession:
        return self._unit.session

    async def host_start(self, move: ArmedMove, fired: WriteResult, pending: ShrcPending) -> HostInterval:
        """Return when the starting command has started the axes."""
        earliest_ns = fired.written_ns + self._session.wire_ns(len(move.lowered.start) + len(EOL))
        try:
            line = await pending.answer.future
        except ControllerFault as error:
            self._session.log.warning(f"the start is verified by other evidence: {error.text}")
            latest_ns = await self._wait_for_motion(move, error)
        else:
            if line.text in REFUSALS:
                self._session.completions.expect_none()
                raise ControllerFault(
                    "not-started", f"the controller answered NG to {move.lowered.start!r}", "see its display"
                )
            latest_ns = move.answered_ns = line.at_ns - self._session.wire_ns(_OK_CHARACTERS)
        latest_ns += self._options.start_after_ok_us * NS_PER_US
        return HostInterval(min(earliest_ns, latest_ns), latest_ns, late_ns=self._options.excess_delay_ns(fired))

    async def line_start(self, move: ArmedMove, wait: WiredInput) -> HostInterval:
        """Return when the input has started the axes: within the window of the terms, and between the last query that
        found the move in its prebuffer and the reply that no longer did."""
        earliest_ns, latest_ns = (move.t0_ns + limit_ns for limit_ns in move.lowered.window_ns)
        if self._clock.now_ns() < move.t0_ns - _QUIET_NS and not await self._is_loaded(move):
            self._drop_move()
            await self._require_not_restarted()
            raise ControllerFault(
                "not-started",
                f"the axes are moving before T0: input {wait.name} became active too early",
                "find the source of its signal",
            )
        while True:
            while (now_ns := self._clock.now_ns()) < latest_ns:
                await self._session.wait_changed(latest_ns)
                self._require_no_stop(move)
            line = await self._session.query_line("?:MPW", pulse_list(len(self._unit.controllable)))
            self._require_no_stop(move)
            distances = dict(zip(self._unit.controllable, parse_entries(line.text), strict=True))
            waiting_moves = [
                first_move
                for first_move in move.lowered.first_moves
                if distances[first_move.motor] == first_move.distance
            ]
            if not waiting_moves:
                seen_ns = line.at_ns - self._session.wire_ns(len(line.text + EOL))
                await self._require_not_restarted()
                self._unit.waiting = {}
                return HostInterval(earliest_ns, max(earliest_ns, min(latest_ns, seen_ns)))
            earliest_ns = max(earliest_ns, now_ns)
            if earliest_ns > latest_ns:
                self._drop_move()
                raise ControllerFault(
                    "not-started",
                    f"axis {waiting_moves[0].name} still waits: input {wait.name} (IN{wait.number}) was not active "
                    f"by {wait.latest_ns / 1e6:g} ms after T0",
                    "check the trigger wiring, `active` in the fleet file, and that no other input has changed",
                )

    def _require_no_stop(self, move: ArmedMove) -> None:
        if move.stopped_ns is not None:
            self._drop_move()
            raise ControllerFault("not-started", "stopped while it waited for its trigger line", "")

    async def _is_loaded(self, move: ArmedMove) -> bool:
        distances = await self._unit.prebuffers.read_moves()
        return all(distances[first_move.motor] == first_move.distance for first_move in move.lowered.first_moves)

    async def _wait_for_motion(self, move: ArmedMove, error: ControllerFault) -> int:
        """Return when the axes moved, by other evidence: the reply to the starting command was lost."""
        if self._session.completions.completed:
            return min(self._session.completions.completed.values())
        line = await self._session.query_line("Q:SPC", STATUS)
        states = parse_status(line.text, self._unit.controllable)
        if all(
            states[axis_move.motor].is_busy or states[axis_move.motor].counts != axis_move.start_counts
            for axis_move in move.lowered.moves
        ):
            await self._require_not_restarted()
            return line.at_ns
        raise ControllerFault("not-started", f"the axes do not move ({error.text})", error.remedy)

    async def _require_not_restarted(self) -> None:
        """Check for a restart: a controller that was power-cycled has also lost its move, and its present position
        reads 0."""
        if await self._unit.is_restarted():
            raise ControllerFault("not-started", "the controller restarted before its start", "home it, and try again")
