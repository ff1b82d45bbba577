"""Operands that the SMC-2000 alone has, or has otherwise (L1561-L1735)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.operands import of_axis, of_machine, return_line
from sim.yaskawa.commands.status import encoder
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import Evaluator
from sim.yaskawa.language.registry import SMC2000_OPERANDS, operand
from sim.yaskawa.smc2000.motion import destination

EEPROM_BYTES = 1_048_576


of_axis("PA", destination, table=SMC2000_OPERANDS)
of_axis("IP", encoder, table=SMC2000_OPERANDS)
of_machine("BV", lambda c: EEPROM_BYTES, table=SMC2000_OPERANDS)
of_machine("ID", lambda c: 20000 + len(c.machine.letters), table=SMC2000_OPERANDS)
of_machine("VM", lambda c: c.machine.motion.systems["S"].free(c.machine.now()), table=SMC2000_OPERANDS)


@operand("ES", table=SMC2000_OPERANDS)
def _ellipse(suffix: str) -> Evaluator:
    """The ratio, 0.0001 to 1 (L1630)."""
    if suffix:
        raise CommandError(58)

    def read(c: Context) -> int:
        m, n = c.machine.motion.systems["S"].ellipse_terms
        return fixed.of(min(m, n) / max(m, n))

    return read


of_machine("LS", return_line, table=SMC2000_OPERANDS)


@operand("QY", table=SMC2000_OPERANDS)
def _encoder_text(suffix: str) -> Evaluator:
    """The string of QY (L1684)."""
    if suffix:
        raise CommandError(58)
    return lambda c: fixed.of_string(f"P{c.machine.motion.real[c.machine.last_encoder].turns:+05d}"[:6])
