"""Command tables: the modules of `commands` and `smc2000` register their op-codes here."""

from collections.abc import Callable

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.context import CommandDefinition, Evaluator, Outcome, Runner

COMMANDS: dict[str, CommandDefinition] = {}
"""Commands of the SMC-4000; other models share entries with it."""
OPERANDS: dict[str, Callable[[str], Evaluator]] = {}
"""For each `_XX`: from the text after the op-code to the function that reads it."""
SMC2000_COMMANDS: dict[str, CommandDefinition] = {}
"""Commands that only the SMC-2000 has, or that differ there."""
SMC2000_OPERANDS: dict[str, Callable[[str], Evaluator]] = {}

Compiler = Callable[[str], Runner]


def register_command(
    *ops: str, where: str = "both", lock: str = "", table: dict[str, CommandDefinition] = COMMANDS
) -> Callable[[Compiler], Compiler]:
    """Register a compiler of argument texts for `ops`.

    lock: levels of `LC` that forbid the command."""

    def enter_command(compiler: Compiler) -> Compiler:
        for op in ops:
            table[op] = CommandDefinition(compiler, where, lock)
        return compiler

    return enter_command


def register_operand(
    *ops: str, table: dict[str, Callable[[str], Evaluator]] = OPERANDS
) -> Callable[[Callable[[str], Evaluator]], Callable[[str], Evaluator]]:
    """Register a compiler of operand suffixes for `ops`."""

    def enter_operand(compiler: Callable[[str], Evaluator]) -> Callable[[str], Evaluator]:
        for op in ops:
            table[op] = compiler
        return compiler

    return enter_operand


def require_bare(text: str) -> None:
    """Refuse arguments where none are allowed."""
    if text:
        raise CommandError(4)


__all__ = [
    "COMMANDS",
    "OPERANDS",
    "SMC2000_COMMANDS",
    "SMC2000_OPERANDS",
    "CommandDefinition",
    "Outcome",
    "Runner",
    "register_command",
    "register_operand",
    "require_bare",
]
