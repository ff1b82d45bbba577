"""Operands that only the SMC-2000 has, or that differ there (L1561-L1735)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.operands import register_axis_operand, register_machine_operand, return_line
from sim.yaskawa.commands.status import encoder_position
from sim.yaskawa.language.context import CommandContext, Evaluator
from sim.yaskawa.language.registry import SMC2000_OPERANDS, register_operand
from sim.yaskawa.smc2000.motion import move_destination

EEPROM_BYTES = 1_048_576


register_axis_operand("PA", move_destination, table=SMC2000_OPERANDS)
register_axis_operand("IP", encoder_position, table=SMC2000_OPERANDS)
register_machine_operand("BV", lambda c: EEPROM_BYTES, table=SMC2000_OPERANDS)
register_machine_operand("ID", lambda c: 20000 + len(c.machine.letters), table=SMC2000_OPERANDS)
register_machine_operand(
    "VM", lambda c: c.machine.motion.systems["S"].free_entries(c.machine.current_sample()), table=SMC2000_OPERANDS
)


@register_operand("ES", table=SMC2000_OPERANDS)
def _compile_ellipse(suffix: str) -> Evaluator:
    """The ratio, 0.0001 to 1 (L1630)."""
    if suffix:
        raise CommandError(58)

    def read_value(c: CommandContext) -> int:
        m, n = c.machine.motion.systems["S"].ellipse_terms
        return fixed.from_real(min(m, n) / max(m, n))

    return read_value


register_machine_operand("LS", return_line, table=SMC2000_OPERANDS)


@register_operand("QY", table=SMC2000_OPERANDS)
def _compile_encoder_text(suffix: str) -> Evaluator:
    """Return the string of QY (L1684)."""
    if suffix:
        raise CommandError(58)
    return lambda c: fixed.from_string(f"P{c.machine.motion.real[c.machine.last_encoder].turns:+05d}"[:6])
