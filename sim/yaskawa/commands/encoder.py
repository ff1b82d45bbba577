"""Absolute encoders, of models with that option: AE QY (L2437-L2482, L9140-L9180; SMC-2000: L6959, L11003)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.motion import busy
from sim.yaskawa.commands.parameters import targets
from sim.yaskawa.commands.status import report
from sim.yaskawa.language.arguments import parse_form
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.registry import Outcome, Runner, bare, command
from sim.yaskawa.motion.axis import Axis

NOT_INSTALLED, MOTOR_ON, SILENT = 114, 115, 117
"""Codes of the SMC-2000; the other model's table has none of its own."""


@command("AE")
def _absolute_encoder(text: str) -> Runner:
    """The encoder's position becomes the axis'; the argument is its resolution, negative for reverse rotation."""
    form = parse_form(text)

    def run(c: Context) -> Outcome:
        given: list[tuple[Axis, int]] = []
        for name, field in form:
            if field is None or isinstance(field, str):
                raise CommandError(51)
            resolution = fixed.truncated(field(c))
            if not 1 <= abs(resolution) <= c.machine.model.figures.encoder_resolution:
                raise CommandError(6)
            given += [(axis, resolution) for axis in targets(c, name)]
        if not given:
            raise CommandError(50)
        for axis, resolution in given:
            _read_encoder(c, axis, resolution)
        return None

    return run


def _read_encoder(c: Context, axis: Axis, resolution: int) -> None:
    encoders = c.machine.options.encoders
    if not encoders:
        raise CommandError(NOT_INSTALLED)
    if axis.moving:
        raise busy(axis)
    if not axis.motor_off:
        raise CommandError(MOTOR_ON)
    c.machine.last_encoder = axis.index
    place = encoders.get(axis.name)
    if place is None:
        raise CommandError(SILENT)
    axis.absolute = place if resolution > 0 else -place
    axis.turns = axis.absolute // abs(resolution)
    axis.define(c.machine.now(), axis.absolute)


@command("QY")
def _encoder_text(text: str) -> Runner:
    """What the encoder read last has sent: its revolutions."""
    bare(text.removeprefix("?"))

    def run(c: Context) -> Outcome:
        if not c.machine.options.encoders:
            raise CommandError(NOT_INSTALLED)
        if c.machine.model.still_encoders and c.machine.motion.active():
            raise CommandError(7)
        return report(c, f"P{c.machine.motion.real[c.machine.last_encoder].turns:+06d}")

    return run
