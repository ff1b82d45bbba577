"""The controller's stored settings: read back, loaded where the fleet file states them, refused where they must not be
changed."""

from collections.abc import Iterable, Mapping

from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.watch import SettingsWatch
from adapters.yaskawa.wire.record import AXIS_LETTERS
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller

POSITION_ERROR_MAX = 32767  # counts (L4962)
NO_LIMITS = (-2147483648, 2147483647)  # BL and FL that are off (L3185, L5284)


async def configure_controller(
    device: SmcDevice, config: Controller, options: YaskawaOptions, motors: Iterable[tuple[str, int]]
) -> None:
    """Verify and load the settings. motors: axes, each with the index of a motor. Raises `ControllerFault` of code
    `config-mismatch` with item, found and expected value."""
    (period,), _ = await device.session.read_numbers("_TM")
    if int(period) != options.servo_period_us:
        raise make_mismatch("servo period (TM)", f"{period:g}", str(options.servo_period_us), "set TM and burn it (BN)")
    for name, index in motors:
        await _configure_axis(device, config, options, name, index)


async def load_soft_limits(
    device: SmcDevice,
    motors: Mapping[str, int],
    limits: Mapping[str, tuple[int, int] | None],
    watch: SettingsWatch,
) -> None:
    """Load BL and FL of axes, (low, high) in counts; None switches them off. They are the expected values from then on.
    Raises `ControllerFault` (`config-mismatch`)."""
    for name, ends in limits.items():
        low, high = ends or NO_LIMITS
        limit_values = {"BL": low, "FL": high}
        operands = {command: f"_{command}{AXIS_LETTERS[motors[name]]}" for command in limit_values}
        for operand in operands.values():
            watch.expect_value(operand, None)
        await load_registers(device, name, motors[name], limit_values)
        for command, value in limit_values.items():
            watch.expect_value(operands[command], value)


async def _configure_axis(
    device: SmcDevice, config: Controller, options: YaskawaOptions, name: str, index: int
) -> None:
    letter, axis, session = AXIS_LETTERS[index], config.axes[name], device.session
    (smoothing, motor_type), _ = await session.read_numbers(f"_IT{letter}", f"_MT{letter}")
    if smoothing != 1.0:
        # IT lengthens every move by a time that no document states (L6316-6362).
        raise make_mismatch(
            f"smoothing (IT{letter})", f"{smoothing:g}", "1", f"set IT{letter}=1 and burn it (BN)", name
        )
    wanted_type = options.motor_type.get(name)
    if wanted_type is not None and motor_type != wanted_type:
        raise make_mismatch(
            f"motor type (MT{letter})", f"{motor_type:g}", f"{wanted_type:g}", "check jumpers and option", name
        )
    if axis.following_error is not None:
        error = round(axis.following_error * float(axis.scale))
        if not 1 <= error <= POSITION_ERROR_MAX:
            raise make_mismatch(
                f"following error (ER{letter})",
                f"{error} counts in the fleet file",
                f"1..{POSITION_ERROR_MAX}",
                "correct `following_error` in the fleet file",
                name,
            )
        await load_registers(device, name, index, {"ER": error})


async def load_registers(device: SmcDevice, name: str, index: int, wanted: Mapping[str, int]) -> None:
    """Load registers of a motor and read them back. Raises `ControllerFault` (`config-mismatch`)."""
    letter = AXIS_LETTERS[index]
    for command, value in wanted.items():
        await device.session.send_command(f"{command}{letter}={value}")
        (held_value,), _ = await device.session.read_numbers(f"_{command}{letter}")
        if held_value != value:
            raise make_mismatch(
                f"{command}{letter}", f"{held_value:.0f}", str(value), "does the controller accept this value?", name
            )


def make_mismatch(item: str, found: str, wanted: str, remedy: str, axis: str | None = None) -> ControllerFault:
    """The fault of a setting that must not be corrected."""
    axis_text = f"axis {axis}: " if axis else ""
    return ControllerFault("config-mismatch", f"{axis_text}{item} is {found}, wanted {wanted}", remedy, axis)
