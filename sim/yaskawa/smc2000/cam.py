"""Gearing and cams of the SMC-2000: one master for all, GA EA EG EQ MM (L2415-L2523, L3072-L3315, L8389-L8655)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.gear import engagement_compiler
from sim.yaskawa.commands.parameters import target_axes
from sim.yaskawa.language.arguments import LETTERS, canonical_axis, parse_form
from sim.yaskawa.language.context import CommandContext, Evaluator
from sim.yaskawa.language.expressions import compile_integer
from sim.yaskawa.language.registry import (
    SMC2000_COMMANDS,
    SMC2000_OPERANDS,
    Outcome,
    Runner,
    register_command,
    register_operand,
)
from sim.yaskawa.motion.gearing import select_master

LARGEST_CYCLE = 8388607


@register_command("GA", table=SMC2000_COMMANDS)
def _compile_gear_master(text: str) -> Runner:
    """X for its encoder, CX for its command, DX for its auxiliary encoder, S for the vector move (L9011)."""
    source = text[:-1] + canonical_axis(text[-1:])
    if source != "S" and (source[-1:] not in tuple(LETTERS) or source[:-1] not in ("", "C", "D")):
        raise CommandError(50 if not text else 4)

    def run_command(c: CommandContext) -> Outcome:
        machine = c.machine
        if source != "S":
            machine.find_axis(source[-1])
        if machine.motion.is_active():
            raise CommandError(7)
        machine.gear_master = source
        for axis in machine.motion.real:
            if source in (axis.name, f"C{axis.name}"):
                axis.gear.select_master("", None, machine.timebase.next_sample())
            else:
                select_master(machine.motion, axis, source)
        return None

    return run_command


@register_command("EA", table=SMC2000_COMMANDS)
def _compile_cam_master(text: str) -> Runner:
    master = text[:-1] + canonical_axis(text[-1:])
    if master[-1:] not in tuple(LETTERS) or master[:-1] not in ("", "D"):
        raise CommandError(50 if not text else 4)

    def run_command(c: CommandContext) -> Outcome:
        cam = c.machine.motion.cam
        c.machine.find_axis(master[-1])
        if cam.followers:
            raise CommandError(100)
        cam.master = master
        return None

    return run_command


@register_command("EG", table=SMC2000_COMMANDS)
def _compile_engage(text: str) -> Runner:
    """`EG ?` reports 1 for an engaged axis (L8442)."""
    if "?" not in text:
        return engagement_compiler("EG")(text)
    form = parse_form(text)
    return lambda c: ",".join(
        c.machine.format_integer(int(axis.mode == "cam"), 1) for name, _ in form for axis in target_axes(c, name)
    )


@register_command("EQ", table=SMC2000_COMMANDS)
def _compile_disengage(text: str) -> Runner:
    if "?" in text:
        raise CommandError(51)
    return engagement_compiler("EQ")(text)


def _require_modulus(c: CommandContext) -> None:
    """MM came with firmware 19p (L10413)."""
    if not c.machine.options.own_modulus:
        raise CommandError(1)


@register_command("MM", table=SMC2000_COMMANDS)
def _compile_modulus(text: str) -> Runner:
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        _require_modulus(c)
        cycle = value(c)
        if not 0 <= cycle <= LARGEST_CYCLE:
            raise CommandError(6)
        c.machine.motion.cam.master_cycle = cycle
        return None

    return run_command


@register_operand("MM", table=SMC2000_OPERANDS)
def _compile_read_modulus(suffix: str) -> Evaluator:
    if suffix:
        raise CommandError(58)

    def read_value(c: CommandContext) -> int:
        _require_modulus(c)
        return fixed.from_integer(c.machine.motion.cam.effective_cycle)

    return read_value
