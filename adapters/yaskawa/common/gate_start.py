"""A start at rest: the move loaded into the registers, and the program released at its gate for a sample."""

from collections.abc import Mapping, Sequence

from adapters.contract import HostInterval
from adapters.yaskawa.common.course_refill import ContourRefill
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.gate import LATE_LOOK_TICKS
from adapters.yaskawa.common.lines import OutputPlayer
from adapters.yaskawa.common.loaded import EVIDENCE_WAIT_NS, SETTLE_NS, TICKS_MAX, LoadedMove
from adapters.yaskawa.common.loads import SamplePlace, YaskawaLowered
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import EDGE_THREAD, STEP_THREAD, WATCHDOG_THREAD
from adapters.yaskawa.common.watchdog import StepWatchdog
from adapters.yaskawa.wire.record import AXIS_LETTERS, DataRecord
from orchestrator.clock.base import Clock, sleep_ns, sleep_until_ns
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import LATE_REMEDY, ControllerFault, Refusal


class GateStart:
    """The present move of one controller, up to its start. player: of its triggers."""

    def __init__(
        self, device: SmcDevice, clock: Clock, options: YaskawaOptions, refill: ContourRefill, player: OutputPlayer
    ) -> None:
        self._device = device
        self._clock = clock
        self._options = options
        self._watchdog = StepWatchdog(device, options)
        self.refill = refill
        self.player = player
        self.move: LoadedMove | None = None

    def require_move(self) -> LoadedMove:
        """Return the present move. Raises `Refusal` (code `not-armed`)."""
        if self.move is None:
            raise Refusal("not-armed", "no move is loaded", "arm it first")
        return self.move

    async def load_move(self, lowered: YaskawaLowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
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
            raise Refusal("late", "T0 is too near to arm", LATE_REMEDY)
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
        gate = (*shut, f"XT0={ticks}", f"XLI={_wait_input_number(lowered)}", self._watchdog.extension_command(ticks))
        sample_place = SamplePlace(phase, mapping.tick_ns)
        lowered = loaded_move.lowered = await lowered.load.upload(self.refill, lowered, sample_place)
        self.move = loaded_move
        await self._load_registers(
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

    async def _load_registers(self, lowered: YaskawaLowered, gate: Sequence[str], then: str) -> None:
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
        """Wait, before the commit, until the program is at its gate. Raises `Refusal`."""
        operands = ("XARM", f"_HX{STEP_THREAD}", "XLATE")
        record, (armed_ticks, is_running, late) = await self._device.read_record_with(*operands)
        self._require_ready(record, loaded.lowered)
        while True:
            # The program also ends by itself if it reaches its gate after the closing time.
            if late or self._clock.now_ns() > loaded.t0_ns:
                raise Refusal("late", "the gate is already shut", LATE_REMEDY)
            if not is_running:
                raise Refusal("not-armed", "the controller no longer waits for this start", "arm again")
            if armed_ticks:
                break
            (armed_ticks, is_running, late), _ = await self._device.session.read_numbers(*operands)
        if int(armed_ticks) != loaded.ticks:
            raise Refusal("not-armed", "the controller waits for another start", "arm it again")

    async def release_move(self, loaded: LoadedMove, advance_ns: int) -> None:
        """Open the gate, and verify that the program passed it. The gate and the following wait read XT0 each time: an
        earlier T0 is sent before the release. Raises `Refusal`."""
        session = self._device.session
        commands, operands = ["XGO=1"], ["XOK", "XLATE", f"_HX{STEP_THREAD}"]
        if advance_ns:
            loaded.ticks -= round(advance_ns / loaded.mapping.tick_ns)
            loaded.t0_ns -= advance_ns
            commands = [f"XT0={loaded.ticks}", self._watchdog.extension_command(loaded.ticks), *commands]
            operands.append("XT0")
        if loaded.mapping.to_ticks(self._clock.now_ns()) > loaded.ticks - self._device.gate.release_before:
            raise Refusal("late", "it is too late to release the start", LATE_REMEDY)
        opened_ns = await session.send_settings(commands)
        await sleep_until_ns(self._clock, opened_ns + round(self._device.gate.usual_delay * loaded.mapping.tick_ns))
        while True:
            (is_passed, late, is_running, *ticks), _ = await session.read_numbers(*operands)
            if ticks and ticks[0] != loaded.ticks:
                raise Refusal("read-back", f"XT0 reads back as {ticks[0]:.0f}, not {loaded.ticks}", "try again")
            if late:
                raise Refusal("late", "the gate was shut before the release came", LATE_REMEDY)
            if not is_running:
                raise Refusal("not-armed", "the controller no longer waits for this start", "arm again")
            if is_passed:
                return
            await sleep_ns(self._clock, round(self._device.gate.longest_delay * loaded.mapping.tick_ns / 4))

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        """Return when the axes began.

        BG took effect before XACT was read and after XT0 had come, and the command between the two takes less than a
        sample: so it was in sample XACT or the one before it, and the profile's origin is between the sample of BG and
        the one after it. Hence from XACT - 1, and not before XT0, to XACT + 1; each edge is uncertain by the bound of
        the clock mapping. For a start by trigger line or at once, XT0 is irrelevant.
        """
        loaded_move = self.require_move()
        mapping, waits = loaded_move.mapping, loaded_move.lowered.waits
        _, last = self._options.begin_ticks(mapping.tick_ns, interleaved=True)
        late_ns = loaded_move.lowered.window_ns[1]
        is_immediate = loaded_move.lowered.at_once
        look_ticks = loaded_move.ticks + (LATE_LOOK_TICKS if is_immediate else last + 1)
        await sleep_until_ns(self._clock, mapping.to_host_ns(look_ticks) + mapping.bound_at_ns(loaded_move.t0_ns))
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
        loaded_move.taken, loaded_move.begun_ticks = True, int(acted_tick) - 1
        bound_ns = mapping.bound_at_ns(loaded_move.t0_ns)
        is_free = waits is not None or is_immediate
        not_before = loaded_move.begun_ticks if is_free else max(loaded_move.begun_ticks, loaded_move.ticks)
        by_ns = mapping.to_host_ns(int(acted_tick) + 1) + bound_ns
        delayed_ns = max(0, by_ns - loaded_move.t0_ns - late_ns) if is_immediate else 0
        span = HostInterval(mapping.to_host_ns(not_before) - bound_ns, by_ns, late_ns=delayed_ns)
        loaded_move.started = dict.fromkeys((move.axis for move in loaded_move.lowered.moves), span)
        return loaded_move.started


def _wait_input_number(lowered: YaskawaLowered) -> int:
    """Return the input to begin by, 0 for none."""
    return 0 if lowered.waits is None else lowered.waits.number
