"""The start of a move, by the controller's own evidence."""

import asyncio

from adapters.contract import HostInterval, WriteResult
from adapters.ppsmc.batches import EOL, PendingBatch
from adapters.ppsmc.lowering import PpSmcAxisMove
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.replies import ASK_POSITIONS, ASK_STATUS, StatusBits
from adapters.ppsmc.session import PpSmcSession
from adapters.ppsmc.step import LoadedMove
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from adapters.toolkit.wired_points import WiredInput
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns, sleep_until_ns
from orchestrator.model.errors import ControllerFault

_FAST_POLL_NS = 5 * NS_PER_MS
# Status bits may still read ready for a moment after a start, as observed on real controllers.
_READY_LAG_NS = 500 * NS_PER_MS


class PpSmcStarts:
    """Starts of the moves of one connection."""

    def __init__(self, options: PpSmcOptions, clock: Clock, unit: PpSmcState) -> None:
        self._options = options
        self._clock = clock
        self._unit = unit

    @property
    def _session(self) -> PpSmcSession:
        return self._unit.session

    async def host_start(self, move: LoadedMove, fired: WriteResult, pending: PendingBatch) -> HostInterval:
        """Return when the starting command has started the axes."""
        quick_ns = self._options.decode_ns[0]
        earliest_ns = fired.written_ns + self._session.wire_ns(len(move.start_command) + len(EOL)) + quick_ns
        try:
            reply = await asyncio.shield(pending.answer.future)
        except ControllerFault as error:
            self._session.log.warning(f"the start is verified by other evidence: {error.text}")
            look = await self._unit.read_state()  # the answer was lost, or the controller was blocked after it
            answered_ns = look.at_ns
        else:
            status = reply.first_line(ASK_STATUS)
            look = self._unit.parse_state(status, reply.first_line(ASK_POSITIONS), reply.written_ns)
            answered_ns = status.at_ns
            if not all(self._is_moving(look, axis_move, by_status=True) for axis_move in move.lowered.moves):
                answered_ns = look.at_ns
        give_up_ns = self._clock.now_ns() + _READY_LAG_NS
        while not all(self._is_moving(look, axis_move) for axis_move in move.lowered.moves):
            if move.stopped_ns is not None or self._clock.now_ns() > give_up_ns:
                waiting_move = next(
                    axis_move for axis_move in move.lowered.moves if not self._is_moving(look, axis_move)
                )
                raise self._not_started_fault(move, waiting_move, look)
            await sleep_ns(self._clock, _FAST_POLL_NS)
            look = await self._unit.read_state()
            answered_ns = look.at_ns
        self._require_not_restarted()
        latest_ns = answered_ns - quick_ns + self._options.start_skew_us * NS_PER_US
        return HostInterval(min(earliest_ns, latest_ns), latest_ns, late_ns=self._options.excess_delay_ns(fired))

    def _require_not_restarted(self) -> None:
        """Check for a restart: a controller that was power-cycled reports another position, and is not ready at
        first."""
        if self._session.batches.restarted:
            raise ControllerFault("not-started", "the controller restarted before its start", "home it, and try again")

    @staticmethod
    def _is_moving(look: PpSmcReading, move: PpSmcAxisMove, *, by_status: bool = False) -> bool:
        return not look.is_ready(move.motor) or (not by_status and look.counts[move.motor] != move.start_counts)

    def _not_started_fault(self, move: LoadedMove, axis: PpSmcAxisMove, look: PpSmcReading) -> ControllerFault:
        reason = "it does not move"
        if move.stopped_ns is not None:
            reason = "it was stopped"
        elif look.bits[axis.motor] & (StatusBits.LIMIT_FORWARD | StatusBits.LIMIT_REVERSE):
            reason = "it is on a limit switch"
        return ControllerFault(
            "not-started",
            f"axis {axis.name} has not started after `{move.start_command}`: {reason}",
            "check its limit switches, `emips`, and the messages on the controller's screen",
            axis.name,
        )

    async def line_start(self, move: LoadedMove, wait: WiredInput) -> HostInterval:
        """Return when the input has started the axes: within the window of the terms, and before the controller has
        answered that they move."""
        earliest_ns, latest_ns = (move.t0_ns + limit_ns for limit_ns in move.lowered.window_ns)
        quick_ns = self._options.decode_ns[0]
        early_ns = earliest_ns - 20 * NS_PER_MS - 4 * self._unit.slow_ns
        if self._clock.now_ns() < early_ns:
            await sleep_until_ns(self._clock, early_ns - 2 * self._unit.slow_ns)
            look = await self._unit.read_state()
            if any(self._is_moving(look, axis_move) for axis_move in move.lowered.moves):
                self._require_not_restarted()
                raise ControllerFault(
                    "not-started",
                    f"the axes move before T0: input {wait.name} became active too early",
                    "find the source of its signal",
                )
        await sleep_until_ns(self._clock, max(earliest_ns, self._clock.now_ns()))
        while True:
            look = await self._unit.read_state()
            if move.stopped_ns is not None:
                raise ControllerFault("not-started", "stopped while it waited for its trigger line", "")
            waiting_moves = [axis_move for axis_move in move.lowered.moves if not self._is_moving(look, axis_move)]
            if not waiting_moves:
                self._require_not_restarted()
                # The status was read before the positions, one execution time earlier.
                by_status = all(self._is_moving(look, axis_move, by_status=True) for axis_move in move.lowered.moves)
                seen_ns = look.at_ns - quick_ns if by_status else look.at_ns
                return HostInterval(earliest_ns, max(earliest_ns, min(latest_ns, seen_ns)))
            if look.begun_ns > latest_ns and not (look.bits[waiting_moves[0].motor] & StatusBits.PROGRAM):
                raise self._not_started_fault(move, waiting_moves[0], look)
            if look.begun_ns > latest_ns:
                self._unit.write_stop("q")
                raise ControllerFault(
                    "not-started",
                    f"axis {waiting_moves[0].name} still waits: input {wait.name} (bit {wait.bit}) was not active "
                    f"by {wait.latest_ns / 1e6:g} ms after T0",
                    "check the trigger wiring, and `active` in the fleet file",
                )
            await sleep_ns(self._clock, _FAST_POLL_NS)
