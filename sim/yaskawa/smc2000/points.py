"""Inputs and outputs of the SMC-2000: OP TI II and their operands (L5024-L5175, L9241-L9307, L10689, L11879)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.status import report_text
from sim.yaskawa.language.arguments import compile_values, parse_fields, split_fields
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

_WORD = 16
_BANKS = 4
_INTERRUPTS = 8


def _output_word(c: CommandContext, bank: int) -> int:
    return c.machine.io.outputs >> (bank * _WORD) & 0xFFFF


def _format_word(c: CommandContext, bank: int) -> str:
    return c.machine.format_integer(_output_word(c, bank), 3 if _output_word(c, bank) < 1000 else 5)


@register_command("OP", table=SMC2000_COMMANDS)
def _compile_output_port(text: str) -> Runner:
    """Outputs in words of 16; the first is a byte but on eight axes (L10693)."""
    if "?" in text:
        banks = [bank for bank, mark in enumerate(split_fields(text)) if mark == "?"]
        return lambda c: ",".join(_format_word(c, bank) for bank in banks)
    fields = compile_values(parse_fields(text, _BANKS))

    def run_command(c: CommandContext) -> Outcome:
        outputs = c.machine.io.outputs
        for bank, raw in enumerate(fields(c)):
            if raw is None:
                continue
            word = fixed.to_integer(raw)
            highest = (0xFF, 0xFFFF)[len(c.machine.letters) > _INTERRUPTS // 2] if bank == 0 else 0xFFFF
            if not 0 <= word <= highest or bank * _WORD >= c.machine.io.count:
                raise CommandError(6)
            outputs = outputs & ~(0xFFFF << bank * _WORD) | word << bank * _WORD
        c.machine.io.set_all(outputs)
        return None

    return run_command


@register_operand("OP", table=SMC2000_OPERANDS)
def _compile_read_outputs(suffix: str) -> Evaluator:
    if suffix not in ("", "0", "1", "2", "3"):
        raise CommandError(58)
    return lambda c: fixed.from_integer(_output_word(c, int(suffix or "0")))


def _input_word(c: CommandContext, bank: int) -> int:
    if not 0 <= bank < len(c.machine.environment.inputs) // 8:
        raise CommandError(6)
    return c.machine.io.input_byte(bank)


@register_command("TI", table=SMC2000_COMMANDS)
def _compile_tell_inputs(text: str) -> Runner:
    bank = compile_integer(text) if text not in ("", "?") else None
    return lambda c: report_text(c, c.machine.format_integer(_input_word(c, bank(c) if bank is not None else 0), 3))


@register_operand("TI", table=SMC2000_OPERANDS)
def _compile_read_inputs(suffix: str) -> Evaluator:
    if len(suffix) > 1 or suffix not in "01234567":
        raise CommandError(58)
    return lambda c: fixed.from_integer(_input_word(c, int(suffix or "0")))


@register_command("II", where="program", table=SMC2000_COMMANDS)
def _compile_input_interrupt(text: str) -> Runner:
    """First and last input, or a mask of the eight; negative ones interrupt when high, firmware 19K and up (L9266)."""
    fields = compile_values(parse_fields(text, 3))

    def run_command(c: CommandContext) -> Outcome:
        values = [0 if raw is None else fixed.to_integer(raw) for raw in [*fields(c), None, None]]
        first, last, mask = values[:3]
        programs = c.machine.programs
        if min(values) < 0 and not c.machine.options.own_modulus:
            raise CommandError(6)
        if not (-_INTERRUPTS <= first <= _INTERRUPTS and -_INTERRUPTS <= last <= _INTERRUPTS and abs(mask) <= 0xFF):
            raise CommandError(6)
        if first:
            if last and abs(last) < abs(first):
                raise CommandError(6)
            outputs = sum(1 << number - 1 for number in range(abs(first), abs(last or first) + 1))
        else:
            outputs = abs(mask)
        programs.interrupts = outputs
        programs.active_high = outputs if first < 0 or mask < 0 else 0
        programs.interrupts_on = outputs != 0
        return None

    return run_command
