"""A started move, followed to its end by its completion lines and by queries."""

from collections.abc import Callable

from adapters.contract import MoveOutcome
from adapters.shrc203.ending import ShrcEndTimes
from adapters.shrc203.loaded import ArmedMove
from adapters.shrc203.lowering import ShrcAxisMove, ShrcLowered
from adapters.shrc203.timing import ShrcTiming
from adapters.shrc203.timing import make_timing as timing_of
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import STATUS, parse_status
from adapters.shrc203.wire.session import COMPLETION_LATE_NS, ShrcSession
from adapters.shrc203.wire.status import ERRORS, UNSETTLED, stop_reason
from adapters.toolkit.host_start import MoverTools, moved_outcome, resting_intervals
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal

_POLL_NS = 50 * NS_PER_MS


class ShrcFollower:
    """Follow the started moves of one connection. settle_ns: how long axes may stay BUSY after their end."""

    def __init__(self, tools: MoverTools, unit: ShrcState, settle_ns: int) -> None:
        self._clock = tools.clock
        self._unit = unit
        self._end_times = ShrcEndTimes(unit.session, tools.clock, tools.crystal)
        self._settle_ns = settle_ns

    @property
    def _session(self) -> ShrcSession:
        return self._unit.session

    async def follow_to_end(self, move: ArmedMove, unloaded: str, forget_move: Callable[[], None]) -> MoveOutcome:
        """Return how a started move ended. unloaded: why its follow-up move does not run, or "". forget_move: called
        when the axes are at rest."""
        timing = self._unit.timing = timing_of(move.lowered, move.start, self._unit.closed_loop, self._session)
        try:
            return await self._follow_axes(move, timing, unloaded, forget_move)
        finally:
            self._unit.timing = None

    async def _follow_axes(
        self, move: ArmedMove, timing: ShrcTiming | None, unloaded: str, forget_move: Callable[[], None]
    ) -> MoveOutcome:
        session = self._session
        await self._wait_for_completions(move, timing)
        rest_ns = await self._wait_for_rest(move, self._clock.now_ns() + self._settle_ns)
        completions_ns = dict(session.completions.completed)
        session.completions.expect_none()
        if timing is not None and not unloaded:
            self._end_times.learn_crystal(move, timing, completions_ns.get(timing.axis.motor), rest_ns)
        end_spans = resting_intervals(move.lowered.durations_s, move.t0_ns)
        for axis_move in move.lowered.moves:
            has_arrived = move.seen[axis_move.motor].counts == axis_move.end_counts
            # The input wait may send a completion line of its own: then only the query counts.
            said_ns = None if move.waits_for_input else completions_ns.get(axis_move.motor)
            end_spans[axis_move.name] = self._end_times.end_interval(
                move, axis_move, said_ns, rest_ns, arrived=has_arrived
            )
        reasons, has_failed = self._evaluate_end(move)
        wrong = await move.output.wait_until_passive() if move.output is not None else ""
        reasons = [reason for reason in (unloaded, *reasons, wrong) if reason]
        has_failed = has_failed or bool(unloaded) or bool(wrong)
        forget_move()
        if reasons:
            if any(state.word & ERRORS for state in move.seen.values()):
                self._unit.untidy = True  # in an emergency stop nothing can be overwritten, and nothing starts
            else:
                await self._unit.make_harmless()
        return moved_outcome(end_spans, reasons, stopped=move.stopped_ns is not None, failed=has_failed)

    async def _wait_for_completions(self, move: ArmedMove, timing: ShrcTiming | None) -> None:
        """Wait for the completion lines; query the controller when they do not arrive, or after a stop."""
        session = self._session
        look_ns = move.start.latest_ns + max(
            self._end_times.duration_bounds_ns(axis_move)[1] for axis_move in move.lowered.moves
        )
        look_ns += COMPLETION_LATE_NS
        give_up_ns = look_ns + self._settle_ns
        self._discard_early_completions(move)
        if timing is not None:
            await self._end_times.observe_end(move, timing)
        while session.completions.expected:
            await session.wait_changed(look_ns)
            self._discard_early_completions(move)
            if session.completions.expected and (move.stopped_ns is not None or await self._is_at_rest(move)):
                break
            if self._clock.now_ns() > give_up_ns:
                break
            look_ns = max(look_ns, self._clock.now_ns() + _POLL_NS)

    def _evaluate_end(self, move: ArmedMove) -> tuple[list[str], bool]:
        """Return the failures at the end, and whether they are more than a requested stop."""
        reasons: list[str] = []
        has_failed = False
        for axis_move in move.lowered.moves:
            state = move.seen[axis_move.motor]
            if state.is_busy:
                has_failed = True
                failure = (
                    "does not settle in its in-position range" if state.word & UNSETTLED else "does not come to rest"
                )
                reasons.append(f"axis {axis_move.name} {failure}")
            has_failed = has_failed or bool(state.word & ERRORS)
            if state.counts != axis_move.end_counts or state.word & ERRORS:
                reasons.append(stop_reason(axis_move.name, state) or stray_text(axis_move, state.counts))
        return reasons, has_failed

    def _discard_early_completions(self, move: ArmedMove) -> None:
        """Discard completion lines that come before the move can have ended: the input wait sent them."""
        if not move.waits_for_input:
            return
        for axis_move in move.lowered.moves:
            ended_ns = move.start.earliest_ns + self._end_times.duration_bounds_ns(axis_move)[0]
            if self._session.completions.completed.get(axis_move.motor, ended_ns) < ended_ns:
                self._session.completions.expect_again(axis_move.motor)

    async def _is_at_rest(self, move: ArmedMove) -> bool:
        line = await self._session.query_line("Q:SPC", STATUS)
        states = parse_status(line.text, self._unit.controllable)
        move.seen = states
        return not any(states[motor].is_busy for motor in move.motor_numbers)

    async def _wait_for_rest(self, move: ArmedMove, until_ns: int) -> int:
        """Wait until all axes of the move are READY, or until that instant; return the instant of the last query."""
        while not await self._is_at_rest(move) and self._clock.now_ns() < until_ns:
            await sleep_ns(self._clock, _POLL_NS)
        return self._clock.now_ns()


_TRIES = 2  # a command that was garbled in transit is overwritten by a repetition


async def load_followup_moves(unit: ShrcState, move: ArmedMove) -> str:
    """Load the follow-up moves of a step and read them back; return why they will not run as planned, "" if they will,
    or if the step is stopped meanwhile."""

    def check_not_stopped() -> None:
        if move.stopped_ns is not None:
            raise Refusal("stopped", "stopped before its follow-up move was loaded", "")

    wrong = await _try_followup_moves(unit, move.lowered, check_not_stopped)
    return "" if move.stopped_ns is not None else wrong


async def _try_followup_moves(unit: ShrcState, lowered: ShrcLowered, before_send: Callable[[], None]) -> str:
    wrong = ""
    for _ in range(_TRIES):
        try:
            reply = await unit.session.set_and_echo(lowered.load_followup, before_send)
        except (Refusal, ControllerFault) as error:
            wrong = str(error)
            continue
        if reply == lowered.load_followup:
            break
        wrong = f"sent {lowered.load_followup!r}, the controller has understood {reply!r}"
    else:
        return f"the follow-up move could not be loaded: {wrong}"
    states = parse_status(await unit.session.send_query("Q:SPC", STATUS), unit.controllable)
    for axis_move in lowered.moves:
        if len(axis_move.executed_moves) > 1 and not states[axis_move.motor].is_busy:
            return stop_reason(axis_move.name, states[axis_move.motor]) or stray_text(
                axis_move, states[axis_move.motor].counts
            )
    return ""


def stray_text(axis: ShrcAxisMove, counts: int) -> str:
    """Return why an axis is not at its target, judged by its position."""
    _, *more = axis.executed_moves
    if more and counts == more[0].start_counts:
        return f"axis {axis.name} is at {counts}, between its two moves: the follow-up move came too late"
    return f"axis {axis.name} is at {counts}, not at its target"
