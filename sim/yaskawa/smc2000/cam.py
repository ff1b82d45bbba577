"""Gearing and cams of the SMC-2000: one master for all, GA EA EG EQ MM (L2415-L2523, L3072-L3315, L8389-L8655)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.gear import engagement, select_master
from sim.yaskawa.commands.parameters import targets
from sim.yaskawa.language.arguments import LETTERS, canonical, parse_form
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import Evaluator, integer
from sim.yaskawa.language.registry import SMC2000_COMMANDS, SMC2000_OPERANDS, Outcome, Runner, command, operand

LARGEST_CYCLE = 8388607


@command("GA", table=SMC2000_COMMANDS)
def _gear_master(text: str) -> Runner:
    """X for its encoder, CX for its command, DX for its auxiliary encoder, S for the vector move (L9011)."""
    source = text[:-1] + canonical(text[-1:])
    if source != "S" and (source[-1:] not in tuple(LETTERS) or source[:-1] not in ("", "C", "D")):
        raise CommandError(50 if not text else 4)

    def run(c: Context) -> Outcome:
        machine = c.machine
        if source != "S":
            machine.axis(source[-1])
        if machine.motion.active():
            raise CommandError(7)
        machine.gear_master = source
        for axis in machine.motion.real:
            if source in (axis.name, f"C{axis.name}"):
                axis.gear.select("", None, machine.timebase.next_sample())
            else:
                select_master(machine, axis, source)
        return None

    return run


@command("EA", table=SMC2000_COMMANDS)
def _cam_master(text: str) -> Runner:
    master = text[:-1] + canonical(text[-1:])
    if master[-1:] not in tuple(LETTERS) or master[:-1] not in ("", "D"):
        raise CommandError(50 if not text else 4)

    def run(c: Context) -> Outcome:
        cam = c.machine.motion.cam
        c.machine.axis(master[-1])
        if cam.followers:
            raise CommandError(100)
        cam.master = master
        return None

    return run


@command("EG", table=SMC2000_COMMANDS)
def _engage(text: str) -> Runner:
    """`EG ?` tells 1 for an engaged axis (L8442)."""
    if "?" not in text:
        return engagement("EG")(text)
    form = parse_form(text)
    return lambda c: ",".join(
        c.machine.show_whole(int(axis.mode == "cam"), 1) for name, _ in form for axis in targets(c, name)
    )


@command("EQ", table=SMC2000_COMMANDS)
def _disengage(text: str) -> Runner:
    if "?" in text:
        raise CommandError(51)
    return engagement("EQ")(text)


def _has_modulus(c: Context) -> None:
    """MM came with firmware 19p (L10413)."""
    if not c.machine.options.own_modulus:
        raise CommandError(1)


@command("MM", table=SMC2000_COMMANDS)
def _modulus(text: str) -> Runner:
    value = integer(text)

    def run(c: Context) -> Outcome:
        _has_modulus(c)
        cycle = value(c)
        if not 0 <= cycle <= LARGEST_CYCLE:
            raise CommandError(6)
        c.machine.motion.cam.master_cycle = cycle
        return None

    return run


@operand("MM", table=SMC2000_OPERANDS)
def _read_modulus(suffix: str) -> Evaluator:
    if suffix:
        raise CommandError(58)

    def read(c: Context) -> int:
        _has_modulus(c)
        return fixed.whole(c.machine.motion.cam.cycle)

    return read
