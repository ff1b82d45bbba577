"""The SMC-2000: its driver, and the check of its part of the fleet file."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from pydantic import BaseModel

from adapters.abilities import ProbeDriver, SharedLineDriver
from adapters.contract import (
    AxisReading,
    ControllerReading,
    Driver,
    DriverCapabilities,
    DriverSetup,
    ExamplePlace,
    Lowered,
    ProbedContact,
    ProbeMove,
    require_no_problems,
    validate_options,
)
from adapters.toolkit.frames import FrameDecoder
from adapters.toolkit.refusals import log_refusals
from adapters.yaskawa.common.arrays import SlowArrayTransfer
from adapters.yaskawa.common.checks import Terminals, find_model_problems
from adapters.yaskawa.common.continuing import EXTENSION_EXCHANGES
from adapters.yaskawa.common.decoder import YaskawaDecoder
from adapters.yaskawa.common.driver import LIMITS, STEPPER_TYPE, YaskawaDriver
from adapters.yaskawa.common.lowering import (
    LOOP_COMMANDS,
    START_CLASSES,
    STOP_EXCHANGES,
    LoweringContext,
    lower_moves,
)
from adapters.yaskawa.common.program import PULSE_LABEL
from adapters.yaskawa.common.sampling import DeviceSampling, SamplingLimits
from adapters.yaskawa.common.settings import configure_controller
from adapters.yaskawa.common.slots import SampleMover
from adapters.yaskawa.common.watch import SMC2000_WATCHED, SettingsWatch, require_uncoupled
from adapters.yaskawa.common.watchdog import find_alone_s
from adapters.yaskawa.language.dialect import motor_indices
from adapters.yaskawa.shapes.model import SMC2000
from adapters.yaskawa.smc2000 import program as smc2000_program
from adapters.yaskawa.smc2000.device import LineAddress, PolledPoints, SerialDevice, stop_commands
from adapters.yaskawa.smc2000.line import SHARED, SharedSerialLine
from adapters.yaskawa.smc2000.options import Smc2000DriverOptions
from adapters.yaskawa.smc2000.program import AXES_MOST, INPUTS_OF_WORD, LETTERS, OUTPUTS_OF_WORD
from adapters.yaskawa.smc2000.replies import parse_serial_reply
from adapters.yaskawa.smc2000.slots import SerialMover
from adapters.yaskawa.smc2000.start import SerialStart
from adapters.yaskawa.triggers.latch import PositionLatch
from adapters.yaskawa.triggers.lowering import NO_TRIGGERS, add_triggers, find_needs
from adapters.yaskawa.triggers.probe import LatchProbe, LatchTarget, find_ability, require_encoder
from adapters.yaskawa.triggers.table import TriggerPlayer
from adapters.yaskawa.triggers.traits import TriggerTraits
from adapters.yaskawa.wire.record import FORWARD_SWITCH, REVERSE_SWITCH, AxisRecord
from orchestrator.clock.base import NS_PER_S, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller, DigitalInput, DigitalOutput, SerialLink
from orchestrator.model.messages import StartOptions
from orchestrator.model.plugins import API_VERSION
from orchestrator.model.profile import Profile
from orchestrator.model.state import ProbeAbility, StepCosts

SECOND_LETTERS = "ABCDEFGH"  # alternative letters for the same axes (L1044-1048)
CHAIN_ADDRESSES = range(8)  # addresses in a chain (L939)
# of elements per transfer: other controllers of a chain wait an eighth of a second for their turn
ARRAY_CHARACTERS = 240
ARRAY_BACK = 40  # elements per upload
SAMPLED_AXES = (4, 8)  # arrays of the record mode: of models with up to four axes, and of larger ones (L11043)
STEPPER_SPEED_MAX = 2_000_000  # counts/s (L11552)

LATCH_TARGET_OFF = 2_147_483_647  # LT (L10166)

# For the declared costs: characters of an exchange, sent and received, while arming.
EXCHANGE_CHARACTERS = 36
POLL_CHARACTERS = 24, 24  # of a poll's line, plus a number for each axis
ARM_EXCHANGES = 9
# Of the check of the settings before a step: characters of one line and its answer, and how many axes it covers.
SETTINGS_CHARACTERS = 95
SETTINGS_AXES = 2
RELEASE_EXCHANGES = 2  # of a step that follows another one
DISARM_EXCHANGES = 8  # exchanges that must fit in before the start: commit, release, and the withdrawal of both
NAMES = (LETTERS, SECOND_LETTERS)
# Of the controller with eight axes (L742, L746).
TERMINALS = Terminals(NAMES, "X, Y, Z, W (or A, B, C, D), E, F, G, H", inputs=24, outputs=16)


def _word_count(points: Mapping[str, DigitalInput] | Mapping[str, DigitalOutput], size: int) -> int:
    """Return how many words of `size` points cover everything that the fleet file names."""
    return max((-(-point.number // size) for point in points.values()), default=0)


def _make_trigger_traits(axes: int, char_ns: int) -> TriggerTraits:
    """Return how a controller of `axes` axes plays triggers: a poll takes a command for each of them, and two more."""
    other_commands = smc2000_program.WATCHDOG_COMMANDS + smc2000_program.HOST_COMMANDS + axes + 2
    return TriggerTraits(
        level_label=PULSE_LABEL,
        pulse_commands=smc2000_program.PULSE_COMMANDS,
        level_commands=smc2000_program.LEVEL_COMMANDS,
        other_commands=other_commands,
        beside=smc2000_program.TRIGGER_BESIDE,
        contour_commands=LOOP_COMMANDS,
        packet=ARRAY_CHARACTERS,
        back=ARRAY_BACK,
        char_ns=char_ns,
    )


class SMC2000Driver(YaskawaDriver[SerialDevice], ProbeDriver, SharedLineDriver):
    """One SMC-2000, alone on its port or in a daisy chain."""

    # After the first ones the controller accepts no commands; the others select controllers of a chain.
    NOT_BY_RAW = ("DL", "QD", "IN", "%", "!")

    def __init__(self, setup: DriverSetup) -> None:
        link = setup.config.link
        assert isinstance(link, SerialLink)
        options = Smc2000DriverOptions.model_validate(setup.options.model_dump())
        motors = motor_indices(setup.config, NAMES)
        self._options = options
        self._char_ns = 10 * NS_PER_S // link.baud
        self._serial_line: SharedSerialLine = setup.shared.setdefault(SHARED, SharedSerialLine())
        # Only what the fleet file names is polled: every character takes half a millisecond.
        inputs, outputs = (
            _word_count(setup.config.inputs, INPUTS_OF_WORD),
            _word_count(setup.config.outputs, OUTPUTS_OF_WORD),
        )
        self._points = inputs * INPUTS_OF_WORD, outputs * OUTPUTS_OF_WORD
        device = SerialDevice(
            LineAddress(self._serial_line, link.address),
            setup.clock,
            setup.open_link,
            options,
            PolledPoints(sorted(motors.values()), inputs, outputs),
        )
        watch = SettingsWatch(device, motors.items(), SMC2000_WATCHED, slow=True)
        self._triggers = _make_trigger_traits(len(motors), self._char_ns)
        start = SerialStart(device, setup.clock, options, TriggerPlayer(device, setup.clock, options, self._triggers))
        super().__init__(setup, motors, device, start, watch)
        channels = SAMPLED_AXES[max(motors.values()) >= SAMPLED_AXES[0]]
        limits = SamplingLimits.of_link(channels, ARRAY_BACK, options.exchange_ns, self._char_ns)
        self._sampling = DeviceSampling(device, motors, limits)
        # The time that the shared lowering assumes for a command of a stop.
        wire_us = EXCHANGE_CHARACTERS * self._char_ns // NS_PER_US
        self._slow_exchange_ns = options.model_copy(
            update={"round_trip_us": options.round_trip_us + options.hold_us + wire_us}
        )
        self._contoured = smc2000_program.supports_contours(list(motors.values()))
        self._model = replace(SMC2000, contours=self._contoured)

    # Connection

    async def configure(self) -> None:
        await require_uncoupled(self._device, self._motors, gantry=lambda letter: "")
        await configure_controller(self._device, self._config, self._options, self._motors.items())
        types, _ = await self._device.session.read_numbers(*(f"_MT{LETTERS[index]}" for index in self._motors.values()))
        self._steppers = {name for name, kind in zip(self._motors, types, strict=True) if abs(kind) >= STEPPER_TYPE}
        await self._watch.learn_values()

    @property
    def _exchange_ns(self) -> int:
        """Return the duration of an exchange: on a chain it may have to wait for one exchange of every other
        controller."""
        return self._slow_exchange_ns.exchange_ns * len(self._serial_line.units)

    @property
    def capabilities(self) -> DriverCapabilities:
        exchange_ns = self._exchange_ns
        ramp_s = max(axis.limits.velocity / axis.limits.acceleration for axis in self._config.axes.values())
        costs = StepCosts(
            arm_ns=ARM_EXCHANGES * exchange_ns + self._settings_ns(),
            interleaved=True,
            # A release must reach the gate before it is decided.
            disarm_ns=round(self._device.gate.decided_before * self._options.tick_ns) + DISARM_EXCHANGES * exchange_ns,
            stop_ns=round(ramp_s * NS_PER_S) + STOP_EXCHANGES * self._slow_exchange_ns.exchange_ns,
        )
        orders = (2, 3) if self._contoured else (2,)
        return DriverCapabilities(
            start_classes=START_CLASSES,
            orders=orders,
            independent_axes=False,
            costs=costs,
            retarget_s=EXTENSION_EXCHANGES * exchange_ns / NS_PER_S,
            retarget_way="extend",
            jog_ramps=True,
            shows_inputs=True,
            alone_s=find_alone_s(self._device, self._options),
        )

    def _settings_ns(self) -> int:
        """Return how long the check of the settings before a step takes: its lines, and leaving contour mode."""
        lines = -(-len(self._motors) // SETTINGS_AXES)
        more_ns = max(SETTINGS_CHARACTERS - EXCHANGE_CHARACTERS, 0) * self._char_ns
        # Lines of other controllers of a chain are no longer than that.
        return (lines + 1) * self._exchange_ns + lines * more_ns * len(self._serial_line.units)

    # Polling

    async def poll(self) -> ControllerReading:
        record, is_restarted = await self._device.poll_state()
        return ControllerReading(
            at_ns=(record.sent_ns + record.received_ns) // 2,
            axes={name: self._axis_reading(name, record.axes[index]) for name, index in self._motors.items()},
            inputs=_point_levels(record.inputs, self._points[0]),
            outputs=_point_levels(record.outputs, self._points[1]),
            faults=await self._read_faults(record),
            restarted=is_restarted,
            sampled=self._device.samples.find_sampling_interval(record.sent_ns, record.received_ns),
        )

    def _axis_reading(self, name: str, axis: AxisRecord) -> AxisReading:
        open_loop = name in self._steppers
        return AxisReading(
            commanded_counts=axis.commanded,
            # The step counter is the only position of a stepper (TE is not valid for it, L11836).
            actual_counts=axis.commanded if open_loop else axis.actual,
            velocity_counts_s=axis.velocity_counts_s,
            moving=axis.is_moving,
            enabled=axis.is_enabled,
            limit=LIMITS[not axis.switches & FORWARD_SWITCH, not axis.switches & REVERSE_SWITCH],
            # A servo's position is still monitored while it is off (L10447), and SH begins from there (L11494).
            position_lost=open_loop and not axis.is_enabled,
        )

    @property
    def probe_ability(self) -> ProbeAbility:
        return find_ability(self._motors, AXES_MOST)

    async def probe_axis(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        require_encoder(axis, self._steppers)
        self._jogging.drop_jogs([axis])
        latch = PositionLatch(self._device, self._clock, self._motors, AXES_MOST, reads_polarity=False)
        target = LatchTarget(LATCH_TARGET_OFF, self._model, self._watch)
        with log_refusals(self._log, "the probe"):
            return await LatchProbe(self._device, self._clock, latch, target, self._motors[axis]).run(axis, move)

    # Steps

    def lower_profiles(
        self, profiles: Mapping[str, Profile], start: StartOptions, mapping: TickMapping | None
    ) -> Lowered:
        costs = self.capabilities.costs
        upload = SlowArrayTransfer(
            smc2000_program.contour_arrays(sorted(self._motors.values())),
            ARRAY_CHARACTERS,
            ARRAY_BACK,
            exchange_ns=self._exchange_ns,
            char_ns=self._char_ns,
            most_s=self._options.contour_upload_s,
        )
        if start.triggers and self._device.is_chained:
            raise Refusal(
                "trigger-chain",
                f"output {start.triggers[0].output}: a controller on a daisy chain has no triggers, because "
                "loading them would take the line from the watchdogs of the controllers that move",
                "use an output of another controller, or connect this one to a port of its own",
            )
        needs = find_needs(start, self._triggers) if start.triggers else NO_TRIGGERS
        context = LoweringContext(
            config=self._config,
            motors=self._motors,
            options=self._slow_exchange_ns,
            costs=costs,
            model=self._model,
            packets=upload,
            beside_commands=needs.commands,
            beside_elements=needs.elements,
        )
        axes = sorted(self._motors.values())
        if smc2000_program.holds_following_steps(axes, chained=self._device.is_chained):
            release_ns = RELEASE_EXCHANGES * self._exchange_ns
            context = replace(context, gate=self._device.gate, axes=len(axes), release_ns=release_ns)
        return add_triggers(lower_moves(context, profiles, start, mapping), context, self._triggers, start, mapping)

    def _make_mover(self) -> SampleMover:
        return SerialMover(self._start, self._jogging, self._log, self._device, self._poll_ns)

    def _poll_ns(self) -> int:
        """Return the longest duration of a poll."""
        characters = POLL_CHARACTERS[0] + POLL_CHARACTERS[1] * len(self._motors)
        return characters * self._char_ns + self._options.decode_us * NS_PER_US * (len(self._motors) + 2)

    async def stop_before_connect(self) -> bool:
        return await self._device.stop_before_connect()


def _point_levels(word: int, count: int) -> dict[int, bool]:
    return {number + 1: bool(word >> number & 1) for number in range(count)}


_EXAMPLE = """\
adapter: smc2000
# Several in a daisy chain share the port: each has its address, and port 2 of each but the last is set up once by
# `CC 19200,0,1` and `BN`. The first one in this file is next to the computer. Alone on a port: no address.
link: {{kind: serial, device: /dev/ttyUSB{port}, address: {number}}}
axes:
  x:
    motors: [X] # X, Y, Z or W; on models with eight axes A to H
    unit: mm
    scale: 1000 # counts per mm
    soft_limits: {{min: -10, max: 400}}
    limits: {{velocity: 100 mm/s, acceleration: 500 mm/s²}}
    homing: {{method: default, speed: 20 mm/s, timeout_s: 60}} # home switch, then index; or: edge, index
"""


class SMC2000Make:
    """The make for the entry point."""

    api_version = API_VERSION
    name = "smc2000"
    options_model: type[BaseModel] = Smc2000DriverOptions

    def fleet_example(self, place: ExamplePlace) -> str:
        return _EXAMPLE.format(port=place.port, number=place.number)

    @property
    def serial_defaults(self) -> Mapping[str, Any]:
        return {"baud": 19200}  # with the jumper as delivered (L176)

    def check_config(self, config: Controller) -> None:
        require_no_problems(self._find_problems(config))

    def _find_problems(self, config: Controller) -> Iterator[str]:
        link = config.link
        if not isinstance(link, SerialLink):
            yield f"link.kind: {link.kind}; an SMC-2000 needs `kind: serial`"
        elif (link.data_bits, link.parity, link.stop_bits) != (8, "none", 1):
            yield "link: an SMC-2000 has 8 data bits, no parity and 1 stop bit (L177)"
        elif link.address is not None and link.address not in CHAIN_ADDRESSES:
            yield (
                f"link.address: {link.address}; the addresses of a daisy chain are {CHAIN_ADDRESSES.start} to "
                f"{CHAIN_ADDRESSES.stop - 1}"
            )
        if len(config.axes) > AXES_MOST:
            yield f"axes: {len(config.axes)}; at most {AXES_MOST} axes of one SMC-2000 can be driven"
        options = validate_options(Smc2000DriverOptions, config)
        yield from find_model_problems(config, TERMINALS, options)
        for name, axis in config.axes.items():
            stepper = abs(options.motor_type.get(name, 1.0)) >= STEPPER_TYPE
            counts_ms = STEPPER_SPEED_MAX if stepper else SMC2000.speed_max
            most = counts_ms / float(axis.scale) * 1000 / options.servo_period_us
            if axis.limits.velocity > most:
                yield f"axes.{name}.limits.velocity: {axis.limits.velocity:g}; the maximum is {most:g} {axis.unit}/s"

    def create_driver(self, setup: DriverSetup) -> Driver:
        return SMC2000Driver(setup)

    def make_decoder(self, options: Mapping[str, Any]) -> FrameDecoder:
        del options
        return YaskawaDecoder(parse_serial_reply, marked=True)

    def stop_bytes(self, config: Controller) -> bytes:
        """Return bytes that end a half-typed command or a download and stop everything; on a chain `!` reaches all
        controllers, whichever is selected (L947)."""
        link = config.link
        broadcast = "!" if isinstance(link, SerialLink) and link.address is not None else ""
        return "".join(
            f"{command}\r"
            for command in ("\\", *(broadcast + stop_command for stop_command in stop_commands(abort=False)))
        ).encode()


MAKE = SMC2000Make()
