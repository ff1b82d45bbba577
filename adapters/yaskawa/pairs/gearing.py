"""The gearing of the second motor of an axis to the commanded position of the first: GA, GR 1, GM 1 (L5426-5534,
L13519-13631).

In gantry mode neither a stop nor a limit switch ends the gearing (L5492, L13522): a stop of the first motor brakes both
by its ramp, and a limit switch of the second one is regarded by the watch of the adapter alone. GR 0 ends it at once,
without a ramp, and is sent at rest only. The manual states the commanded position as a master for jogs and independent
moves (L13534), and not for contours: such an axis is not in paths.

Counts of both motors are equal where the beam is square, so that their difference is its deviation. After power-up both
are 0, where they stand. GM is not burned (L3248-3267): gearing is set at each connection, and watched with the other
settings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from adapters.contract import AxisReading, SecondMotor
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.settings import NO_LIMITS, load_registers, make_mismatch
from adapters.yaskawa.language.dialect import find_motor
from adapters.yaskawa.wire.record import AXIS_LETTERS, RECORD_LETTERS
from orchestrator.model.fleet import Controller

LIMITS_OFF: dict[str, int] = dict(zip(("BL", "FL"), NO_LIMITS, strict=True))
STEPPER = 2.0  # |MT| of step motors (L7683)


@dataclass(frozen=True, slots=True)
class MotorPair:
    """The two motors of an axis, by index."""

    axis: str
    first: int
    second: int

    @property
    def indices(self) -> tuple[int, int]:
        return self.first, self.second

    @property
    def letters(self) -> tuple[str, str]:
        return AXIS_LETTERS[self.first], AXIS_LETTERS[self.second]


def find_pairs(config: Controller, names: Sequence[str]) -> dict[str, MotorPair]:
    """The axes of two motors of a checked fleet file. names: alphabets with one letter per motor."""
    pairs: dict[str, MotorPair] = {}
    for name, axis in config.axes.items():
        if len(axis.motors) == 2:
            first, second = (find_motor(motor, names) for motor in axis.motors)
            assert first is not None and second is not None, "checked when the fleet file was loaded"
            pairs[name] = MotorPair(name, first, second)
    return pairs


async def gear_motors(device: SmcDevice, pair: MotorPair) -> None:
    """Check both motors, and gear the second one. Raises `ControllerFault` (`config-mismatch`)."""
    await _require_alike(device, pair)
    letter = pair.letters[1]
    (ratio, is_gantry), _ = await device.session.read_numbers(f"_GR{letter}", f"_GM{letter}")
    record = await device.read_record()
    if any(record.axes[index].is_moving for index in pair.indices):
        if ratio == 1 and is_gantry:
            return
        text = "it moves, and its second motor is not geared"
        raise make_mismatch(f"gearing (GR{letter})", text, "1 in gantry mode (GM)", "stop it first", pair.axis)
    await load_registers(device, pair.axis, pair.second, LIMITS_OFF)
    await engage_gear(device, pair)


async def engage_gear(device: SmcDevice, pair: MotorPair) -> None:
    """Gear the second motor to the first one; both are at rest. Raises `ControllerFault`."""
    follower, master = RECORD_LETTERS[pair.second], RECORD_LETTERS[pair.first]
    await device.session.send_command(f"GA{follower}=C{master}")
    await load_registers(device, pair.axis, pair.second, {"GM": 1, "GR": 1})


async def _require_alike(device: SmcDevice, pair: MotorPair) -> None:
    """Raise `ControllerFault` for motors that count differently, or without an encoder, which shows no deviation."""
    first, second = pair.letters
    operands = (f"_CE{first}", f"_CE{second}", f"_MT{first}", f"_MT{second}")
    (encoder, second_encoder, *motor_types), _ = await device.session.read_numbers(*operands)
    if encoder != second_encoder:
        remedy = f"both encoders must count in one way: set CE{second} with the motor off, and burn it (BN)"
        raise make_mismatch(f"encoder (CE{second})", f"{second_encoder:g}", f"{encoder:g}", remedy, pair.axis)
    for letter, motor_type in zip(pair.letters, motor_types, strict=True):
        if abs(motor_type) >= STEPPER:
            text, remedy = f"{motor_type:g}, a step motor", "its encoder would not show how far the motors are apart"
            raise make_mismatch(f"motor type (MT{letter})", text, "1 or -1", remedy, pair.axis)


def join_readings(first: AxisReading, second: AxisReading) -> AxisReading:
    """The reading of an axis from those of its two motors."""
    switches = {first.limit, second.limit} - {"none"}
    return replace(
        first,
        moving=first.moving or second.moving,
        enabled=first.enabled and second.enabled,
        limit="both" if len(switches) == 2 else next(iter(switches), "none"),
        second=SecondMotor(second.actual_counts, second.limit),
    )
