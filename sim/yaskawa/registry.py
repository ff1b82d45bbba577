"""The command table of the family: modules named `commands_…` enter their op-codes here."""

from collections.abc import Callable

from sim.yaskawa.errors import CommandError
from sim.yaskawa.expressions import Evaluator
from sim.yaskawa.statements import Command, Outcome, Runner

COMMANDS: dict[str, Command] = {}
OPERANDS: dict[str, Callable[[str], Evaluator]] = {}
"""For each `_XX`: from what follows the op-code to the function that reads it."""

Compiler = Callable[[str], Runner]


def command(*ops: str, where: str = "both", lock: str = "") -> Callable[[Compiler], Compiler]:
    """Enter a compiler of argument texts for `ops`. lock: levels of `LC` that forbid the command."""

    def enter(compiler: Compiler) -> Compiler:
        for op in ops:
            COMMANDS[op] = Command(compiler, where, lock)
        return compiler

    return enter


def operand(*ops: str) -> Callable[[Callable[[str], Evaluator]], Callable[[str], Evaluator]]:
    """Enter a compiler of operand suffixes for `ops`."""

    def enter(compiler: Callable[[str], Evaluator]) -> Callable[[str], Evaluator]:
        for op in ops:
            OPERANDS[op] = compiler
        return compiler

    return enter


def bare(text: str) -> None:
    """Refuse arguments where none are taken."""
    if text:
        raise CommandError(4)


__all__ = ["COMMANDS", "OPERANDS", "Command", "Outcome", "Runner", "bare", "command", "operand"]
