"""One move of a controller: loaded, checked, started by one command at an instant or by an input, followed to its
end."""

from collections.abc import Generator, Mapping
from contextlib import contextmanager

from adapters.contract import HostInterval, LoadPlace, MoveOutcome
from adapters.ppsmc import loading
from adapters.ppsmc.ending import PpSmcEndTimes
from adapters.ppsmc.lowering import PpSmcLowered
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.output import PpSmcOutput
from adapters.ppsmc.replies import (
    ASK_INPUTS,
    ASK_OUTPUTS,
    ASK_POSITIONS,
    ASK_PROGRAM,
    ASK_STATUS,
    ASK_TARGETS,
)
from adapters.ppsmc.session import as_refusal
from adapters.ppsmc.start_write import PpSmcStartWrite
from adapters.ppsmc.starting import PpSmcStarts
from adapters.ppsmc.step import LoadedMove
from adapters.ppsmc.unitstate import PpSmcState
from adapters.toolkit.driven_output import DrivenOutput
from adapters.toolkit.host_start import (
    MoverTools,
    moving_intervals,
    unmoved_outcome,
)
from adapters.toolkit.wired_points import WiredInput
from orchestrator.model.errors import LATE_REMEDY, ControllerFault, Refusal


@contextmanager
def _blocked_as_refusal() -> Generator[None]:
    """A blocked controller refuses; it has no fault."""
    try:
        yield
    except ControllerFault as error:
        if error.code == "blocked":
            raise as_refusal(error) from None
        raise


class PpSmcMover:
    """Arm, start and follow the moves of one connection. settle_ns: how long axes may move after their planned end."""

    def __init__(self, options: PpSmcOptions, tools: MoverTools, unit: PpSmcState, settle_ns: int) -> None:
        self._options = options
        self._clock = tools.clock
        self._unit = unit
        self._session = unit.session
        self._start_write = PpSmcStartWrite(options, tools, unit.session)
        self._starts = PpSmcStarts(options, tools.clock, unit)
        self._end_times = PpSmcEndTimes(options, tools, unit, settle_ns)
        self._output: DrivenOutput[PpSmcOutput] | None = None  # the last output that a step drove
        self.move: LoadedMove | None = None

    # Before the start

    async def load_move(self, lowered: PpSmcLowered, t0_ns: int) -> Mapping[str, int]:
        """Load speeds and targets, or a program, and read everything back. Raises `Refusal`."""
        return await self._load(lowered, t0_ns, "at rest")

    async def load_behind(self, lowered: PpSmcLowered, t0_ns: int, *, at_once: bool) -> Mapping[str, int]:
        """The same right behind a move that was seen at rest: the next check, or at once loading, reads again."""
        if lowered.wait is not None or lowered.drive is not None or lowered.by_program:
            return await self.load_move(lowered, t0_ns)
        return await self._load(lowered, t0_ns, "at once" if at_once else "behind")

    async def _load(self, lowered: PpSmcLowered, t0_ns: int, place: LoadPlace) -> Mapping[str, int]:
        async with self._unit.loading:
            try:
                with _blocked_as_refusal():
                    return await self._load_and_verify(lowered, t0_ns, place)
            except ControllerFault as error:
                # Its settings are read only at rest (L3977), and another client may have moved it.
                if place != "at rest" and error.code == "garbage" and not (await self._unit.read_state()).is_idle:
                    self.move = None
                    raise Refusal("moving", "an axis of the controller moves", "wait for its end, or stop it") from None
                raise

    async def _load_and_verify(self, lowered: PpSmcLowered, t0_ns: int, place: LoadPlace) -> Mapping[str, int]:
        unit, began_ns = self._unit, self._clock.now_ns()
        if self.move is not None:
            raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
        unit.require_enabled(axis_move.name for axis_move in lowered.moves)
        move = LoadedMove(lowered, t0_ns)
        unit.jogging_motors -= move.motor_numbers
        lock = ["remote"] if self._options.panel == "lock" else []
        if place == "at rest":
            reply = await self._session.send_repeatable(lock, *loading.check_queries(lowered))
            lock = []
            look = loading.require_rest(unit, lowered, reply)
            # Without it `tbg` moves nothing while any switch is active (L2994); axes never move towards an active one.
            move.ignore_limits = look.on_limit
            if lowered.drive is not None:
                move.output = self._output = DrivenOutput(self._clock, PpSmcOutput(unit, lowered.drive))
                move.output.port.check_passive(int(reply.first_text(ASK_OUTPUTS)))
        checked_ns = self._clock.now_ns()
        self.move = move
        if lowered.by_program:
            await loading.load_program(unit, lowered)
        elif lowered.moves:
            queries = loading.check_queries(lowered) if place == "at once" else []
            is_short = place != "at rest" and loading.holds_profiles(unit, lowered, checked_ns)
            options = None if is_short else self._options
            reply = await loading.load_targets(unit, options, lowered, lock, queries)
            if place == "at once":
                move.ignore_limits = loading.require_rest(unit, lowered, reply).on_limit
        if self.move is not move:
            raise Refusal("stopped", "a stop came while arming", "")
        return {"verify": checked_ns - began_ns, "wire": self._clock.now_ns() - checked_ns}

    async def verify_move(self) -> None:
        """Check that the move is still loaded and the axes are where the plan starts. Raises `Refusal`."""
        move = self._require_move()
        lowered_step = move.lowered
        queries = loading.check_queries(lowered_step)
        if lowered_step.by_program:
            queries.append(ASK_PROGRAM)
        elif lowered_step.moves:
            queries.append(ASK_TARGETS)
        with _blocked_as_refusal():
            reply = await self._session.send_queries(*queries)
        look = loading.require_rest(self._unit, lowered_step, reply)
        move.ignore_limits = look.on_limit if move.ignore_limits is None else move.ignore_limits
        if look.on_limit != move.ignore_limits:
            raise Refusal("limit", "a limit switch has changed since the move was armed", "arm it again")
        if move.output is not None:
            move.output.port.check_passive(int(reply.first_text(ASK_OUTPUTS)))
        if lowered_step.by_program:
            loading.require_program(loading.program_lines(self._unit, lowered_step), reply.reply_texts(ASK_PROGRAM))
        elif lowered_step.moves:
            loading.require_targets(self._unit, lowered_step, reply.first_line(ASK_TARGETS))

    async def schedule_start(self, start_tolerance_ns: int, advance_ns: int) -> None:
        """Start the program that waits for the trigger line; schedule the starting command, or the one that switches an
        output, so that it is executed at T0, or up to `start_tolerance_ns` later than guaranteed. Raises `Refusal`."""
        move = self._require_move()
        move.t0_ns -= advance_ns
        if move.lowered.moves and move.lowered.wait is not None:
            await self._begin_wait(move, move.lowered.wait)
        line = ""
        if move.lowered.moves and not move.waits_for_input:
            line = move.start_command
        elif move.output is not None:
            line = move.output.port.on_command
        if line:
            # Outstanding exchanges would be executed before the starting command, and delay it.
            async with self._session.exclusive_lock():
                if self.move is not move:
                    raise Refusal("stopped", "a stop came before the start", "")
                self._start_write.schedule_line(move, line, start_tolerance_ns)
        move.released = True

    async def _begin_wait(self, move: LoadedMove, wait: WiredInput) -> None:
        """Start the waiting program only now: until `go`, no edge starts anything."""
        first_ns = move.t0_ns + move.lowered.window_ns[0]
        if self._clock.now_ns() + 12 * self._unit.slow_ns >= first_ns:
            raise Refusal("late", "the program cannot be started before its trigger edge may come", LATE_REMEDY)
        loading.require_rest(
            self._unit, move.lowered, await self._session.send_queries(*loading.check_queries(move.lowered))
        )
        if self.move is not move:
            raise Refusal("stopped", "a stop came before the start", "")
        move.released = True
        reply = await self._session.send_once((move.start_command,), ASK_STATUS, ASK_POSITIONS, ASK_INPUTS)
        look = self._unit.parse_state(reply.first_line(ASK_STATUS), reply.first_line(ASK_POSITIONS), reply.written_ns)
        if wait.is_active(int(reply.first_text(ASK_INPUTS))) or not all(
            look.is_ready(motor) for motor in move.motor_numbers
        ):
            self._unit.write_stop("q")
            raise Refusal(
                "line-level",
                f"input {wait.name} has become active before T0",
                "find the source of its signal; arm it again",
            )
        if not look.program_runs:
            raise Refusal(
                "not-waiting",
                f"the program does not run after `{move.start_command}`",
                "move all axes of the controller off their limit switches, or set `iel1` there",
            )

    async def unload_move(self) -> None:
        """Cancel the timed write, end a waiting program, and empty the buffers. Never starts a move."""
        move, self.move = self.move, None
        is_written = False
        if move is not None:
            is_written = not self._start_write.cancel_start(move) and move.order is not None
        if move is not None and move.released and (move.waits_for_input or is_written):
            # A waiting program, or a command written this very moment: it ends before anything is unloaded.
            self._unit.write_stop("q")
        async with self._unit.loading:
            if self._output is not None:
                await self._output.make_passive()
            await self.clear_targets_now()

    async def clear_targets(self) -> None:
        """Empty the target buffer after a stop or a move, once no move is loaded or in progress; loading one empties
        it as well."""
        async with self._unit.loading:
            if self._unit.untidy and self.move is None:
                await self.clear_targets_now()

    async def clear_targets_now(self) -> None:
        """Send `tbc`; the controller ignores it while an axis moves, then the next poll repeats it."""
        if self._session.blocked:
            self._unit.untidy = True
            return
        try:
            reply = await self._session.send_repeatable(("tbc",), ASK_STATUS, ASK_POSITIONS)
        except ControllerFault as error:
            if error.code != "blocked":
                raise
            self._unit.untidy = True
            return
        status, positions = reply.first_line(ASK_STATUS), reply.first_line(ASK_POSITIONS)
        self._unit.untidy = not self._unit.parse_state(status, positions, 0).is_idle

    def drop_move(self) -> None:
        """Drop the move: the controller has lost it, or the connection ends."""
        move, self.move = self.move, None
        if move is not None:
            self._start_write.cancel_start(move)
        if self._output is not None:
            self._output.drop_output()
            self._output = None

    def commands_after_stop(self) -> list[str]:
        """Return the commands to send with a stop: they make the output that a step drives passive."""
        move = self.move
        return [move.output.port.off_command] if move is not None and move.output is not None and move.released else []

    def record_stop(self, at_ns: int) -> None:
        """Record a stop that was written at that instant."""
        self._unit.untidy = True
        move = self.move
        if move is None:
            return
        move.stopped_ns = at_ns
        if move.output is not None:
            move.output.drop_output()
        if self._start_write.cancel_start(move) or not move.released:
            self.move = None

    # After the start

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes started, all of them by one command: not earlier than the write plus the shortest
        execution time, and not later than the controller's answer, to a query sent after the command, that they move,
        less the shortest answering time."""
        move = self._require_move()
        try:
            return await self._start_intervals(move)
        except ControllerFault:
            if self.move is move:
                self.move = None  # the caller stops the axes that have started
            raise

    async def _start_intervals(self, move: LoadedMove) -> Mapping[str, HostInterval]:
        write = None if move.order is None else await self._start_write.wait_for_write(move, move.order)
        if move.lowered.moves and move.lowered.wait is not None:
            start = await self._starts.line_start(move, move.lowered.wait)
        elif write is not None and move.lowered.moves and move.pending is not None:
            start = await self._starts.host_start(move, write, move.pending)
        else:
            start = HostInterval(move.t0_ns, move.t0_ns)
        if move.output is not None and move.pending is not None:
            await self._start_write.require_edge(move, move.output.port, move.pending)
        move.started = start
        return moving_intervals(move.lowered.durations_s, start, move.t0_ns)

    async def wait_for_end(self) -> MoveOutcome:
        """Watch the axes until they are at rest. In closed loop they may make further moves after the planned one."""
        move = self._require_move()
        try:
            if not move.lowered.moves or move.started is None:
                wrong = await move.output.wait_until_passive() if move.output is not None else ""
                is_stopped = move.stopped_ns is not None
                return unmoved_outcome(move.lowered.durations_s, move.t0_ns, wrong, stopped=is_stopped)
            return await self._end_times.watch_to_end(move)
        finally:
            if self.move is move:
                self.move = None
                self._unit.untidy = True  # the buffer may keep its targets

    def _require_move(self) -> LoadedMove:
        if self.move is None:
            raise Refusal("not-armed", "no move is loaded", "arm it first")
        return self.move
