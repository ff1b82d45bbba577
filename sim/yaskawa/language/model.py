"""Command language of a model: its op-codes and its operands."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.language.context import CommandDefinition, Evaluator
from sim.yaskawa.language.properties import ModelProperties

SYSTEM_OPS = frozenset(("VA", "VD", "VS", "VR", "VT", "AV"))
HANDLE_OPS = frozenset(("IH", "SA", "MB", "HS"))
AXIS_OPS = frozenset("AD AE AP AR CD DE DP EG EQ GA GM IP LI MF MR".split())  # noqa: SIM905
"""Further op-codes, apart from the parameters, that accept `XXa=value`.

Another op-code before a letter begins a name (L16820).
"""


@dataclass(frozen=True, eq=False, kw_only=True)
class LanguageModel(ModelProperties):
    """A model with its command tables.

    commands, operands: its op-codes.
    """

    commands: dict[str, CommandDefinition]
    operands: dict[str, Callable[[str], Evaluator]]

    @cached_property
    def _compiled_operands(self) -> dict[str, Evaluator]:
        return {}

    def compile_operand(self, text: str) -> Evaluator:
        """Return the function that reads `_XX…`; 58 when there is no such operand."""
        operand = self._compiled_operands.get(text)
        if operand is None:
            entry = self.operands.get(text[1:3])
            if entry is None:
                raise CommandError(58)
            operand = self._compiled_operands[text] = entry(text[3:])
        return operand

    def allowed_suffixes(self, op: str) -> str:
        """Return the letters that may follow `op` in `XXa=value` (axes in their X Y Z W names)."""
        if op in HANDLE_OPS:
            return "XYZWABCDEFGHST"
        if op not in self.parameters and op not in AXIS_OPS and op not in SYSTEM_OPS:
            return ""
        axes = self.letters + "N" if self.figures.virtual_axis else self.letters
        return axes + self.figures.systems if op in SYSTEM_OPS else axes
