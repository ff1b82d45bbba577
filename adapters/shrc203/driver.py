"""The driver of one SHRC-203."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from adapters.abilities import LearningDriver, ManualDriver, OutputDriver, SettingsDriver, TriggerDriver
from adapters.contract import (
    ControllerIdentity,
    ControllerReading,
    DriverCapabilities,
    DriverSetup,
    JogMove,
    SettingDifference,
    SwitchedOutput,
)
from adapters.shrc203 import fleetaxes, startup
from adapters.shrc203.chain import ChainReport, MoveChain, require_axes
from adapters.shrc203.chain_axis import ChainMove
from adapters.shrc203.costs import step_costs
from adapters.shrc203.homing import home_axes
from adapters.shrc203.jogging import ShrcJogging
from adapters.shrc203.lowering import ConnectionTraits, ShrcLowered, lower_step
from adapters.shrc203.moves import ShrcMover
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.output import ManualOutputs
from adapters.shrc203.polling import PositionKind, ShrcPoller, read_registered
from adapters.shrc203.pulses import require_trigger
from adapters.shrc203.standby import can_wait_at_rest
from adapters.shrc203.triggers import add_trigger
from adapters.shrc203.unitstate import ShrcState
from adapters.shrc203.watch import ShrcWatch
from adapters.shrc203.wire.replies import axis_argument, flag_list
from adapters.shrc203.wire.session import ShrcSession
from adapters.toolkit.connection import ConnectedDriver
from adapters.toolkit.host_start import MoverTools
from adapters.toolkit.refusals import log_refusals
from adapters.toolkit.watched_settings import check_watched_settings
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.latency import StartLatency
from orchestrator.clock.rate import CrystalRate
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

_RAMP_NS = NS_PER_S  # the longest ramp of a stop
# While a completion is outstanding, `1` could be the answer to these as well.
_DIGIT_QUERIES = ("?:", "I:", "PIT:GET", "PAV:GET", "MS:")


@dataclass(frozen=True, slots=True)
class ShrcConnection:
    """Everything that exists only while the controller is connected."""

    state: ShrcState
    mover: ShrcMover
    poller: ShrcPoller
    jogging: ShrcJogging
    watch: ShrcWatch


class ShrcDriver(
    ConnectedDriver[ShrcConnection], SettingsDriver, LearningDriver, TriggerDriver, ManualDriver, OutputDriver
):
    """Drive one controller over one line. Exchanges take turns; a stop bypasses them."""

    def __init__(self, setup: DriverSetup, options: ShrcOptions) -> None:
        super().__init__(setup, ShrcLowered)
        self._config = setup.config
        self._options = options
        self._clock = setup.clock
        self._char_ns = _char_ns(setup, options)
        self._costs = step_costs(options, self._char_ns)
        self._line_costs = step_costs(options, self._char_ns, line=True)
        self._outputs = ManualOutputs()
        # These outlive a connection: they describe the controller that still has the sentinel.
        self._crystal = options.unread_clock()
        self._sentinel: tuple[str, str] | None = None
        self._restarted = False  # since the last poll

    # Connection

    async def connect(self) -> ControllerIdentity:
        link = await self._setup.open_link()
        session = ShrcSession(link, self._clock, max(link.char_ns, self._char_ns), self._options.answer_ms * NS_PER_MS)
        session.log = self._log
        self._log.info("link opened", place=link.endpoint)
        unit = ShrcState(session)
        longest_s = max(axis.in_position_timeout_s for axis in self._config.axes.values())
        settle_ns = round(longest_s * NS_PER_S) + _RAMP_NS
        mover = ShrcMover(
            self._options, MoverTools(self._clock, self._setup.timed_writer, self._crystal), unit, settle_ns
        )
        self._connection = ShrcConnection(
            state=unit,
            mover=mover,
            poller=ShrcPoller(self._config, self._options, self._clock, unit),
            jogging=ShrcJogging(self._config, self._clock, unit, mover),
            watch=ShrcWatch(unit, {motor: name for name, motor in fleetaxes.motor_numbers(self._config).items()}),
        )
        identity = await startup.identify_controller(session)
        unit.controllable = await startup.controllable_axes(session, self._clock, self._options.busy_wait_s)
        await self._read_motors(unit)
        await unit.make_harmless()
        if fleetaxes.TRIGGER_NUMBER in (output.number for output in self._config.outputs.values()):
            # A step of an earlier connection may have left it set; one that is refused now is repeated.
            unit.trigger_set = not await session.try_setting("T:S")
        self.log_identity(link.endpoint, identity)
        return identity

    async def configure(self) -> None:
        unit = self.connection.state
        await startup.compare_settings(unit.session, self._config, self._options, unit.controllable)
        loops = await unit.session.send_query("?:FW", flag_list(len(unit.controllable)))
        unit.closed_loop = {m: digit == "0" for m, digit in zip(unit.controllable, loops.split(","), strict=True)}
        if self._sentinel is not None:
            unit.sentinel = self._sentinel
            if await unit.is_restarted():
                self._crystal.discard_moves()
                self._restarted = True
                self._log.warning("the controller was restarted: its volatile state is lost")
        unit.sentinel = await startup.load_sentinel(unit.session, self._config, unit.controllable)
        self._sentinel = unit.sentinel
        if self._config.inputs:
            unit.line_starts = await can_wait_at_rest(unit)
            if not unit.line_starts:
                self._log.warning("the controller accepts no input waits: no start by trigger line")
        await self.connection.watch.record_settings()

    @property
    def capabilities(self) -> DriverCapabilities:
        return DriverCapabilities(
            start_classes=("host", "line") if self._supports_line_starts else ("host",),
            orders=(2,),
            independent_axes=False,
            costs=self._costs,
            # With one axis, replies to these queries look like completion lines.
            checks_while_moving=self._connection is not None and len(self._connection.state.controllable) > 1,
        )

    @property
    def _supports_line_starts(self) -> bool:
        """Return whether a move can wait for an input; assumed until the controller has been queried."""
        return self._connection is None or self._connection.state.line_starts

    async def poll(self) -> ControllerReading:
        reading = await self.connection.poller.poll_state()
        state, mover = self.connection.state, self.connection.mover
        if state.untidy_at_rest and not mover.is_busy and not any(axis.moving for axis in reading.axes.values()):
            self._log.info("emptying the prebuffers, and ending triggers, after a stop")
            with suppress(Refusal):  # of an axis that is still busy: the next poll repeats it
                await mover.empty_prebuffers()
        is_restarted, self._restarted = self._restarted, False
        return replace(reading, restarted=is_restarted)

    async def check_settings(self, *, everything: bool) -> Sequence[SettingDifference]:
        """Query pulse length and loop mode, or the next setting in turn."""
        return await check_watched_settings(self.connection.watch, self._log, everything=everything)

    # Steps

    def crystal_rate(self) -> CrystalRate:
        return self._crystal.crystal_rate

    def start_latency(self) -> StartLatency:
        return self._crystal.start_latency_at(self._clock.now_ns())

    def forget_starts(self) -> None:
        self._crystal.forget_starts()

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> ShrcLowered:
        loops = {} if self._connection is None else self._connection.state.closed_loop
        closed_loop = frozenset(motor for motor, is_closed in loops.items() if is_closed)
        estimate = self._crystal.estimate_at(self._clock.now_ns())
        pulse_trigger = (
            require_trigger(self._config, self._options, profiles, start.triggers) if start.triggers else None
        )
        wire = ConnectionTraits(
            char_ns=self._char_ns,
            line_starts=self._supports_line_starts,
            costs=self._costs,
            line_costs=self._line_costs,
            known=estimate,
            closed_loop=closed_loop,
            pulsed=pulse_trigger,
        )
        lowered_step = lower_step(self._config, self._options, wire, profiles, start)
        if pulse_trigger is None:
            return lowered_step
        return add_trigger(
            lowered_step, self._config, self._options, wire, (start.triggers[0], profiles[pulse_trigger])
        )

    async def take_triggers(self) -> Mapping[str, SwitchedOutput]:
        with log_refusals(self._log, "the fetching of triggers"):
            return await self.connection.mover.triggers.take()

    async def stop(self, *, abort: bool) -> None:
        """Stop by `L:E`, which is never refused; or by `L:` to the axes whose motors are on, and then to each axis
        singly, because `L:` is refused for all where one motor is off (L2988)."""
        unit, mover = self.connection.state, self.connection.mover
        unit.stops.record_stop((1, 2, 3))
        if abort:
            lines = ["L:E"]
        else:
            on = [motor for motor in unit.controllable or (1, 2, 3) if unit.excited.get(motor, True)]
            lines = [
                *mover.commands_before_stop(),
                f"L:{axis_argument(on)}" if on else "L:W",
                *(f"L:{motor}" for motor in on),
            ]
        mover.record_stop(unit.session.write_at_once(*lines, *mover.commands_after_stop()))
        self._log.info("stop written", abort=abort)

    # Manual operation

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        unit = self.connection.state
        motors = {fleetaxes.motor_number(self._config.axes[name]) for name in axes}
        if not motors:
            return
        await unit.session.send_setting(f"C:{axis_argument(motors)}{int(on)}")
        await self._read_motors(unit)
        wrong = [name for name in axes if unit.excited[fleetaxes.motor_number(self._config.axes[name])] != on]
        if wrong:
            raise Refusal("not-switched", f"axis {wrong[0]} is not {'on' if on else 'off'} yet", "check the controller")
        if on:
            await unit.make_harmless()

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        await self.connection.state.end_trigger()
        return await home_axes(self._config, self._clock, self.connection.state, axes, found)

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        await self.connection.jogging.start_jog(axis, move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        unit = self.connection.state
        motors = [fleetaxes.motor_number(self._config.axes[name]) for name in axes]
        unit.stops.record_stop(motors)
        unit.brake_motors(motors)

    async def run_chain(
        self, moves: Mapping[str, Sequence[ChainMove]], report_underrun: Callable[[str], None] = lambda _: None
    ) -> ChainReport:
        """Run sequences of moves, each begun by the controller itself when the previous one has ended; `stop` ends
        them.

        Raises `Refusal`; then nothing has moved. report_underrun: called with the text of every underrun.
        """
        unit = self.connection.state
        require_axes(self._config, moves)
        async with unit.loading:
            if self.connection.mover.is_busy:
                raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
            await unit.end_trigger()
            unit.chaining = True
        return await MoveChain(self._config, self._clock, unit, self._options.clock_ppm, report_underrun).run_moves(
            moves
        )

    async def set_output(self, number: int, *, on: bool) -> None:
        unit = self.connection.state
        if number == fleetaxes.TRIGGER_NUMBER:
            raise Refusal("trigger-output", "the trigger output gives pulses only", "name it in `triggers` of a step")
        await self._outputs.set_output(unit, number, on=on)

    async def clear_faults(self) -> None:
        """Clear limit error, overflow error and emergency stop (L2452-L2454). The motors do not change."""
        unit = self.connection.state
        await unit.session.send_setting("BEC:W")
        self._log.info("errors cleared")
        await self._read_motors(unit)
        await self.connection.watch.restore_settings()

    async def read_registered(self, kind: PositionKind) -> Mapping[int, Mapping[str, int]]:
        """Return positions that are registered in the controller: pulses by axis, by number (1 to 20).

        kind: `place` for stage positions, in present coordinates (PIT:), or `coordinates` (PAV:). Raises `Refusal`.
        """
        records = await read_registered(self.connection.state.session, kind)
        motors = fleetaxes.motor_numbers(self._config)
        return {number: {name: record[motors[name] - 1] for name in motors} for number, record in records.items()}

    async def send_raw(self, command: str) -> str:
        session = self.connection.state.session
        if not command.isascii() or not command.isprintable():
            raise Refusal("raw-line", "a raw command is one line of printable ASCII", "send one line")
        if session.completions.expected and command.upper().startswith(_DIGIT_QUERIES):
            raise Refusal(
                "moving",
                f"the reply to {command!r} could not be distinguished from a completion line",
                "query again at rest",
            )
        return await session.send_raw(command)

    async def close(self) -> None:
        old_connection, self._connection = self._connection, None
        if old_connection is not None:
            self._log.info("link closed")
            old_connection.mover.drop_move()
            await old_connection.state.session.close()

    # Internals

    async def _read_motors(self, unit: ShrcState) -> None:
        answer = await unit.session.send_query("?:CW", flag_list(len(unit.controllable)))
        unit.excited = {m: digit == "1" for m, digit in zip(unit.controllable, answer.split(","), strict=True)}


def _char_ns(setup: DriverSetup, options: ShrcOptions) -> int:
    """Return the duration of one character on the serial side: start, data, parity and stop bits at the baud rate."""
    link = setup.config.link
    if link.kind != "serial":
        return 10 * NS_PER_S // options.bridge_baud
    bits_per_character = 1 + link.data_bits + (link.parity != "none") + link.stop_bits
    return bits_per_character * NS_PER_S // link.baud
