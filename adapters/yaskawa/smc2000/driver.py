"""The SMC-2000: driver, and what the fleet file may say about it."""

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace

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
from adapters.yaskawa.common.arrays import SlowUpload
from adapters.yaskawa.common.dialect import motor_indices
from adapters.yaskawa.common.driver import LIMITS, STEPPER_TYPE, YaskawaDriver
from adapters.yaskawa.common.lowering import CLASSES, STOP_EXCHANGES, LoweredMoves, Records, lower_moves
from adapters.yaskawa.common.model import SMC2000
from adapters.yaskawa.common.record import FORWARD_SWITCH, REVERSE_SWITCH, VELOCITY_SCALE, AxisRecord
from adapters.yaskawa.common.settings import configure
from adapters.yaskawa.smc2000 import program as smc2000_program
from adapters.yaskawa.smc2000.device import SerialDevice, stop_commands
from adapters.yaskawa.smc2000.line import SHARED, Line
from adapters.yaskawa.smc2000.options import Smc2000Options
from adapters.yaskawa.smc2000.program import AXES_MOST, INPUTS_OF_WORD, LETTERS, OUTPUTS_OF_WORD
from adapters.yaskawa.smc2000.start import SerialStart
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.fleet import Controller, Input, Output, SerialLink
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile
from orchestrator.model.state import Costs

SECOND_LETTERS = "ABCDEFGH"  # the same axes (L1044-1048)
UNITS = range(8)  # of a chain (L939)
ARRAY_CHARACTERS = 240  # of elements at once: other units of a chain wait an eighth of a second for their turn
ARRAY_BACK = 40  # elements asked back at once
INPUTS, OUTPUTS = 24, 16  # of the unit with eight axes (L742, L746)
STEPPER_SPEED_MAX = 2_000_000  # counts/s (L11552)

# For the costs declared: characters of an exchange, out and in, as they are when arming.
EXCHANGE_CHARACTERS = 36
POLL_CHARACTERS = 24, 24  # of a poll's line, and more for each axis
ARM_EXCHANGES = 9
DISARM_EXCHANGES = 8  # what must fit in before the start: promise, release, and taking it all back
AFTER_START_NS = 3 * NS_PER_MS  # for the program to note its start
NAMES = (LETTERS, SECOND_LETTERS)
MOTORS = "X, Y, Z, W (or A, B, C, D), E, F, G, H"
WAITS_FOR_MORE = ("DL", "QD", "IN")  # after these the controller takes no commands


def _words(points: Mapping[str, Input] | Mapping[str, Output], size: int) -> int:
    """How many words of `size` points hold all that the fleet file names."""
    return max((-(-point.number // size) for point in points.values()), default=0)


class SMC2000Driver(YaskawaDriver[SerialDevice]):
    """One SMC-2000, alone on its port or in a daisy chain."""

    def __init__(self, setup: Setup) -> None:
        link = setup.config.link
        assert isinstance(link, SerialLink)
        options = Smc2000Options.model_validate(setup.options.model_dump())
        motors = motor_indices(setup.config, NAMES, MOTORS)
        self._options = options
        self._char_ns = 10 * NS_PER_S // link.baud
        self._line: Line = setup.shared.setdefault(SHARED, Line())
        # Only what the fleet file names is asked for: every character takes half a millisecond.
        inputs, outputs = _words(setup.config.inputs, INPUTS_OF_WORD), _words(setup.config.outputs, OUTPUTS_OF_WORD)
        self._points = inputs * INPUTS_OF_WORD, outputs * OUTPUTS_OF_WORD
        device = SerialDevice(
            self._line, link.unit, setup.clock, setup.open_link, options, list(motors.values()), inputs, outputs
        )
        super().__init__(setup, motors, device, SerialStart(device, setup.clock, options), (*WAITS_FOR_MORE, "%", "!"))
        # What the shared lowering counts a command of a stop with.
        wire_us = EXCHANGE_CHARACTERS * self._char_ns // NS_PER_US
        self._costly = options.model_copy(update={"round_trip_us": options.round_trip_us + options.hold_us + wire_us})
        self._contoured = smc2000_program.contoured(list(motors.values()))
        self._model = replace(SMC2000, contours=self._contoured)

    # Reaching it

    async def configure(self) -> None:
        await configure(self._device, self._config, self._options, self._motors)
        types, _ = await self._device.session.numbers(*(f"_MT{LETTERS[index]}" for index in self._motors.values()))
        self._steppers = {name for name, kind in zip(self._motors, types, strict=True) if abs(kind) >= STEPPER_TYPE}

    @property
    def _exchange_ns(self) -> int:
        """On a chain each exchange may have to wait for one of every other unit."""
        return self._costly.exchange_ns * len(self._line.units)

    @property
    def capabilities(self) -> Capabilities:
        exchange_ns = self._exchange_ns
        ramp_s = max(axis.limits.velocity / axis.limits.acceleration for axis in self._config.axes.values())
        costs = Costs(
            arm_ns=ARM_EXCHANGES * exchange_ns,
            by_turns=True,
            # A release must reach the gate before it is decided.
            disarm_ns=round(self._device.gate.decided * self._options.tick_ns) + DISARM_EXCHANGES * exchange_ns,
            stop_ns=round(ramp_s * NS_PER_S) + STOP_EXCHANGES * self._costly.exchange_ns,
        )
        orders = (2, 3) if self._contoured else (2,)
        return Capabilities(start_classes=CLASSES, orders=orders, independent_axes=False, costs=costs)

    # Reading it

    async def poll(self) -> Reading:
        record, restarted = await self._device.poll()
        return Reading(
            at_ns=(record.sent_ns + record.received_ns) // 2,
            axes={name: self._axis_reading(name, record.axes[index]) for name, index in self._motors.items()},
            inputs=_bits(record.inputs, self._points[0]),
            outputs=_bits(record.outputs, self._points[1]),
            faults=await self._faults(record),
            restarted=restarted,
        )

    def _axis_reading(self, name: str, axis: AxisRecord) -> AxisReading:
        open_loop = name in self._steppers
        return AxisReading(
            commanded_counts=axis.commanded,
            # The step counter is all that a stepper has (TE is not valid for it, L11836).
            actual_counts=axis.commanded if open_loop else axis.actual,
            velocity_counts_s=axis.velocity / VELOCITY_SCALE,
            moving=axis.moving,
            enabled=axis.enabled,
            limit=LIMITS[not axis.switches & FORWARD_SWITCH, not axis.switches & REVERSE_SWITCH],
            # A servo's position is still monitored while it is off (L10447), and SH begins from there (L11494).
            lost=open_loop and not axis.enabled,
        )

    # A step

    def lower(self, profiles: Mapping[str, Profile], how: StartWay, mapping: TickMapping | None) -> Lowered:
        costs = self.capabilities.costs
        upload = SlowUpload(
            smc2000_program.arrays(sorted(self._motors.values())),
            ARRAY_CHARACTERS,
            ARRAY_BACK,
            self._exchange_ns,
            self._char_ns,
            self._options.contour_upload_s,
        )
        return lower_moves(self._config, self._motors, self._costly, costs, profiles, how, mapping, self._model, upload)

    async def arm(self, lowered: Lowered, t0_ns: int, mapping: TickMapping | None) -> Mapping[str, int]:
        if not isinstance(lowered, LoweredMoves):
            raise CannotDo("not-lowered", "this move was lowered for another make", "lower it again")
        self._jogging.forget(move.axis for move in lowered.moves)
        # In one go, or the other units' polls would come between its parts; but not for as long as an upload takes.
        async with nullcontext() if isinstance(lowered.load, Records) else self._device.together():
            stages = await self._start.arm(lowered, t0_ns, mapping)
        self._device.session.keep_quiet(t0_ns - self._poll_ns(), t0_ns + AFTER_START_NS)
        return stages

    def _poll_ns(self) -> int:
        """How long a poll may be under way."""
        characters = POLL_CHARACTERS[0] + POLL_CHARACTERS[1] * len(self._motors)
        return characters * self._char_ns + self._options.decode_us * NS_PER_US * (len(self._motors) + 2)

    async def verify(self) -> None:
        async with self._device.together():
            await super().verify()

    async def go(self, slack_ns: int = 0, sooner_ns: int = 0) -> None:
        async with self._device.together():
            await super().go(slack_ns, sooner_ns)

    async def disarm(self) -> None:
        self._device.session.keep_quiet(0, 0)
        await super().disarm()

    async def stop_first(self) -> bool:
        return await self._device.stop_first()


def _bits(word: int, count: int) -> dict[int, bool]:
    return {number + 1: bool(word >> number & 1) for number in range(count)}


class SMC2000Make:
    """The make as the entry point names it."""

    name = "smc2000"
    options: type[BaseModel] = Smc2000Options

    def check(self, config: Controller) -> None:
        link = config.link
        if not isinstance(link, SerialLink):
            raise ValueError(f"link.kind: {link.kind}; an SMC-2000 is reached by `kind: serial`")
        if (link.data_bits, link.parity, link.stop_bits) != (8, "none", 1):
            raise ValueError("link: an SMC-2000 has 8 data bits, no parity and 1 stop bit (L177)")
        if link.unit is not None and link.unit not in UNITS:
            raise ValueError(
                f"link.unit: {link.unit}; the units of a daisy chain are {UNITS.start} to {UNITS.stop - 1}"
            )
        motors = motor_indices(config, NAMES, MOTORS)
        if len(motors) > AXES_MOST:
            raise ValueError(f"axes: {len(motors)}; at most {AXES_MOST} axes of one SMC-2000 can be driven")
        for kind, points, most in (("inputs", config.inputs, INPUTS), ("outputs", config.outputs, OUTPUTS)):
            for name, point in points.items():
                if point.number > most:
                    raise ValueError(f"{kind}.{name}.number: {point.number}; the unit has {kind} 1 to {most}")
        try:
            options = Smc2000Options.model_validate(config.options)
        except ValidationError as error:
            first = error.errors()[0]
            raise ValueError(f"options.{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
        unknown = [name for name in options.motor_type if name not in motors]
        if unknown:
            raise ValueError(f"options.motor_type: no axis {unknown[0]}; axes are {', '.join(motors)}")
        for name, axis in config.axes.items():
            if axis.homing.method not in homing.METHODS:
                raise ValueError(
                    f"axes.{name}.homing.method: {axis.homing.method!r}; this make has {', '.join(homing.METHODS)}"
                )
            stepper = abs(options.motor_type.get(name, 1.0)) >= STEPPER_TYPE
            most = (
                (STEPPER_SPEED_MAX if stepper else SMC2000.speed_max)
                / float(axis.scale)
                * 1000
                / options.servo_period_us
            )
            if axis.limits.velocity > most:
                raise ValueError(
                    f"axes.{name}.limits.velocity: {axis.limits.velocity:g}; it goes at most {most:g} {axis.unit}/s"
                )

    def driver(self, setup: Setup) -> Driver:
        return SMC2000Driver(setup)

    def stop_bytes(self, config: Controller) -> bytes:
        """Ends what is half-typed, or a download; on a chain `!` reaches all units, whoever is selected (L947)."""
        link = config.link
        everybody = "!" if isinstance(link, SerialLink) and link.unit is not None else ""
        return "".join(
            f"{command}\r" for command in ("\\", *(everybody + each for each in stop_commands(False)))
        ).encode()


MAKE = SMC2000Make()
