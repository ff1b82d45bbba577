"""Chains of prebuffered moves: each begins by itself when the previous one has ended (L173-L181).

The controller keeps one queued move per axis in addition to the running one, and overwrites it without notice. Loading
is therefore one completion ahead: when the completion line of move n arrives, move n+1 has left the prebuffer and n+2
is written there. Every boundary is a full stop. A load that comes too late finds no running move and is answered `OK`
in place of `OK_D` (L235): this underrun is reported, and the waiting move is started again.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.shrc203.chain_axis import ChainAxis, ChainMove, check_chain, is_answered
from adapters.shrc203.chain_readback import LoadReadback
from adapters.shrc203.fleetaxes import motor_number
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.wire.replies import (
    DONE,
    READY,
    REFUSALS,
    STATUS,
    AxisStatus,
    axis_argument,
    parse_status,
)
from adapters.shrc203.wire.status import ERRORS, stop_reason
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller

_POLL_NS = 50 * NS_PER_MS
_DEFERRED = "OK_D"


@dataclass(frozen=True, slots=True)
class ChainUnderrun:
    """The axis stood still after its first `done` moves, because the next one came too late. at_ns: when that was
    detected."""

    axis: str
    done: int
    at_ns: int


@dataclass(frozen=True, slots=True)
class ChainReport:
    """Result of a chain.

    done: number of completed moves by axis.
    least_ahead_ns: the shortest time from the reply to a load to the end of the move that was running.
    reason: why the chain did not run to its end, "" if it did."""

    done: Mapping[str, int]
    underruns: tuple[ChainUnderrun, ...]
    least_ahead_ns: int | None
    reason: str = ""


class MoveChain:
    """A chain on one connection, whose controller is marked as `chaining` until it has run. report_underrun: called
    with the text of every underrun. clock_ppm: largest error of the controller's crystal."""

    def __init__(
        self,
        config: Controller,
        clock: Clock,
        unit: ShrcState,
        clock_ppm: float,
        report_underrun: Callable[[str], None],
    ) -> None:
        self._config = config
        self._clock = clock
        self._unit = unit
        self._slow = 1 + clock_ppm * 1e-6
        self._report_underrun = report_underrun
        self._axes: dict[int, ChainAxis] = {}
        self._readback = LoadReadback(unit.session, unit.controllable, self._axes, self._halt_chain)
        self._underruns: list[ChainUnderrun] = []
        self._least_ahead_ns: int | None = None
        self._reason = ""
        self._stops: dict[int, int] = {}

    async def run_moves(self, moves: Mapping[str, Sequence[ChainMove]]) -> ChainReport:
        """Run the moves of each axis in sequence, all axes from a common start.

        Raises `Refusal` when no move has begun. A chain that is stopped, or breaks, returns a report with a reason.
        """
        unit = self._unit
        for name in moves:
            number = motor_number(self._config.axes[name])
            self._stops[number] = unit.stops.stop_count(number)
        try:
            async with unit.loading:
                await self._check_ready(moves)
                await self._start_chain()
            await self._follow_chain()
        except BaseException as error:
            if not isinstance(error, Refusal):
                unit.untidy = True
                with suppress(LinkClosed):
                    unit.brake_motors(self._axes)
            raise
        finally:
            unit.session.completions.expect_none()
            unit.chaining = False
        await self._check_end()
        return ChainReport(
            {thread.name: thread.done for thread in self._axes.values()},
            tuple(self._underruns),
            self._least_ahead_ns,
            self._reason,
        )

    # Before the start

    async def _check_ready(self, moves: Mapping[str, Sequence[ChainMove]]) -> None:
        unit, session = self._unit, self._unit.session
        states = parse_status(await session.send_query("Q:SPC", STATUS), unit.controllable)
        for name, axis_moves in moves.items():
            axis = self._config.axes[name]
            number = motor_number(axis)
            if states[number].is_busy:
                raise Refusal("moving", f"axis {name} is moving", "wait for its end, or stop it")
            if states[number].word & ERRORS:
                raise Refusal("fault", stop_reason(name, states[number]), "clear it with `tutti reset`")
            check_chain(name, axis, states[number].counts, axis_moves)
            self._axes[number] = ChainAxis(name, number, states[number].counts, axis_moves)
        unit.jogging_motors -= set(self._axes)
        await unit.make_harmless()
        await session.send_setting(f"GC:{axis_argument(self._axes)}")

    async def _start_chain(self) -> None:
        """Load the first move of every axis, start them by one command, and load the second moves after them."""
        session = self._unit.session
        try:
            for thread in self._axes.values():
                line = thread.next_load_command()
                text = await session.set_and_echo(line)
                if text != line:
                    raise Refusal("load-garbled", f"sent {line!r}, the controller has understood {text!r}", "try again")
            session.completions.expect(set(self._axes), self._handle_completion)
            await session.send_setting(f"G:{axis_argument(self._axes)}", self._require_no_stop)
        except Refusal:
            session.completions.expect_none()
            await self._unit.make_harmless()
            raise
        now_ns = self._clock.now_ns()
        for thread in self._axes.values():
            thread.expect_end(now_ns, self._slow)
            if thread.loaded == 1:  # a completion line may have arrived first
                self._load_next(thread)

    def _require_no_stop(self) -> None:
        for thread in self._axes.values():
            self._unit.stops.require_no_stop(thread.name, thread.motor, self._stops[thread.motor])

    @property
    def _is_stopped(self) -> bool:
        return any(self._unit.stops.stop_count(number) != stop_count for number, stop_count in self._stops.items())

    # During the chain

    def _handle_completion(self, number: int, at_ns: int) -> None:
        """Handle a completion line: its axis has begun the next move, and the prebuffer is free."""
        thread = self._axes[number]
        if thread.has_ended or self._is_stopped:
            return
        thread.done += 1
        self._record_ahead(thread, at_ns)
        thread.expect_end(at_ns, self._slow)
        thread.free = True
        self._continue_loading(thread)

    def _record_ahead(self, thread: ChainAxis, at_ns: int) -> None:
        if thread.has_ended or thread.load is None:
            return
        ahead_ns = at_ns - thread.load.result().at_ns if is_answered(thread.load) else 0
        self._least_ahead_ns = ahead_ns if self._least_ahead_ns is None else min(self._least_ahead_ns, ahead_ns)

    def _load_next(self, thread: ChainAxis) -> None:
        """Write the next move, if there is one, without waiting for anything."""
        thread.free = False
        if thread.loaded < len(thread.moves) and not (self._is_stopped or self._reason):
            thread.command = thread.next_load_command()
            thread.load = self._unit.session.send_command(thread.command, DONE)
            thread.load.add_done_callback(lambda _: self._continue_loading(thread))
            self._readback.query_loads(thread)

    def _halt_chain(self, reason: str) -> None:
        self._break_chain(reason)
        self._unit.brake_motors(self._axes)
        self._unit.session.changed.set()

    def _continue_loading(self, thread: ChainAxis) -> None:
        """Load the next move when the prebuffer is free. This requires a completion line, and that the last load came
        in time: a load without a running move stays in the prebuffer, and must not be overwritten."""
        self._unit.session.changed.set()
        is_taken = thread.load is None or (is_answered(thread.load) and thread.load.result().text == _DEFERRED)
        if is_taken and thread.free:
            self._load_next(thread)

    async def _follow_chain(self) -> None:
        session = self._unit.session
        while not (
            self._reason or self._is_stopped or all(axis_thread.has_ended for axis_thread in self._axes.values())
        ):
            await session.wait_changed(self._clock.now_ns() + _POLL_NS)
            for thread in self._axes.values():
                await self._handle_unusual_reply(thread)
                if not thread.has_ended and self._clock.now_ns() > thread.due_ns:
                    await self._check_overdue(thread)
        if self._is_stopped:
            self._reason = "stopped on request"
        elif self._reason:
            self._unit.brake_motors(self._axes)

    async def _handle_unusual_reply(self, thread: ChainAxis) -> None:
        """Handle an unusual reply to the last load."""
        load = thread.load
        if load is None or not load.done():
            return
        if (error := load.exception()) is not None:
            self._break_chain(f"axis {thread.name}: {error}")
        elif load.result().text in REFUSALS:
            self._break_chain(f"axis {thread.name}: the controller answered NG to {thread.command!r}")
        elif load.result().text != _DEFERRED:
            await self._handle_underrun(thread)

    async def _handle_underrun(self, thread: ChainAxis) -> None:
        """Handle an `OK`: no move was running when the load came. Controllers that always answer so are still busy."""
        if not await self._is_busy(thread):
            await self._restart_load(thread)
        else:
            thread.load = None
            self._continue_loading(thread)

    async def _check_overdue(self, thread: ChainAxis) -> None:
        """Check an overdue completion line: it may have been lost; the position of the axis shows that."""
        if await self._is_busy(thread):
            self._break_chain(f"axis {thread.name} exceeds the longest duration of move {thread.done + 1}")
            return
        state = await self._read_axis(thread)
        done_count = next(
            (n for n in range(thread.done, thread.loaded + 1) if thread.position_after(n) == state.counts), None
        )
        if done_count is None or state.word & ERRORS:
            self._break_chain(thread.stray_text(state))
        elif done_count < thread.loaded:
            self._break_chain(f"axis {thread.name} does not continue, although move {thread.loaded} is loaded")
        else:
            thread.done, thread.free = done_count, True
            thread.expect_end(self._clock.now_ns(), self._slow)
            self._continue_loading(thread)

    async def _restart_load(self, thread: ChainAxis) -> None:
        """Start the last load, if its axis has completed all moves before it."""
        load_number = thread.loaded
        state = await self._read_axis(thread)
        if state.counts != thread.position_after(load_number - 1) or state.word & ERRORS:
            self._break_chain(thread.stray_text(state))
            return
        thread.done = load_number - 1
        self._underruns.append(ChainUnderrun(thread.name, thread.done, self._clock.now_ns()))
        self._report_underrun(
            f"axis {thread.name} ran out of moves after {thread.done} of {len(thread.moves)}: move "
            f"{load_number} came too late; it is started again"
        )
        try:
            await self._unit.session.send_setting(f"G:{thread.motor}", self._require_no_stop)
        except Refusal as error:
            self._break_chain(f"axis {thread.name}: {error}")
            return
        thread.expect_end(self._clock.now_ns(), self._slow)
        thread.load = None
        self._load_next(thread)

    async def _read_axis(self, thread: ChainAxis) -> AxisStatus:
        return parse_status(await self._unit.session.send_query("Q:SPC", STATUS), self._unit.controllable)[thread.motor]

    async def _is_busy(self, thread: ChainAxis) -> bool:
        return await self._unit.session.send_query(f"!:{thread.motor}S", READY) == "B"

    def _break_chain(self, reason: str) -> None:
        self._reason = self._reason or reason

    # After the end

    async def _check_end(self) -> None:
        """Check the final positions of the axes, and that no move is left in the prebuffers."""
        unit = self._unit
        give_up_ns = self._clock.now_ns() + 2 * NS_PER_S
        while True:
            states = parse_status(await unit.session.send_query("Q:SPC", STATUS), unit.controllable)
            if not any(states[number].is_busy for number in self._axes) or self._clock.now_ns() > give_up_ns:
                break
        for number, thread in self._axes.items():
            if not self._reason and states[number].counts != thread.position_after(thread.done):
                self._reason = stop_reason(thread.name, states[number]) or (
                    f"axis {thread.name} is at {states[number].counts}, not at {thread.position_after(thread.done)}"
                )
        if any(states[number].word & ERRORS for number in self._axes):
            unit.untidy = True  # in an emergency stop nothing can be overwritten, and nothing starts
            return
        async with unit.loading:
            await unit.make_harmless()


def require_axes(config: Controller, moves: Mapping[str, Sequence[ChainMove]]) -> None:
    """Raise `Refusal` for an axis that the fleet file does not have, or that has no moves."""
    wrong = [name for name, axis_moves in moves.items() if name not in config.axes or not axis_moves]
    if wrong or not moves:
        raise Refusal(
            "bad-chain",
            f"axis {wrong[0]} is unknown, or has no moves" if wrong else "a chain without axes",
            f"give moves for some of {', '.join(config.axes)}",
        )
