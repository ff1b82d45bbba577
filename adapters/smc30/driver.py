"""The driver of one SMC30, alone on its line or on a bus."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from adapters.abilities import LearningDriver, ManualDriver, OutputDriver, ProbeDriver, SettingsDriver, SharedLineDriver
from adapters.contract import (
    ControllerIdentity,
    ControllerReading,
    DriverCapabilities,
    DriverSetup,
    JogMove,
    ProbedContact,
    ProbeMove,
    SettingDifference,
)
from adapters.smc30 import startup
from adapters.smc30.costs import step_costs, target_arm_ns
from adapters.smc30.hand import Smc30ManualMotion
from adapters.smc30.line import SHARED, Smc30Line
from adapters.smc30.lowering import (
    LINES_BEFORE,
    ConnectionTraits,
    SlotSchedule,
    Smc30Lowered,
    lower_step,
    make_slot_schedule,
)
from adapters.smc30.mover import Smc30Mover
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.polling import Smc30Poller
from adapters.smc30.probe import InputProbe, find_ability
from adapters.smc30.session import ControllerBusy, Smc30Session
from adapters.smc30.step import passive_commands
from adapters.smc30.unitaxis import line_address, only_axis
from adapters.smc30.unitstate import Smc30State
from adapters.toolkit.connection import ConnectedDriver
from adapters.toolkit.host_start import MoverTools
from adapters.toolkit.refusals import log_refusals
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.latency import StartLatency
from orchestrator.clock.rate import CrystalRate
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import SerialLink
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import ProbeAbility, StepCosts

_BITS = 10  # of a character: start, seven data, parity, stop (L1003-L1011)
_BRIDGE_BAUD = 9600  # behind a TCP bridge: the fastest baud rate of the controller


@dataclass(frozen=True, slots=True)
class Smc30Connection:
    """Everything that exists only while the controller is connected."""

    state: Smc30State
    mover: Smc30Mover
    manual: Smc30ManualMotion
    poller: Smc30Poller


class Smc30Driver(
    ConnectedDriver[Smc30Connection],
    SettingsDriver,
    LearningDriver,
    ProbeDriver,
    ManualDriver,
    OutputDriver,
    SharedLineDriver,
):
    """Drive one controller. Its exchanges take turns with those of the other controllers of its line; a stop bypasses
    them."""

    def __init__(self, setup: DriverSetup, options: Smc30DriverOptions) -> None:
        super().__init__(setup, Smc30Lowered)
        self._config = setup.config
        self._options = options
        self._clock = setup.clock
        self._axis, axis = only_axis(setup.config)
        self._address = line_address(setup.config)
        link = setup.config.link
        baud = link.baud if isinstance(link, SerialLink) else _BRIDGE_BAUD
        self._char_ns = _BITS * NS_PER_S // baud
        answer_ns = options.answer_ms * NS_PER_MS
        self._line: Smc30Line = setup.shared.setdefault(
            SHARED, Smc30Line(setup.clock, with_checksum=options.checksum, answer_ns=answer_ns)
        )
        self._line.register_controller(self._address, answer_ns)
        self._ramp_s = axis.limits.velocity / axis.limits.acceleration
        self._enabled = True
        self._lost = False
        # These outlive a connection.
        self._crystal = options.unread_clock(LINES_BEFORE)
        self._is_connected = False
        self._restarted = False

    # Connection

    async def connect(self) -> ControllerIdentity:
        if self._line.with_checksum != self._options.checksum:
            raise ControllerFault(
                "config-mismatch",
                f"{self._setup.config.link.endpoint}: the controllers of one line have different values "
                "of option `checksum`",
                "set the same value for all of them, and set their switches CHS accordingly",
            )
        await self._line.attach_controller(self._address, self._setup.open_link, self._char_ns)
        session = Smc30Session(self._line, self._clock, self._address, with_checksum=self._options.checksum)
        session.log = self._log
        self._log.info("link opened", place=self._config.link.endpoint)
        unit = Smc30State(session, self._clock, enabled=self._enabled, lost=self._lost)
        mover = Smc30Mover(
            self._options, MoverTools(self._clock, self._setup.timed_writer, self._crystal), unit, self._slot_schedule
        )
        manual = Smc30ManualMotion(
            self._config, self._options, self._clock, unit, lambda: mover.move is not None or unit.doing == "home"
        )
        poller = Smc30Poller(self._config, self._clock, unit, mover, manual)
        self._connection = Smc30Connection(state=unit, mover=mover, manual=manual, poller=poller)
        await startup.verify_identity(unit)
        number = "" if self._address is None else f"address {self._address}"
        identity = ControllerIdentity(model="SMC30", firmware="", serial=number)
        self.log_identity(self._config.link.endpoint, identity)
        return identity

    async def configure(self) -> None:
        fresh = await startup.configure_controller(self.connection.state, self._options, self._clock)
        # Reported by the next poll: a reconnecting adapter must learn that the controller was off meanwhile.
        self._restarted = self._restarted or (fresh and self._is_connected)
        if fresh:
            self._log.info("the controller was switched on since the last connection; its settings are loaded")
            self._crystal.discard_moves()
            self.connection.state.lost = False
        self._is_connected = True

    @property
    def _slot_schedule(self) -> SlotSchedule:
        return make_slot_schedule(
            self._options, self._char_ns, self._line.order_index(self._address), len(self._line.units)
        )

    def _step_costs(self, ramp_s: float) -> StepCosts:
        return step_costs(self._options, self._char_ns, self._slot_schedule, ramp_s)

    @property
    def capabilities(self) -> DriverCapabilities:
        return DriverCapabilities(
            start_classes=("host", "line"), orders=(2,), independent_axes=False, costs=self._step_costs(self._ramp_s)
        )

    async def poll(self) -> ControllerReading:
        unit, poller = self.connection.state, self.connection.poller
        reading = await poller.poll_state()
        is_restarted, self._restarted = self._restarted, False
        self._lost = unit.lost
        return replace(reading, restarted=is_restarted)

    async def check_settings(self, *, everything: bool) -> Sequence[SettingDifference]:
        """Set the currents again before a step: no query shows them. At rest nothing is sent, because a client that
        programs the controller would get it into its program. Raises `Refusal` while the controller is busy."""
        if everything:
            unit = self.connection.state
            for command in startup.current_commands(self._options, enabled=unit.enabled):
                await self._send_setting(command)
        return ()

    # Steps

    def crystal_rate(self) -> CrystalRate:
        return self._crystal.crystal_rate

    def start_latency(self) -> StartLatency:
        return self._crystal.start_latency_at(self._clock.now_ns())

    def forget_starts(self) -> None:
        self._crystal.forget_starts()

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> Smc30Lowered:
        ramp_s = max([self._ramp_s, *(max(profile.durations_s, default=0.0) for profile in profiles.values())])
        estimate = self._crystal.estimate_at(self._clock.now_ns())
        traits = ConnectionTraits(
            self._step_costs(ramp_s),
            self._slot_schedule,
            estimate,
            self._char_ns,
            None if self._connection is None else self._connection.state.program,
            target_arm_ns(self._options, self._char_ns, self._slot_schedule),
        )
        return lower_step(self._config, self._options, traits, dict(profiles), start)

    async def stop(self, *, abort: bool) -> None:
        """Stop with Z, by the ramp of the motion; or with K, at once, after which its counter may be wrong
        (L1848-L1859)."""
        unit, mover = self.connection.state, self.connection.mover
        last_commands = passive_commands(mover.move.lowered) if mover.move is not None else ()
        mover.record_stop(unit.write_stop("K" if abort else "Z", *last_commands))
        self._log.info("stop written", abort=abort)

    async def stop_before_connect(self) -> bool:
        if self._address is None:
            return False
        await self._line.attach_controller(self._address, self._setup.open_link, self._char_ns)
        session = Smc30Session(self._line, self._clock, self._address, with_checksum=self._options.checksum)
        session.log = self._log
        self._log.info("stopping the controller before it is connected", place=self._config.link.endpoint)
        await Smc30State(session, self._clock).stop_and_confirm()
        return True

    # Manual operation

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        """Enable or disable by the standby current: the controller has no other switch for its motor (L1998-L2001)."""
        if not axes:
            return
        unit = self.connection.state
        await unit.wait_for_stops()
        await self._send_setting(f"CS{self._options.standby_ma if on else 0}")
        unit.enabled = self._enabled = on

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        manual = self.connection.manual
        return await manual.find_reference(found) if axes else {}

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        await self.connection.manual.start_jog(move)

    @property
    def probe_ability(self) -> ProbeAbility:
        return find_ability(self._axis, self._options)

    async def probe_axis(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        connection = self.connection
        with log_refusals(self._log, "the probe"):
            return await InputProbe(connection.manual, connection.state, self._clock, self._options).run(axis, move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        if axes:
            self.connection.state.write_stop("Z")

    async def set_output(self, number: int, *, on: bool) -> None:
        await self._send_setting(f"{'A' if on else 'C'}{number}")

    async def clear_faults(self) -> None:
        """Clear errors. The error of a program is reported once; an overflowed counter is rewritten (L1807-L1816), and
        the position of the axis is unknown then."""
        unit = self.connection.state
        await unit.wait_for_stops()
        unit.program_error = False
        unit.limit = "none"
        if not (await unit.read_status()).busy and unit.overflow:
            try:
                counts = await unit.read_position()
            except ControllerBusy:
                raise unit.moving_refusal() from None
            await self._send_setting(f"f{max(-8_388_606, min(8_388_606, counts)):+d}")
            unit.overflow, unit.lost = False, True
            self._log.warning("the position counter had overflowed; the position of the axis is unknown")
        unit.program_error = False

    async def send_raw(self, command: str) -> str:
        unit = self.connection.state
        if not command.isascii() or not command.isprintable():
            raise Refusal("raw-line", "a raw command is one line of printable ASCII", "send one line")
        async with unit.loading:
            unit.program = None
            return await unit.session.send_raw(command)

    async def close(self) -> None:
        old_connection, self._connection = self._connection, None
        if old_connection is None:
            return
        self._log.info("link closed")
        old_connection.mover.drop_start()
        old_connection.state.cancel_confirmations()
        await self._line.detach_controller(self._address)

    # Internals

    async def _send_setting(self, command: str) -> None:
        unit = self.connection.state
        session = unit.session
        try:
            async with unit.loading:
                await unit.leave_programming()
                await session.send_setting(command)
        except ControllerBusy:
            text = f"{session.name} executes a program, and accepts no {command}"
            raise Refusal("moving", text, "wait for its end, or stop it") from None
