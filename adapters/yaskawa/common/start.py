"""A start at a sample: loaded, released at the gate, watched, and reported by the program's own evidence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from adapters.contract import ChunkFit, HostInterval, MoveOutcome, PathChunk
from adapters.yaskawa.common.course_records import BegunPath, ChunkRecords
from adapters.yaskawa.common.course_refill import ContourRefill
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.lines import OutputPlayer
from adapters.yaskawa.common.loads import CourseLoad, SamplePlace, YaskawaAxisMove, YaskawaLowered
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import (
    BEGIN_VARIABLE,
    EDGE_THREAD,
    REGISTER_VARIABLES,
    STEP_THREAD,
    WATCHDOG_THREAD,
    following_label,
)
from adapters.yaskawa.common.record import AXIS_LETTERS, DataRecord
from adapters.yaskawa.language.words import stop_code_meaning
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns, sleep_until_ns
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import ControllerFault, Refusal

TICKS_MAX = 2_147_483_647  # L10613
EVIDENCE_WAIT_NS = 200 * NS_PER_MS  # time after its instant within which a start is proven or disproven
WATCH_NS = 100 * NS_PER_MS
# controllers on one line of 19,200 baud whose watchdogs can be extended within half of the watchdog time
WATCHDOG_SHARED_MOST = 3
SETTLE_NS = 5 * NS_PER_MS
LATE_LOOK_TICKS = 12  # after the start of a step behind another one: by then its variables are in their place


@dataclass(slots=True)
class LoadedMove:
    """The loaded move. ticks: XT0. started: by axis, once known. thread: of its program. follows: it was loaded behind
    another one. released: its release was sent, so it may start by itself. taken: its variables are those of the
    present step. loaded: of a path, the chunk behind the released one."""

    lowered: YaskawaLowered
    ticks: int
    t0_ns: int
    mapping: TickMapping
    started: dict[str, HostInterval]
    thread: int = STEP_THREAD
    follows: bool = False
    released: bool = False
    taken: bool = True
    loaded: ChunkRecords | None = None

    @property
    def switched_ns(self) -> int:
        """When its last trigger is due; T0 without any."""
        switches = self.lowered.switches
        return self.t0_ns + (0 if switches is None else switches.instants_ns[-1])

    @property
    def end_ticks(self) -> int:
        """The sample in which its last axis ends."""
        return self.ticks + max((move.samples for move in self.lowered.moves), default=0)


class SampleStart:
    """The move that the resident program executes, and one that follows it."""

    LATE_TICKS = 4
    """Of a contour's stamps: two commands separate the last record from its stamp."""

    def __init__(self, device: SmcDevice, clock: Clock, options: YaskawaOptions, player: OutputPlayer) -> None:
        self._device = device
        self._clock = clock
        self._options = options
        self._loaded: LoadedMove | None = None
        self._next: LoadedMove | None = None
        self._refill = ContourRefill(device)
        self.player = player

    # Before T0

    async def load_at_rest(self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        """Load the registers, read them back, and start the program, which runs to its gate; `verify_move` confirms
        that. Raises `Refusal`.

        All commands are sent without waiting for replies: whatever these are, the program does not pass its gate.
        """
        if mapping is None:
            raise Refusal("no-clock", "the controller's clock is not known yet", "wait a second")
        began_ns = self._clock.now_ns()
        first, _ = self._options.begin_ticks(mapping.tick_ns, interleaved=True)
        ticks = round(mapping.to_ticks(t0_ns)) - first
        if ticks > TICKS_MAX:
            raise Refusal("counter-full", "the sample counter overflows before the start", "restart the controller")
        if mapping.to_ticks(began_ns) > ticks - self._device.gate.release_before:
            raise Refusal("late", "T0 is too near to arm", "increase the lead time")
        loaded_move = LoadedMove(lowered, ticks, t0_ns, mapping, {})
        await self._device.wait_for_stops()
        self._require_ready(await self._device.read_record(), lowered)
        session, drives = self._device.session, lowered.drives
        checked_ns = self._clock.now_ns()
        # The sample of the begin differs from T0 by a fraction of a sample.
        phase = ticks + first - mapping.to_ticks(t0_ns)
        # A watchdog left from an earlier step would fire when this one starts, and a second thread of it cannot be
        # started (L10305).
        shut = ("XGO=0", "XARM=0", "XOK=0", "XLATE=0", "XLO=0", f"HX{WATCHDOG_THREAD}", "XDOG=0")
        gate = (*shut, f"XT0={ticks}", f"XLI={_wait_input_number(lowered)}", self._watchdog_command(ticks))
        sample_place = SamplePlace(phase, mapping.tick_ns)
        lowered = loaded_move.lowered = await lowered.load.upload(self._refill, lowered, sample_place)
        self._loaded = loaded_move
        await self._load_move(
            lowered,
            gate,
            f"XQ {lowered.load.label(lowered.mask)},{STEP_THREAD}",
        )
        if drives is not None:
            await session.send_settings((f"XLO={drives.number}", f"XLV={drives.level}", f"XLH={drives.active_ticks}"))
            await session.send_command(f"XQ #EDGE,{EDGE_THREAD}")
        self.player.forget()
        if lowered.switches is not None:
            await self.player.load(lowered.switches, loaded_move)
        return {"check": checked_ns - began_ns, "wire": self._clock.now_ns() - checked_ns}

    async def _load_move(self, lowered: YaskawaLowered, gate: Sequence[str], then: str) -> None:
        """Load the move and the variables in `gate`, read back what was loaded, and send `then` after it. Raises
        `Refusal` if a value differs."""
        load = lowered.load
        wanted_values = {
            f"_{command}{AXIS_LETTERS[index]}": value
            for command, values in self._verified_registers(lowered).items()
            for index, value in values.items()
        }
        wanted_values |= load.variables
        wanted_values["XLI"] = _wait_input_number(lowered)
        held_values = await self._device.session.set_and_read((*gate, *load.commands), list(wanted_values), then)
        for (operand, value), held_value in zip(wanted_values.items(), held_values, strict=True):
            if held_value != value:
                raise Refusal("read-back", f"{operand} reads back as {held_value:.0f}, not {value}", "try again")

    def _verified_registers(self, lowered: YaskawaLowered) -> Mapping[str, Mapping[int, int]]:
        """Return the registers to read back, by command and axis."""
        return lowered.load.register_values

    def _watchdog_command(self, ticks: int) -> str:
        """Return the command that sets the watchdog deadline to some time after sample `ticks`."""
        # On a shared line, each controller waits for the turns of all the others.
        patience_s = self._options.watchdog_s * max(1.0, self._device.sharing_count / WATCHDOG_SHARED_MOST)
        patience = round(patience_s * NS_PER_S / self._device.samples.tick_ns)
        return f"XDL={min(ticks + patience, TICKS_MAX)}"

    def _require_ready(self, record: DataRecord, lowered: YaskawaLowered) -> None:
        if lowered.waits is not None:
            lowered.waits.require_passive(record.inputs)
        if lowered.drives is not None:
            lowered.drives.require_passive(record.outputs)
        if lowered.switches is not None:
            lowered.switches.output.require_passive(record.outputs)
        for move in lowered.moves:
            axis = record.axes[move.index]
            if axis.is_moving:
                raise Refusal("moving", f"axis {move.axis} is moving", "wait for its end, or stop it")
            if not axis.is_enabled:
                raise Refusal("not-enabled", f"axis {move.axis} is not enabled", f"enable {move.axis} first")
            if axis.commanded != move.start:
                raise Refusal(
                    "other-start",
                    f"axis {move.axis} is at {axis.commanded} counts; the plan starts at {move.start}",
                    "plan again from the present position",
                )

    async def verify_move(self, loaded: LoadedMove) -> None:
        """Wait, before the commit, until the program is at its gate; check that a program which waits for the end of
        the move before still does. Raises `Refusal`."""
        if loaded.follows:
            await self._verify_following(loaded)
            return
        operands = ("XARM", f"_HX{STEP_THREAD}", "XLATE")
        record, (armed_ticks, is_running, late) = await self._device.read_record_with(*operands)
        self._require_ready(record, loaded.lowered)
        while True:
            # The program also ends by itself if it reaches its gate after the closing time.
            if late or self._clock.now_ns() > loaded.t0_ns:
                raise Refusal("late", "the gate is already shut", "increase the lead time")
            if not is_running:
                raise Refusal("not-armed", "the controller no longer waits for this start", "arm again")
            if armed_ticks:
                break
            (armed_ticks, is_running, late), _ = await self._device.session.read_numbers(*operands)
        if int(armed_ticks) != loaded.ticks:
            raise Refusal("not-armed", "the controller waits for another start", "arm it again")

    async def release_move(self, loaded: LoadedMove, advance_ns: int) -> None:
        """Open the gate, and verify that the program passed it. The gate and the following wait read XT0 each time: an
        earlier T0 is sent before the release. The program of a move behind another one begins it at its sample if that
        has ended as planned. Raises `Refusal`."""
        if loaded.follows:
            await self._release_following(loaded, advance_ns)
            return
        session = self._device.session
        commands, operands = ["XGO=1"], ["XOK", "XLATE", f"_HX{STEP_THREAD}"]
        if advance_ns:
            loaded.ticks -= round(advance_ns / loaded.mapping.tick_ns)
            loaded.t0_ns -= advance_ns
            commands = [f"XT0={loaded.ticks}", self._watchdog_command(loaded.ticks), *commands]
            operands.append("XT0")
        if loaded.mapping.to_ticks(self._clock.now_ns()) > loaded.ticks - self._device.gate.release_before:
            raise Refusal("late", "it is too late to release the start", "increase the lead time")
        opened_ns = await session.send_settings(commands)
        await sleep_until_ns(self._clock, opened_ns + round(self._device.gate.usual_delay * loaded.mapping.tick_ns))
        while True:
            (is_passed, late, is_running, *ticks), _ = await session.read_numbers(*operands)
            if ticks and ticks[0] != loaded.ticks:
                raise Refusal("read-back", f"XT0 reads back as {ticks[0]:.0f}, not {loaded.ticks}", "try again")
            if late:
                raise Refusal("late", "the gate was shut before the release came", "increase the lead time")
            if not is_running:
                raise Refusal("not-armed", "the controller no longer waits for this start", "arm again")
            if is_passed:
                return
            await sleep_ns(self._clock, round(self._device.gate.longest_delay * loaded.mapping.tick_ns / 4))

    async def unload_moves(self) -> None:
        """Ensure that the program starts nothing, now or later."""
        self._loaded = self._next = None
        session = self._device.session
        await self._device.unload_program()
        await session.send_settings(("XGO=0", "XFGO=0"))
        thread_states, _ = await session.read_numbers(*(f"_HX{thread}" for thread in self._device.STEP_THREADS))
        if any(thread_states):
            raise ControllerFault("not-halted", "the waiting program does not halt", "reset the controller")

    def drop_move(self) -> None:
        """Drop the loaded moves: the controller no longer has them."""
        self._loaded = self._next = None

    def require_move(self, *, following: bool) -> LoadedMove:
        """Return the present move, or the following one. Raises `Refusal` (code `not-armed`)."""
        if not following:
            return self._require_loaded()
        if self._next is None:
            raise Refusal("not-armed", "no move is loaded behind the present one", "arm it first")
        return self._next

    def _require_loaded(self) -> LoadedMove:
        if self._loaded is None:
            raise Refusal("not-armed", "no move is loaded", "arm it first")
        return self._loaded

    # A move behind the present one

    async def load_beside(self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        """Load the registers of the following move into variables, read them back, and start its program, which waits
        for the end of the present move. Raises `Refusal`."""
        if mapping is None:
            raise Refusal("no-clock", "the controller's clock is not known yet", "wait a second")
        present, load, began_ns = self._require_loaded(), lowered.load, self._clock.now_ns()
        if not (load.fits_beside and present.lowered.load.fits_beside):
            raise Refusal("no-room", "the program holds one contour at a time", "")
        first_thread, second_thread = self._device.STEP_THREADS
        if second_thread == EDGE_THREAD and (present.lowered.drives or present.lowered.switches):
            raise Refusal("no-room", "the program still drives an output of the present step", "")
        first, _ = self._options.begin_ticks(mapping.tick_ns, interleaved=True)
        ticks = round(mapping.to_ticks(t0_ns)) - first
        if ticks > TICKS_MAX:
            raise Refusal("counter-full", "the sample counter overflows before the start", "restart the controller")
        if ticks - present.end_ticks < self._gap_ticks(present):
            raise Refusal("late", "the step begins too soon after the one before it", "increase the lead time")
        await self._wait_until_taken(present)
        positions = await self._end_positions(present)
        for move in lowered.moves:
            if positions[move.index] != move.start:
                text = f"axis {move.axis} ends at {positions[move.index]} counts; the plan starts at {move.start}"
                raise Refusal("other-start", text, "plan again from the present position")
        wanted_values = {"XFT": ticks, "XFGO": 0, "XFARM": 0, "XFL": 0, "XFA": 0}
        wanted_values |= {f"{BEGIN_VARIABLE}{index + 1}": positions[index] for index in self._device.program_axes}
        for command, values in load.registers.items():
            wanted_values |= {f"{REGISTER_VARIABLES[command]}{index + 1}": value for index, value in values.items()}
        following = LoadedMove(
            lowered,
            ticks,
            t0_ns,
            mapping,
            {},
            thread=first_thread + second_thread - present.thread,
            follows=True,
            taken=False,
        )
        self._next = following
        held_values = await self._device.session.set_and_read(
            [f"{name}={value}" for name, value in wanted_values.items()],
            list(wanted_values),
            f"XQ {following_label(lowered.mask)},{following.thread}",
        )
        for (name, value), held_value in zip(wanted_values.items(), held_values, strict=True):
            if held_value != value and name != "XFARM":
                raise Refusal("read-back", f"{name} reads back as {held_value:.0f}, not {value}", "try again")
        return {"wire": self._clock.now_ns() - began_ns}

    def _gap_ticks(self, move: LoadedMove) -> int:
        axes, moving_count = len(self._device.program_axes), len(move.lowered.moving_axes)
        return self._device.gate.gap_ticks(moving_count, axes, move.mapping.tick_ns)

    async def _wait_until_taken(self, present: LoadedMove) -> None:
        """Wait until the program no longer uses the variables of the following move for the present one."""
        until_ns = present.t0_ns + EVIDENCE_WAIT_NS
        while not present.taken:
            (ticks,), _ = await self._device.session.read_numbers("XT0")
            present.taken = int(ticks) == present.ticks
            if not present.taken:
                if self._clock.now_ns() > until_ns:
                    raise Refusal("not-begun", "the present step has not begun", "")
                await sleep_ns(self._clock, SETTLE_NS)

    async def _end_positions(self, present: LoadedMove) -> list[int]:
        """Return where each axis is when the present move has ended, counts."""
        record = await self._device.read_record()
        positions = [axis.commanded for axis in record.axes]
        for move in present.lowered.moves:
            positions[move.index] = move.end
        return positions

    async def _verify_following(self, following: LoadedMove) -> None:
        (armed_ticks, is_running, is_missed), _ = await self._device.session.read_numbers(
            "XFARM", f"_HX{following.thread}", "XFL"
        )
        if is_missed or self._clock.now_ns() > following.t0_ns:
            raise Refusal("late", "the step before has not ended in time", "increase the lead time")
        if not is_running or int(armed_ticks) != following.ticks:
            raise Refusal("not-armed", "the controller does not wait for this start", "arm it again")

    async def _release_following(self, following: LoadedMove, advance_ns: int) -> None:
        session, commands = self._device.session, list[str]()
        if advance_ns:
            following.ticks -= round(advance_ns / following.mapping.tick_ns)
            following.t0_ns -= advance_ns
            commands = [f"XFT={following.ticks}", f"XFARM={following.ticks}"]
        if following.mapping.to_ticks(self._clock.now_ns()) > following.ticks - self._device.gate.follow_before:
            raise Refusal("late", "it is too late to release the start", "increase the lead time")
        following.released = True  # before that, so that no query of the present move sets an earlier deadline
        await session.send_settings([*commands, self._watchdog_command(following.ticks), "XFGO=1"])
        (ticks, is_released, is_missed, is_running), _ = await session.read_numbers(
            "XFT", "XFGO", "XFL", f"_HX{following.thread}"
        )
        if is_missed or not is_running:
            raise Refusal("late", "the controller no longer waits for this start", "increase the lead time")
        if int(ticks) != following.ticks or not is_released:
            raise Refusal("read-back", f"XFT reads back as {ticks:.0f}, not {following.ticks}", "try again")

    async def unload_beside(self) -> None:
        """Unload the following move; the present one continues."""
        following, self._next = self._next, None
        if following is not None:
            await self._device.session.send_settings(("XFGO=0", f"HX{following.thread}"))
            (is_running,), _ = await self._device.session.read_numbers(f"_HX{following.thread}")
            if is_running:
                raise ControllerFault("not-halted", "the waiting program does not halt", "reset the controller")

    def take_over(self) -> None:
        """The present move has ended: the following one is the present one."""
        self._loaded, self._next = self.require_move(following=True), None

    # A path in chunks

    async def load_chunk(self, chunk: PathChunk, mapping: TickMapping | None) -> ChunkFit:
        """Load the next chunk of the present path. Raises `Refusal`."""
        present, load = self._require_course()
        if mapping is None:
            raise Refusal("no-clock", "the controller's clock is not known", "wait a second")
        first, _ = self._options.begin_ticks(present.mapping.tick_ns, interleaved=True)
        begun_path = BegunPath(present.ticks + first, present.t0_ns)
        records = load.maker.make_next(chunk, load.records, mapping, begun_path)
        played_count = max(0, round(mapping.to_ticks(self._clock.now_ns())) - begun_path.tick) >> load.maker.interval
        present.loaded = None
        await self._refill.load(records, load.maker.room, played_count)
        present.loaded = records
        return records.fit

    async def release_chunk(self, number: int) -> None:
        """Change over to the loaded chunk. Raises `Refusal`."""
        present, load = self._require_course()
        records = present.loaded
        if records is None or records.number != number:
            raise Refusal("not-loaded", f"chunk {number} of the path is not loaded", "load it first")
        present.loaded = None
        await self._refill.release(records, load.records, load.maker.room)
        present.lowered = load.follow_records(present.lowered, records)

    def _require_course(self) -> tuple[LoadedMove, CourseLoad]:
        present = self._require_loaded()
        load = present.lowered.load.course
        if load is None:
            raise Refusal("not-a-path", "the controller executes no path that can be continued", "")
        return present, load

    # After T0

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes began.

        BG took effect before XACT was read and after XT0 had come, and the command between the two takes less than a
        sample: so it was in sample XACT or the one before it, and the profile's origin is between the sample of BG and
        the one after it. Hence from XACT - 1, and not before XT0, to XACT + 1; each edge is uncertain by the bound of
        the clock mapping. For a start by trigger line, XT0 is irrelevant.
        """
        loaded_move = self._require_loaded()
        mapping, waits = loaded_move.mapping, loaded_move.lowered.waits
        _, last = self._options.begin_ticks(mapping.tick_ns, interleaved=True)
        late_ns = loaded_move.lowered.window_ns[1]
        await sleep_until_ns(
            self._clock, mapping.to_host_ns(loaded_move.ticks + last + 1) + mapping.bound_at_ns(loaded_move.t0_ns)
        )
        operands = ("XACT", "XFL" if loaded_move.follows else "XLATE", f"_HX{loaded_move.thread}", "XT0")
        while True:
            (acted_tick, late, is_running, ticks), _ = await self._device.session.read_numbers(*operands)
            if int(ticks) != loaded_move.ticks:
                acted_tick = 0  # of the step before: this one has not taken its place yet
            if late:
                raise ControllerFault("late", "the gate was shut before the release came; nothing started", "try again")
            if acted_tick:
                break
            if not is_running or self._clock.now_ns() > loaded_move.t0_ns + late_ns + EVIDENCE_WAIT_NS:
                words = (await self._device.session.query_lines("TC1")).lines[0]
                text = f"the controller did not start; its last error: {words}"
                raise ControllerFault("not-started", text, "try again")
            await sleep_ns(self._clock, SETTLE_NS)
        loaded_move.taken = True
        bound_ns = mapping.bound_at_ns(loaded_move.t0_ns)
        not_before = int(acted_tick) - 1 if waits is not None else max(int(acted_tick) - 1, loaded_move.ticks)
        span = HostInterval(
            mapping.to_host_ns(not_before) - bound_ns, mapping.to_host_ns(int(acted_tick) + 1) + bound_ns
        )
        loaded_move.started = dict.fromkeys((move.axis for move in loaded_move.lowered.moves), span)
        return loaded_move.started

    async def wait_for_end(self) -> MoveOutcome:
        """Watch until no axis of the step moves, then return how it ended."""
        loaded_move = self._require_loaded()
        seen_ns = {move.axis: loaded_move.started[move.axis].earliest_ns for move in loaded_move.lowered.moves}
        end_spans: dict[str, HostInterval] = {}
        is_stopped = False
        while True:
            # A path becomes longer by every chunk.
            moves = loaded_move.lowered.moves
            planned_ns = {
                axis: loaded_move.t0_ns + round(s * 1e9) for axis, s in loaded_move.lowered.durations_s.items()
            }
            record, present_ticks = await self._read_present()
            if present_ticks not in (None, loaded_move.ticks):
                return await self._followed_outcome(loaded_move)
            for move in moves:
                if record.axes[move.index].is_moving:
                    seen_ns[move.axis] = record.sent_ns
                elif move.axis not in end_spans:
                    end_spans[move.axis] = HostInterval(seen_ns[move.axis], record.received_ns)
            if len(end_spans) == len(moves) and (
                loaded_move.lowered.switches is None or not await self.player.is_playing()
            ):
                break
            ticks = round((self._device.samples.current_mapping() or loaded_move.mapping).to_ticks(record.received_ns))
            await self._device.session.send_command(self._watchdog_command(max(ticks, self._released_ticks())))
            # Poll again soon after the next planned end: the stamps record only the last end.
            ends_ns = min(
                (planned_ns[axis] for axis in seen_ns if axis not in end_spans), default=loaded_move.switched_ns
            )
            left_ns = ends_ns + SETTLE_NS - self._clock.now_ns()
            watch_ns = min(WATCH_NS, left_ns) if left_ns > 0 and not is_stopped else SETTLE_NS
            if not is_stopped:
                watch_ns = self._spare_turn(watch_ns)
            is_stopped = await self._device.sleep_to_stop(watch_ns) or is_stopped
        reasons = {move.axis: self._end_reason(move, record) for move in moves}
        states = {state for state, _ in reasons.values()}
        if states <= {"done"}:
            late = await self._narrow_ends(loaded_move, end_spans)
            return MoveOutcome("fault", end_spans, late) if late else MoveOutcome("done", end_spans)
        text = "; ".join(f"axis {axis} {words}" for axis, (state, words) in reasons.items() if state != "done")
        (watchdog_fired,), _ = await self._device.session.read_numbers("XDOG")
        if watchdog_fired:
            text += "; by its own watchdog: the adapter did not extend its deadline, or its program had failed"
        return MoveOutcome("fault" if "fault" in states else "stopped", end_spans, text)

    def _spare_turn(self, watch_ns: int) -> int:
        """Return how long to wait before the next query: queries take time from the program between a move and the one
        that follows it."""
        following, at_ns = self._next, self._clock.now_ns() + watch_ns
        if following is None or not following.released:
            return watch_ns
        tick_ns = following.mapping.tick_ns
        gap_ns = self._gap_ticks(self._require_loaded()) * tick_ns
        late_ns = following.t0_ns + round(LATE_LOOK_TICKS * tick_ns)
        return late_ns - self._clock.now_ns() if following.t0_ns - gap_ns < at_ns < late_ns else watch_ns

    async def _read_present(self) -> tuple[DataRecord, int | None]:
        """Return a record and, if a move is loaded behind the present one, XT0 of the step that is executed."""
        if self._next is None:
            return await self._device.read_record(), None
        record, (ticks,) = await self._device.read_record_with("XT0")
        return record, int(ticks)

    def _released_ticks(self) -> int:
        """The sample at which a released following move begins, which the watchdog must outlast; 0 without one."""
        return self._next.ticks if self._next is not None and self._next.released else 0

    async def _followed_outcome(self, loaded: LoadedMove) -> MoveOutcome:
        """Return how a move ended behind which another one has begun: at its target, or that one had not begun."""
        way, mapping = loaded.lowered.moving_axes, self._device.samples.current_mapping() or loaded.mapping
        ticks, *values = await self._device.session.read_many(["XZT", *(f"XZ{move.index + 1}" for move in way)])
        if int(ticks) != loaded.ticks:
            return MoveOutcome("fault", {}, "the controller has begun another step; its stamps are lost")
        end_spans = {move.axis: loaded.started[move.axis] for move in loaded.lowered.moves}
        for move, value in zip(way, values, strict=True):
            begun_ns = loaded.started[move.axis].earliest_ns
            by_ns = mapping.to_host_ns(int(value) + 1)
            not_before_ns = begun_ns + round((move.samples - 1) * mapping.tick_ns)
            end_spans[move.axis] = HostInterval(not_before_ns, by_ns + mapping.bound_at_ns(by_ns))
        return MoveOutcome("done", end_spans)

    def _end_reason(self, move: YaskawaAxisMove, record: DataRecord) -> tuple[str, str]:
        if not move.samples:
            return "done", ""
        axis = record.axes[move.index]
        code = stop_code_meaning(axis.stop_code)
        if code.state == "done" and axis.commanded != move.end:
            return "fault", f"is at {axis.commanded} counts, not at {move.end}"
        return code.state, code.text

    async def _narrow_ends(self, loaded: LoadedMove, ended: dict[str, HostInterval]) -> str:
        """Narrow the ends by the program's own stamps; return a message if a contour was fed too slowly.

        XEn is read after AM of axis n, or WC after a contour's last record, has passed: the axis had ended by then, but
        it may have ended long before, if the program reached the wait late. It cannot have ended before the duration of
        its profile, counted from its start. Axes that end within a contour read as moving until all of it is over, but
        they ended earlier by the records that they do not use.
        """
        way, load = loaded.lowered.moving_axes, loaded.lowered.load
        contour = load.contour
        # A contour has one stamp for all its axes. A command line for all stamps would be too long (L12254).
        names = [f"XE{move.index + 1}" for move in way]
        operands = names if contour is None else [names[0], "XACT"]
        until_ns = self._clock.now_ns() + EVIDENCE_WAIT_NS
        while True:
            (is_done, ticks, *values) = await self._device.session.read_many(["XDONE", "XT0", *operands])
            if int(ticks) != loaded.ticks:
                ended.update((await self._followed_outcome(loaded)).ended)
                return ""
            if is_done:
                break
            if self._clock.now_ns() > until_ns:
                return ""
            # The axes have ended, but the program's last lines are still running.
            await sleep_ns(self._clock, SETTLE_NS)
        mapping = self._device.samples.current_mapping() or loaded.mapping
        total = 0 if contour is None else contour.record_ends[-1]
        for move in loaded.lowered.moves:
            if not move.samples:
                ended[move.axis] = loaded.started[move.axis]
        for number, move in enumerate(way):
            start, end_span = loaded.started[move.axis], ended[move.axis]
            not_before_ns = start.earliest_ns + round((move.samples - 1) * mapping.tick_ns)
            if contour is None:
                by_ns = mapping.to_host_ns(int(values[number]) + 1)
                not_before_ns = max(end_span.earliest_ns, not_before_ns)
            else:
                by_ns = mapping.to_host_ns(int(values[0]) + 1 - total + move.samples)
            ended[move.axis] = HostInterval(not_before_ns, min(end_span.latest_ns, by_ns + mapping.bound_at_ns(by_ns)))
        late = 0 if contour is None else int(values[0] - values[1]) - total
        if late > self.LATE_TICKS:
            return (
                f"the contour ended {late} samples late: its records came too slowly; raise the "
                "controller's option decode_us to the real duration of a command in its programs"
            )
        return ""


def _wait_input_number(lowered: YaskawaLowered) -> int:
    """Return the input to begin by, 0 for none."""
    return 0 if lowered.waits is None else lowered.waits.number
