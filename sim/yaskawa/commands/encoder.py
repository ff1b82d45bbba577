"""Absolute encoders, of models with that option: AE QY (L2437-L2482, L9140-L9180; SMC-2000: L6959, L11003)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.motion import busy_refusal
from sim.yaskawa.commands.parameters import target_axes
from sim.yaskawa.commands.status import report_text
from sim.yaskawa.language.arguments import parse_form
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.registry import Outcome, Runner, register_command, require_bare
from sim.yaskawa.motion.axis import ServoAxis

NOT_INSTALLED, MOTOR_ON, SILENT = 114, 115, 117
"""Codes of the SMC-2000; the other model's table has no codes for this."""


@register_command("AE")
def _compile_absolute_encoder(text: str) -> Runner:
    """Set the axis position to the encoder's position; the argument is its resolution, negative for reverse
    rotation."""
    form = parse_form(text)

    def run_command(c: CommandContext) -> Outcome:
        resolutions: list[tuple[ServoAxis, int]] = []
        for name, field in form:
            if field is None or isinstance(field, str):
                raise CommandError(51)
            resolution = fixed.to_integer(field(c))
            if not 1 <= abs(resolution) <= c.machine.model.figures.encoder_resolution:
                raise CommandError(6)
            resolutions += [(axis, resolution) for axis in target_axes(c, name)]
        if not resolutions:
            raise CommandError(50)
        for axis, resolution in resolutions:
            _read_encoder(c, axis, resolution)
        return None

    return run_command


def _read_encoder(c: CommandContext, axis: ServoAxis, resolution: int) -> None:
    encoders = c.machine.options.encoder_readings
    if not encoders:
        raise CommandError(NOT_INSTALLED)
    if axis.is_moving:
        raise busy_refusal(axis)
    if not axis.motor_off:
        raise CommandError(MOTOR_ON)
    c.machine.last_encoder = axis.index
    encoder = encoders.get(axis.name)
    if encoder is None:
        raise CommandError(SILENT)
    axis.absolute = encoder if resolution > 0 else -encoder
    axis.turns = axis.absolute // abs(resolution)
    axis.define_position(c.machine.current_sample(), axis.absolute)


@register_command("QY")
def _compile_encoder_text(text: str) -> Runner:
    """Return the data of the encoder read last: its revolutions."""
    require_bare(text.removeprefix("?"))

    def run_command(c: CommandContext) -> Outcome:
        if not c.machine.options.encoder_readings:
            raise CommandError(NOT_INSTALLED)
        if c.machine.model.still_encoders and c.machine.motion.is_active():
            raise CommandError(7)
        return report_text(c, f"P{c.machine.motion.real[c.machine.last_encoder].turns:+06d}")

    return run_command
