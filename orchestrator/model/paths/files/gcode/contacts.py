"""Axes of a program that stand where a probe has found something, and zeros that were set there.

A contact is known when the program runs, and the program is read before. Until such an axis goes to a place of its own,
it is a known distance from its contact.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

from orchestrator.model.paths.files.gcode.errors import LineError


@dataclass(frozen=True, slots=True)
class Contact:
    """A contact. name: of its probe. nominal: the number that stands for it, mm. is_certain: the program goes on only
    if it was found."""

    name: str
    nominal: float
    is_certain: bool


@dataclass(frozen=True, slots=True)
class MeasuredZero:
    """The zero of an axis at a contact. code: G92, which moves that of all work offsets, or G10, which moves that of
    `system`. line: of the code."""

    code: str
    system: str
    line: int


@dataclass(slots=True)
class Contacts:
    """present: by letter, the contact that its axis is a known distance from. zeros: by letter, for the rest of the
    program."""

    present: dict[str, Contact] = field(default_factory=dict[str, Contact])
    zeros: dict[str, MeasuredZero] = field(default_factory=dict[str, MeasuredZero])

    def require_known(self, what: str) -> None:
        """Raise `LineError` if an axis stands at a place that is measured."""
        for letter, contact in self.present.items():
            text = f"{what} needs to know where {letter} stands, which {contact.name} measures when the program runs"
            raise LineError(0, f"{text}; go to a place before (G90 G0 {letter}…), or set the zero (G92, G10 L20)")

    def require_own_zero(self, letters: Iterable[str], what: str) -> None:
        """Raise `LineError` if the zero of an axis is at a contact."""
        for letter in letters:
            if letter in self.zeros:
                text = f"line {self.zeros[letter].line} has set the zero of {letter} at a contact"
                raise LineError(0, f"{text}, and {what} counts from the zero before; use a number of the work offset")

    def require_system(self, system: str) -> None:
        """Raise `LineError` if the zero of an axis is at a contact, and in another work offset only."""
        for letter, zero in self.zeros.items():
            if zero.code == "G10" and zero.system != system:
                text = f"line {zero.line} has set the zero of {letter} in {zero.system} at a contact"
                raise LineError(0, f"{text}; where that of {system} is, is not known then")
