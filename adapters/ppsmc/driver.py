"""The driver of one pp-electronic SMC."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from adapters.abilities import LearningDriver, ManualDriver, OutputDriver, SettingsDriver
from adapters.contract import (
    ControllerIdentity,
    ControllerReading,
    DriverCapabilities,
    DriverSetup,
    JogMove,
    SettingDifference,
)
from adapters.ppsmc import fleetaxes, startup
from adapters.ppsmc.costs import longest_stop_s, step_costs
from adapters.ppsmc.homing import home_axes
from adapters.ppsmc.jogging import PpSmcJogging
from adapters.ppsmc.lowering import ConnectionTraits, PpSmcLowered, lower_step
from adapters.ppsmc.moves import PpSmcMover
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.polling import PpSmcPoller
from adapters.ppsmc.replies import ASK_OUTPUTS, ASK_STATUS
from adapters.ppsmc.session import PpSmcSession, as_refusal
from adapters.ppsmc.stopper import StopConnection
from adapters.ppsmc.unitstate import PpSmcState
from adapters.ppsmc.watch import PpSmcWatch
from adapters.toolkit.connection import ConnectedDriver
from adapters.toolkit.host_start import MoverTools
from adapters.toolkit.watched_settings import check_watched_settings
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.latency import StartLatency
from orchestrator.clock.rate import CrystalRate
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

_STOP_RAMP_NS = 2 * NS_PER_S


@dataclass(frozen=True, slots=True)
class PpSmcConnection:
    """Everything that exists only while the controller is connected."""

    state: PpSmcState
    mover: PpSmcMover
    poller: PpSmcPoller
    jogging: PpSmcJogging
    watch: PpSmcWatch


class PpSmcDriver(ConnectedDriver[PpSmcConnection], SettingsDriver, LearningDriver, ManualDriver, OutputDriver):
    """Drive one controller. Exchanges take turns on one connection; a stop bypasses them on another."""

    def __init__(self, setup: DriverSetup, options: PpSmcOptions) -> None:
        super().__init__(setup, PpSmcLowered)
        self._config = setup.config
        self._options = options
        self._clock = setup.clock
        link = setup.config.link
        self._char_ns = 10 * NS_PER_S // link.baud if link.kind == "serial" else 0
        self._stop_s = longest_stop_s(fleetaxes.axis_bounds(axis) for axis in setup.config.axes.values())
        self._installed = max(fleetaxes.axis_numbers(setup.config).values())
        self._enabled: set[str] = set(setup.config.axes)
        # Outlives a connection: the last token of the controller.
        self._token = 0
        self._restarted = False
        # These outlive a connection as well: the axes that a limit switch has stopped, and the crystal.
        self._spoiled: set[int] = set()
        self._crystal = options.unread_clock()

    # Connection

    async def connect(self) -> ControllerIdentity:
        options, slow_ns = self._options, self._options.decode_ns[1]
        await self.close()
        session = PpSmcSession(
            await self._setup.open_link(),
            self._clock,
            options.answer_ms * NS_PER_MS,
            slow_ns,
            self._token,
        )
        session.log = self._log
        self._log.info("link opened", place=session.link.endpoint)
        stopper = StopConnection(self._setup.open_link, wanted=self._config.link.kind == "tcp")
        unit = PpSmcState(session, stopper, self._config, slow_ns, enabled=self._enabled, spoiled=self._spoiled)
        longest_s = max(axis.in_position_timeout_s for axis in self._config.axes.values())
        settle_ns = round(longest_s * NS_PER_S) + _STOP_RAMP_NS
        mover = PpSmcMover(options, MoverTools(self._clock, self._setup.timed_writer, self._crystal), unit, settle_ns)
        self._connection = PpSmcConnection(
            state=unit,
            mover=mover,
            poller=PpSmcPoller(self._config, options, unit),
            jogging=PpSmcJogging(self._config, self._clock, unit, mover),
            watch=PpSmcWatch(unit, fleetaxes.axis_names(self._config)),
        )
        await stopper.open_connection()
        identity = await startup.identify_controller(unit)
        await startup.wait_idle(unit, self._clock, options)
        # Reported by the first poll: a reconnecting adapter must learn that the controller was off meanwhile.
        self._save_token(session)
        self._installed = max(self._installed, unit.installed)
        self.log_identity(session.link.endpoint, identity)
        return identity

    async def configure(self) -> None:
        """Compare and load the settings. A blocked controller answers no such query: this is done as soon as it is
        unblocked."""
        unit = self.connection.state
        if not unit.session.blocked:
            async with unit.loading:
                await startup.compare_and_load(unit, self._options)

    @property
    def capabilities(self) -> DriverCapabilities:
        return DriverCapabilities(
            start_classes=("host", "line") if self._options.io_port else ("host",),
            orders=(2,),
            independent_axes=False,
            costs=step_costs(self._options, self._char_ns, self._installed, self._stop_s),
            compares_when_loading=self._options.check_profile,
            shows_inputs=True,
        )

    async def poll(self) -> ControllerReading:
        unit, poller = self.connection.state, self.connection.poller
        reading = await poller.poll_state()
        self._token = unit.session.last_token
        resting = not any(axis.moving for axis in reading.axes.values())
        if not unit.introduced and resting and not unit.session.blocked:
            await self.configure()
        elif unit.untidy and resting and not unit.session.blocked:
            self._log.info("emptying the target buffer after a stop")
            await self.connection.mover.clear_targets()
        await unit.stopper.open_connection()
        is_restarted, self._restarted = self._restarted, False
        return replace(reading, restarted=is_restarted)

    async def check_settings(self, *, everything: bool) -> Sequence[SettingDifference]:
        """Query ?conf of all axes, or of the next axis in turn."""
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
    ) -> PpSmcLowered:
        estimate = self._crystal.estimate_at(self._clock.now_ns())
        return lower_step(
            self._config, self._options, ConnectionTraits(self._char_ns, self._installed, estimate), profiles, start
        )

    async def stop(self, *, abort: bool) -> None:
        """Stop with `q`, which ends all motions and programs by the ramp (L2542), the fastest stop of this controller.
        An abort also blocks the controller, so that no other client's command continues (L1400), until
        `clear_faults`."""
        unit, mover = self.connection.state, self.connection.mover
        unit.stops.record_stop(range(1, self._installed + 1))
        outputs = mover.commands_after_stop()
        lines = [*outputs, "q", *(["block"] if abort else [])]
        mover.record_stop(unit.write_stop(*lines))
        if abort:
            unit.session.handle_block()
        self._log.info("stop written", abort=abort)

    # Manual operation

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        """Enable or disable axes in the adapter. The controller cannot switch a motor off: the adapter does not move a
        disabled axis."""
        unit = self.connection.state
        await unit.session.send_queries(ASK_STATUS)
        self._enabled.update(axes) if on else self._enabled.difference_update(axes)

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        if self.connection.mover.move is not None:
            raise Refusal("busy", "a move is loaded or in progress", "disarm or stop it")
        try:
            return await home_axes(self._config, self._clock, self.connection.state, axes, found)
        except ControllerFault as error:
            if error.code == "blocked":
                raise as_refusal(error) from None
            raise

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        await self.connection.jogging.start_jog(axis, move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        unit = self.connection.state
        motors = [fleetaxes.axis_number(self._config.axes[name]) for name in axes]
        unit.stops.record_stop(motors)
        if motors:
            unit.brake_axes(motors)

    async def set_output(self, number: int, *, on: bool) -> None:
        unit = self.connection.state
        if not self._options.io_port:
            await unit.session.send_queries(ASK_STATUS)
            raise Refusal(
                "no-output", f"there is no output {number}: the unit has no i/o port", "see `options.io_port`"
            )
        if unit.driving:
            raise Refusal(
                "busy", "a step drives an output, and all outputs are written together", "wait for the end of the step"
            )
        async with self._output_lock:
            levels, bit = int((await unit.session.send_queries(ASK_OUTPUTS)).first_text(ASK_OUTPUTS)), 1 << number
            value = levels | bit if on else levels & ~bit
            reply = await unit.session.send_repeatable((f"dout{value}",), ASK_OUTPUTS)
        if int(reply.first_text(ASK_OUTPUTS)) != value:
            raise Refusal("not-switched", f"the outputs are {reply.first_text(ASK_OUTPUTS)} after dout{value}", "")

    async def clear_faults(self) -> None:
        """Unblock the controller, and clear errors (L1630). Raises `Refusal` while an axis moves."""
        unit = self.connection.state
        # Regardless of the last poll: a block may be under way.
        await unit.session.unblock_controller()
        look = await unit.read_state()
        if look.is_blocked:
            raise Refusal("blocked", "the controller is still blocked after `unblock`", "see its screen")
        if not look.is_idle:
            raise Refusal("moving", "errors cannot be cleared while an axis moves", "wait for its end, or stop it")
        await unit.session.send_repeatable(("cerr",), ASK_STATUS)
        self._log.info("the controller is unblocked and its errors are cleared")
        if not unit.introduced:
            await self.configure()
        await self.connection.watch.restore_settings()

    async def send_raw(self, command: str) -> str:
        unit = self.connection.state
        if not command.isascii() or not command.isprintable():
            raise Refusal("raw-line", "a raw command is one line of printable ASCII", "send one line")
        reply = await unit.session.send_raw(command)
        unit.profiles.clear()
        return reply

    async def close(self) -> None:
        old_connection, self._connection = self._connection, None
        if old_connection is not None:
            session = old_connection.state.session
            self._log.info("link closed")
            self._token = session.last_token
            self._save_token(session)
            old_connection.mover.drop_move()
            await old_connection.state.stopper.close()
            await session.close()

    # Internals

    @property
    def _output_lock(self) -> asyncio.Lock:
        return self.connection.state.output_lock

    def _save_token(self, session: PpSmcSession) -> None:
        if session.batches.restarted:
            self._restarted, session.batches.restarted = True, False
            self._spoiled.clear()  # it has no reference any more, and will search for one
            self._log.warning("the controller was restarted: its volatile state is lost")
            self._crystal.discard_moves()
