"""The SMC-4000: its driver, and the check of its part of the fleet file."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal

from pydantic import BaseModel

from adapters.abilities import LatchDriver, LimitProbeDriver, LineProbeDriver, ProbeDriver
from adapters.contract import (
    AxisReading,
    ControllerReading,
    Driver,
    DriverCapabilities,
    DriverSetup,
    ExamplePlace,
    LatchedPosition,
    LimitMove,
    Lowered,
    ProbedContact,
    ProbeMove,
    require_no_problems,
    validate_options,
)
from adapters.toolkit.frames import FrameDecoder
from adapters.toolkit.refusals import log_refusals
from adapters.yaskawa.common.checks import Terminals, find_model_problems
from adapters.yaskawa.common.continuing import EXTENSION_EXCHANGES
from adapters.yaskawa.common.decoder import YaskawaDecoder
from adapters.yaskawa.common.device import HandleTraits, SmcDevice, stop_commands
from adapters.yaskawa.common.driver import LIMITS, STEPPER_TYPE, YaskawaDriver
from adapters.yaskawa.common.lowering import (
    START_CLASSES,
    STOP_EXCHANGES,
    LoweringContext,
    find_chunk_times,
    lower_moves,
)
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.sampling import DeviceSampling, SamplingLimits
from adapters.yaskawa.common.settings import configure_controller
from adapters.yaskawa.common.start import SampleStart
from adapters.yaskawa.common.watch import SETTINGS_AT_ONCE, SMC4000_WATCHED, SettingsWatch, require_uncoupled
from adapters.yaskawa.common.watchdog import find_alone_s
from adapters.yaskawa.language.dialect import motor_indices
from adapters.yaskawa.pairs.checks import find_pair_problems
from adapters.yaskawa.pairs.gearing import find_pairs, gear_motors, join_readings
from adapters.yaskawa.pairs.homing import PairHoming
from adapters.yaskawa.shapes.model import SMC4000, ModelTraits
from adapters.yaskawa.triggers.latch import LATCH_INPUTS, LATCHES, PositionLatch
from adapters.yaskawa.triggers.limit_probe import LimitProbe, find_limit_ability
from adapters.yaskawa.triggers.line_probe import LineProbe, find_line_ability
from adapters.yaskawa.triggers.lowering import NO_TRIGGERS, TriggerNeeds, add_triggers, find_chunk_triggers, find_needs
from adapters.yaskawa.triggers.probe import LatchProbe, LatchTarget, find_ability, require_encoder
from adapters.yaskawa.triggers.program_probe import ProgramProbe, find_program_ability
from adapters.yaskawa.triggers.table import TriggerPlayer
from adapters.yaskawa.triggers.traits import SMC4000_TRIGGERS
from adapters.yaskawa.wire.exchange import parse_reply
from adapters.yaskawa.wire.record import (
    AXIS_LETTERS,
    FORWARD_SWITCH,
    RECORD_LETTERS,
    REVERSE_SWITCH,
    AxisRecord,
    DataRecord,
)
from adapters.yaskawa.wire.session import pack_operands
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller, DigitalInput, SerialLink
from orchestrator.model.links import UdpLink
from orchestrator.model.messages import StartOptions
from orchestrator.model.plugins import API_VERSION
from orchestrator.model.profile import Profile
from orchestrator.model.state import ProbeAbility, StepCosts

AXES = 4
FREE_OWN_HANDLE = b"IHS=>-2\r"  # over UDP the controller cannot otherwise detect that a client has gone (L5851)
BAUD_RATES = (9600, 19200)  # by jumper JP2 (L599, L851)
LONGEST_EXCHANGE = 80  # characters, sent and received
LATCH_TARGET_OFF = 0  # LT (L7147)
POINTS = 8  # inputs, outputs (L390, L470)
RELEASE_NS = 3 * NS_PER_MS  # in which a request to withdraw a following step arrives
SAMPLED_AXES = 8  # arrays of the record mode (L9216)
UPLOAD_ELEMENTS = 100  # of a sampled array at once
ARM_EXCHANGES = 14
DISARM_EXCHANGES = 5
NAMES = (AXIS_LETTERS[:AXES], RECORD_LETTERS)
TERMINALS = Terminals(NAMES, "X, Y, Z, W (or A, B, C, D)", POINTS, POINTS)
LEAVE_EXCHANGES = 2  # contour mode is left before a step; a refusal is queried

_BITS = tuple({number + 1: bool(value >> number & 1) for number in range(POINTS)} for value in range(1 << POINTS))


class SMC4000Driver(YaskawaDriver[SmcDevice], LatchDriver, ProbeDriver, LineProbeDriver, LimitProbeDriver):
    """One SMC-4000."""

    # After the first ones the controller accepts no commands; QR is answered by a record.
    NOT_BY_RAW = ("DL", "ED", "QD", "IN", "QR")
    DEVICE: type[SmcDevice] = SmcDevice
    OPTIONS: type[YaskawaOptions] = YaskawaOptions
    ORDERS: tuple[Literal[2, 3], ...] = (2, 3)
    EXTENDS = True
    """A move on its way can be sent farther."""

    def __init__(self, setup: DriverSetup) -> None:
        options = self.OPTIONS.model_validate(setup.options.model_dump())
        if isinstance(setup.config.link, SerialLink):
            wire_us = LONGEST_EXCHANGE * 10 * 1_000_000 // setup.config.link.baud
            options = options.model_copy(update={"round_trip_us": options.round_trip_us + wire_us})
        motors = motor_indices(setup.config, NAMES)
        goodbye = FREE_OWN_HANDLE if isinstance(setup.config.link, UdpLink) else b""
        handles = HandleTraits(goodbye, shared=isinstance(setup.config.link, SerialLink))
        self._pairs = find_pairs(setup.config, NAMES)
        second = {name: pair.second for name, pair in self._pairs.items()}
        all_motors = [*motors.items(), *second.items()]
        axes_needed = max(index for _, index in all_motors) + 1
        device = self.DEVICE(setup.clock, setup.open_link, options, axes_needed, handles)
        serial = isinstance(setup.config.link, SerialLink)
        watch = SettingsWatch(device, all_motors, SMC4000_WATCHED, slow=serial)
        start = SampleStart(device, setup.clock, options, TriggerPlayer(device, setup.clock, options, SMC4000_TRIGGERS))
        super().__init__(setup, motors, device, start, watch)
        self._second = second
        char_ns = 10 * NS_PER_S // setup.config.link.baud if isinstance(setup.config.link, SerialLink) else NS_PER_US
        limits = SamplingLimits.of_link(SAMPLED_AXES, UPLOAD_ELEMENTS, options.exchange_ns, char_ns)
        self._sampling = DeviceSampling(device, motors, limits)
        self._serial = serial
        self._options = options
        # The level of the limit bits at rest, by motor: it depends on the configuration of the switches (L10906-10939).
        self._open_switches: dict[int, int] = {}
        self._capabilities = self._compute_capabilities()

    # Connection

    async def configure(self) -> None:
        await require_uncoupled(self._device, self._motors, gantry=lambda letter: f"_GM{letter}")
        await configure_controller(self._device, self._config, self._options, self._all_motors)
        for pair in self._pairs.values():
            await gear_motors(self._device, pair)
        record = await self._device.read_record()
        for name, index in self._all_motors:
            letter, switches = AXIS_LETTERS[index], record.axes[index].switches
            operands = (f"_LF{letter}", f"_LR{letter}", f"_MT{letter}")
            (forward_free, reverse_free, motor_type), _ = await self._device.session.read_numbers(*operands)
            pressed_switches = (0 if forward_free else FORWARD_SWITCH) | (0 if reverse_free else REVERSE_SWITCH)
            self._open_switches[index] = (switches ^ pressed_switches) & (FORWARD_SWITCH | REVERSE_SWITCH)
            (self._steppers.add if abs(motor_type) >= STEPPER_TYPE else self._steppers.discard)(name)
        await self._watch.learn_values()

    @property
    def capabilities(self) -> DriverCapabilities:
        return self._capabilities

    def _compute_capabilities(self) -> DriverCapabilities:
        exchange_ns = self._options.exchange_ns
        release_ns = round(self._device.gate.release_before * self._options.tick_ns)
        ramp_s = max(axis.limits.velocity / axis.limits.acceleration for axis in self._config.axes.values())
        costs = StepCosts(
            arm_ns=ARM_EXCHANGES * exchange_ns + self._settings_ns(),
            # A release must be sent before the gate is decided; a program that passed it can be halted up to the start.
            disarm_ns=max(release_ns, DISARM_EXCHANGES * exchange_ns),
            stop_ns=round(ramp_s * NS_PER_S) + STOP_EXCHANGES * exchange_ns,
        )
        no_paths = 3 not in self.ORDERS or self._serial or bool(self._pairs)
        context = None if no_paths else self._context(costs)
        chunk_s, load_s = (0.0, 0.0) if context is None else find_chunk_times(context, self._options.tick_ns)
        return DriverCapabilities(
            start_classes=START_CLASSES,
            orders=(2,) if self._pairs else self.ORDERS,
            independent_axes=False,
            costs=costs,
            chunk_s=chunk_s,
            chunk_load_s=load_s,
            chunk_triggers=None if context is None else find_chunk_triggers(context),
            retarget_s=EXTENSION_EXCHANGES * exchange_ns / NS_PER_S if self.EXTENDS and not self._pairs else 0.0,
            retarget_way="extend",
            jog_ramps=True,
            shows_inputs=True,
            alone_s=find_alone_s(self._device, self._options),
        )

    def _settings_ns(self) -> int:
        """Return how long the check of the settings before a step takes."""
        options, operands = self._options, self._watch.arm_operands
        lines = len(pack_operands(operands))
        # On the serial port the round trip contains the characters of one line; otherwise it is that of a packet.
        trips = 2 * lines if self._serial else -(-len(operands) // SETTINGS_AT_ONCE)
        leaving_ns = LEAVE_EXCHANGES * options.exchange_ns
        return leaving_ns + (lines * options.decode_us + trips * options.round_trip_us) * NS_PER_US

    @property
    def traits(self) -> ModelTraits:
        """The bounds of the model's registers."""
        return SMC4000

    # Polling

    async def poll(self) -> ControllerReading:
        record, is_restarted = await self._device.poll_state()
        axes = {name: self._read_axis(name, record) for name in self._motors}
        return ControllerReading(
            at_ns=(record.sent_ns + record.received_ns) // 2,
            axes=axes,
            inputs=_BITS[record.inputs],
            outputs=_BITS[record.outputs],
            faults=await self._read_faults(record),
            restarted=is_restarted,
            sampled=self._device.samples.find_sampling_interval(record.sent_ns, record.received_ns),
        )

    def _read_axis(self, name: str, record: DataRecord) -> AxisReading:
        reading, pair = self._read_motor(name, self._motors[name], record), self._pairs.get(name)
        return reading if pair is None else join_readings(reading, self._read_motor(name, pair.second, record))

    def _read_motor(self, name: str, index: int, record: DataRecord) -> AxisReading:
        axis = record.axes[index]
        closed_switches = axis.switches ^ self._open_switches.get(index, axis.switches)
        return AxisReading(
            commanded_counts=axis.commanded,
            actual_counts=axis.actual,
            velocity_counts_s=axis.velocity_counts_s,
            moving=axis.is_moving,
            enabled=axis.is_enabled,
            limit=LIMITS[bool(closed_switches & FORWARD_SWITCH), bool(closed_switches & REVERSE_SWITCH)],
            # A servo's encoder keeps counting while it is off (L7573), and SH begins from there (L9924).
            position_lost=name in self._steppers and not axis.is_enabled,
        )

    def _off_by_error(self, axis: AxisRecord) -> bool:
        return super()._off_by_error(axis) and not axis.is_enabled

    async def latch_position(self, axis: str, point: DigitalInput, within_ns: int) -> LatchedPosition:
        with log_refusals(self._log, "the latch"):
            return await PositionLatch(self._device, self._clock, self._motors).take(axis, point, within_ns)

    @property
    def probe_ability(self) -> ProbeAbility:
        by_program = find_program_ability(list(self._motors), self._options)
        return find_ability(self._motors, LATCHES).model_copy(update={"slower": by_program})

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        """Axes of two motors come first, one after the other."""
        single_axes = [name for name in axes if name not in self._pairs]
        if len(single_axes) == len(axes):
            return await super().home_axes(axes, found)
        self._jogging.drop_jogs(axes)
        stops = {index: self._device.stop_counts.stop_count(index) for _, index in self._find_motors(axes)}
        failures: dict[str, Refusal] = {}
        for pair in [self._pairs[name] for name in axes if name in self._pairs]:
            refusal = await PairHoming(self._device, self._clock, pair, self._config.axes[pair.axis], stops).run()
            if refusal is None:
                found(pair.axis)
            else:
                failures[pair.axis] = refusal
        return failures | await self._home_single(single_axes, stops, found)

    async def _home_single(
        self, axes: Sequence[str], stops: Mapping[int, int], found: Callable[[str], None]
    ) -> dict[str, Refusal]:
        """Home axes of one motor, unless they were stopped since their numbers of stops were `stops`."""
        try:
            for name in axes:
                self._device.stop_counts.require_no_stop(name, self._motors[name], stops[self._motors[name]])
            return dict(await super().home_axes(axes, found)) if axes else {}
        except Refusal as refusal:
            return dict.fromkeys(axes, refusal)

    async def probe_axis(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        require_encoder(axis, self._steppers)
        self._jogging.drop_jogs([axis])
        device, index = self._device, self._motors[axis]
        if not move.active or move.point.number != LATCH_INPUTS[index]:
            with log_refusals(self._log, "the probe"):
                motors = {axis: index}
                contacts = await ProgramProbe(device, self._clock, self._options, self.traits, motors).run({axis: move})
            return None if contacts is None else contacts[axis]
        latch = PositionLatch(device, self._clock, self._motors)
        target = LatchTarget(LATCH_TARGET_OFF, self.traits, self._watch)
        with log_refusals(self._log, "the probe"):
            return await LatchProbe(device, self._clock, latch, target, index).run(axis, move)

    @property
    def line_ability(self) -> ProbeAbility | None:
        return find_line_ability(self._motors, self._options)

    async def probe_line(self, moves: Mapping[str, ProbeMove]) -> Mapping[str, ProbedContact] | None:
        for axis in moves:
            require_encoder(axis, self._steppers)
        self._jogging.drop_jogs(list(moves))
        motors = {axis: self._motors[axis] for axis in moves}
        with log_refusals(self._log, "the probe"):
            return await LineProbe(self._device, self._clock, self._options, self.traits, motors).run(moves)

    @property
    def limit_ability(self) -> ProbeAbility | None:
        return find_limit_ability(self._options)

    async def probe_limit(self, axis: str, move: LimitMove) -> ProbedContact | None:
        self._jogging.drop_jogs([axis])
        ability = find_limit_ability(self._options)
        with log_refusals(self._log, "the probe"):
            return await LimitProbe(self._device, self.traits, ability, self._motors[axis]).run(axis, move)

    # Steps

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> Lowered:
        context = self._context(self._capabilities.costs, find_needs(start, SMC4000_TRIGGERS))
        return add_triggers(lower_moves(context, profiles, start, mapping), context, SMC4000_TRIGGERS, start, mapping)

    def _context(self, costs: StepCosts, needs: TriggerNeeds = NO_TRIGGERS) -> LoweringContext:
        return LoweringContext(
            self._config,
            self._motors,
            self._options,
            costs,
            self.traits,
            gate=self._device.gate,
            axes=self._device.axes_count,
            begins_at_once=True,
            release_ns=RELEASE_NS,
            geared=frozenset(self._pairs),
            beside_commands=needs.commands,
            beside_elements=needs.elements,
        )


_EXAMPLE = """\
adapter: smc4000
link: {{kind: tcp, host: 192.168.1.{host}, port: 23}} # or: {{kind: serial, device: /dev/ttyUSB{port}}}
axes:
  x:
    motors: [X] # X, Y, Z or W
    unit: mm # m, cm, mm, um, nm, in, deg, arcmin, arcsec, rad, mrad, rev, counts
    scale: 1000 # counts per mm, exact; a fraction in quotes: "10000/3"
    sign: 1 # -1: the controller counts in the opposite direction
    soft_limits: {{min: -10, max: 400}} # after homing, where position 0 is
    limits: {{velocity: 200 mm/s, acceleration: 1000 mm/s²}}
    homing: {{method: default, speed: 20 mm/s, timeout_s: 60}} # home switch, then index; or: edge, index
  y:
    motors: [Y]
    unit: mm
    scale: 1000
    soft_limits: {{min: -10, max: 300}}
    limits: {{velocity: 200 mm/s, acceleration: 1000 mm/s²}}
    homing: {{speed: 20 mm/s}}
inputs:
  door: {{number: 1, active: low}} # low: active while the input is at 0 V
outputs:
  lamp: {{number: 1, safe: false}} # safe: what an e-stop sets
"""


class SMC4000Make:
    """The make for the entry point."""

    api_version = API_VERSION
    name = "smc4000"
    options_model: type[BaseModel] = YaskawaOptions
    gears_motors = True

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(host=place.own_port + 20, port=place.own_port)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        return {"baud": BAUD_RATES[-1]}

    def check_config(self, config: Controller) -> None:
        require_no_problems(self._find_problems(config))

    def _find_problems(self, config: Controller) -> Iterator[str]:
        if isinstance(config.link, SerialLink) and config.link.baud not in BAUD_RATES:
            yield f"link.baud: {config.link.baud}; the serial port has {' or '.join(map(str, BAUD_RATES))}"
        options = validate_options(YaskawaOptions, config)
        yield from find_model_problems(config, TERMINALS, options)
        yield from find_pair_problems(config, options)

    def create_driver(self, setup: DriverSetup) -> Driver:
        return SMC4000Driver(setup)

    def make_decoder(self, options: Mapping[str, Any]) -> FrameDecoder:
        del options
        return YaskawaDecoder(parse_reply)

    def stop_bytes(self, config: Controller) -> bytes:
        # A fresh connection has its own line buffer; on the serial port a half-typed command may precede.
        flush = "\\\r" if isinstance(config.link, SerialLink) else ""
        return (flush + "".join(f"{command}\r" for command in stop_commands(abort=False))).encode("ascii")


MAKE = SMC4000Make()
