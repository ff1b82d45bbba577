"""The command tables: modules named `commands_…` and `smc2000_…` enter their op-codes here."""

from collections.abc import Callable

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.expressions import Evaluator
from sim.yaskawa.language.statements import Command, Outcome, Runner

COMMANDS: dict[str, Command] = {}
"""As the SMC-4000 has them; other models take what they share from here."""
OPERANDS: dict[str, Callable[[str], Evaluator]] = {}
"""For each `_XX`: from what follows the op-code to the function that reads it."""
SMC2000_COMMANDS: dict[str, Command] = {}
"""What the SMC-2000 alone has, or has otherwise."""
SMC2000_OPERANDS: dict[str, Callable[[str], Evaluator]] = {}

Compiler = Callable[[str], Runner]


def command(
    *ops: str, where: str = "both", lock: str = "", table: dict[str, Command] = COMMANDS
) -> Callable[[Compiler], Compiler]:
    """Enter a compiler of argument texts for `ops`. lock: levels of `LC` that forbid the command."""

    def enter(compiler: Compiler) -> Compiler:
        for op in ops:
            table[op] = Command(compiler, where, lock)
        return compiler

    return enter


def operand(
    *ops: str, table: dict[str, Callable[[str], Evaluator]] = OPERANDS
) -> Callable[[Callable[[str], Evaluator]], Callable[[str], Evaluator]]:
    """Enter a compiler of operand suffixes for `ops`."""

    def enter(compiler: Callable[[str], Evaluator]) -> Callable[[str], Evaluator]:
        for op in ops:
            table[op] = compiler
        return compiler

    return enter


def bare(text: str) -> None:
    """Refuse arguments where none are taken."""
    if text:
        raise CommandError(4)


__all__ = [
    "COMMANDS",
    "OPERANDS",
    "SMC2000_COMMANDS",
    "SMC2000_OPERANDS",
    "Command",
    "Outcome",
    "Runner",
    "bare",
    "command",
    "operand",
]
