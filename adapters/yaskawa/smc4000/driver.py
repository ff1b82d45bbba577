"""The SMC-4000: driver, and what the fleet file may say about it."""

from collections.abc import Mapping

from pydantic import BaseModel, ValidationError

from adapters.contract import (
    AxisReading,
    CannotDo,
    Capabilities,
    Driver,
    Lowered,
    Reading,
    Setup,
)
from adapters.yaskawa.common import homing
from adapters.yaskawa.common.dialect import motor_indices
from adapters.yaskawa.common.driver import LIMITS, STEPPER_TYPE, YaskawaDriver
from adapters.yaskawa.common.lowering import CLASSES, STOP_EXCHANGES, LoweredMoves, lower_moves
from adapters.yaskawa.common.options import Options
from adapters.yaskawa.common.record import (
    AXIS_LETTERS,
    FORWARD_SWITCH,
    RECORD_LETTERS,
    REVERSE_SWITCH,
    VELOCITY_SCALE,
    AxisRecord,
)
from adapters.yaskawa.common.settings import configure
from adapters.yaskawa.common.start import Start
from adapters.yaskawa.smc4000.device import Device, stop_commands
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.fleet import Controller, SerialLink, UdpLink
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs

AXES = 4
FREE_OWN_HANDLE = b"IHS=>-2\r"  # over UDP nothing else tells that a client has gone (L5851)
BAUD_RATES = (9600, 19200)  # by jumper JP2 (L599, L851)
LONGEST_EXCHANGE = 80  # characters, to and fro
POINTS = 8  # inputs, outputs (L390, L470)
ARM_EXCHANGES = 14
DISARM_EXCHANGES = 5
NAMES = (AXIS_LETTERS[:AXES], RECORD_LETTERS)
MOTORS = "X, Y, Z, W (or A, B, C, D)"
WAITS_FOR_MORE = ("DL", "ED", "QD", "IN")  # after these the controller takes no commands

_BITS = tuple({number + 1: bool(value >> number & 1) for number in range(POINTS)} for value in range(1 << POINTS))


class SMC4000Driver(YaskawaDriver[Device]):
    """One SMC-4000."""

    def __init__(self, setup: Setup) -> None:
        options = Options.model_validate(setup.options.model_dump())
        if isinstance(setup.config.link, SerialLink):
            wire_us = LONGEST_EXCHANGE * 10 * 1_000_000 // setup.config.link.baud
            options = options.model_copy(update={"round_trip_us": options.round_trip_us + wire_us})
        motors = motor_indices(setup.config, NAMES, MOTORS)
        goodbye = FREE_OWN_HANDLE if isinstance(setup.config.link, UdpLink) else b""
        shared = isinstance(setup.config.link, SerialLink)
        device = Device(setup.clock, setup.open_link, options, max(motors.values()) + 1, goodbye, shared)
        super().__init__(setup, motors, device, Start(device, setup.clock, options), (*WAITS_FOR_MORE, "QR"))
        self._options = options
        # The level of the limit bits at rest: it depends on how the switches are configured (L10906-10939).
        self._open_switches: dict[str, int] = {}
        self._capabilities = self._work_out_capabilities()

    # Reaching it

    async def configure(self) -> None:
        await configure(self._device, self._config, self._options, self._motors)
        record = await self._device.record()
        for name, index in self._motors.items():
            letter, switches = AXIS_LETTERS[index], record.axes[index].switches
            operands = (f"_LF{letter}", f"_LR{letter}", f"_MT{letter}")
            (forward_free, reverse_free, motor_type), _ = await self._device.session.numbers(*operands)
            pressed = (0 if forward_free else FORWARD_SWITCH) | (0 if reverse_free else REVERSE_SWITCH)
            self._open_switches[name] = (switches ^ pressed) & (FORWARD_SWITCH | REVERSE_SWITCH)
            (self._steppers.add if abs(motor_type) >= STEPPER_TYPE else self._steppers.discard)(name)

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def _work_out_capabilities(self) -> Capabilities:
        exchange_ns = self._options.exchange_ns
        release_ns = round(self._device.gate.release * self._options.tick_ns)
        ramp_s = max(axis.limits.velocity / axis.limits.acceleration for axis in self._config.axes.values())
        costs = Costs(
            arm_ns=ARM_EXCHANGES * exchange_ns,
            # A release must be told before the gate is decided; who went through it can be halted up to the start.
            disarm_ns=max(release_ns, DISARM_EXCHANGES * exchange_ns),
            stop_ns=round(ramp_s * NS_PER_S) + STOP_EXCHANGES * exchange_ns,
        )
        return Capabilities(start_classes=CLASSES, orders=(2, 3), independent_axes=False, costs=costs)

    # Reading it

    async def poll(self) -> Reading:
        record, restarted = await self._device.poll()
        axes = {name: self._axis_reading(name, record.axes[index]) for name, index in self._motors.items()}
        return Reading(
            at_ns=(record.sent_ns + record.received_ns) // 2,
            axes=axes,
            inputs=_BITS[record.inputs],
            outputs=_BITS[record.outputs],
            faults=await self._faults(record),
            restarted=restarted,
        )

    def _axis_reading(self, name: str, axis: AxisRecord) -> AxisReading:
        closed = axis.switches ^ self._open_switches.get(name, axis.switches)
        return AxisReading(
            commanded_counts=axis.commanded,
            actual_counts=axis.actual,
            velocity_counts_s=axis.velocity / VELOCITY_SCALE,
            moving=axis.moving,
            enabled=axis.enabled,
            limit=LIMITS[bool(closed & FORWARD_SWITCH), bool(closed & REVERSE_SWITCH)],
            # A servo's encoder goes on counting while it is off (L7573), and SH begins from there (L9924).
            lost=name in self._steppers and not axis.enabled,
        )

    def _off_by_error(self, axis: AxisRecord) -> bool:
        return super()._off_by_error(axis) and not axis.enabled

    # A step

    def lower(self, profiles: Mapping[str, Profile], how: StartWay, mapping: TickMapping | None) -> Lowered:
        return lower_moves(self._config, self._motors, self._options, self._capabilities.costs, profiles, how, mapping)

    async def arm(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        if not isinstance(lowered, LoweredMoves):
            raise CannotDo("not-lowered", "this move was lowered for another make", "lower it again")
        self._jogging.forget(move.axis for move in lowered.moves)
        return await self._start.arm(lowered, t0_ns, mapping)


class SMC4000Make:
    """The make as the entry point names it."""

    name = "smc4000"
    options: type[BaseModel] = Options

    def check(self, config: Controller) -> None:
        if isinstance(config.link, SerialLink) and config.link.baud not in BAUD_RATES:
            raise ValueError(f"link.baud: {config.link.baud}; the serial port has {' or '.join(map(str, BAUD_RATES))}")
        motors = motor_indices(config, NAMES, MOTORS)
        for kind, points in (("inputs", config.inputs), ("outputs", config.outputs)):
            for name, point in points.items():
                if point.number > POINTS:
                    raise ValueError(f"{kind}.{name}.number: {point.number}; the unit has {kind} 1 to {POINTS}")
        for name, axis in config.axes.items():
            if axis.homing.method not in homing.METHODS:
                raise ValueError(
                    f"axes.{name}.homing.method: {axis.homing.method!r}; this make has {', '.join(homing.METHODS)}"
                )
        try:
            options = Options.model_validate(config.options)
        except ValidationError as error:
            first = error.errors()[0]
            raise ValueError(f"options.{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
        unknown = [name for name in options.motor_type if name not in motors]
        if unknown:
            raise ValueError(f"options.motor_type: no axis {unknown[0]}; axes are {', '.join(motors)}")

    def driver(self, setup: Setup) -> Driver:
        return SMC4000Driver(setup)

    def stop_bytes(self, config: Controller) -> bytes:
        # A fresh connection has a line buffer of its own; on the serial port something half typed may stand before.
        flush = "\\\r" if isinstance(config.link, SerialLink) else ""
        return (flush + "".join(f"{command}\r" for command in stop_commands(False))).encode("ascii")


MAKE = SMC4000Make()
