"""Offsets between the numbers of a program and the positions of the axes, mm."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from orchestrator.model.jobs.files import FileError, FileProblem
from orchestrator.model.paths.files.gcode.errors import LineError

SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
MOST_TOOLS = 10_000
_TOOL_WORD = re.compile(r"\s*([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))", re.ASCII)

Offsets = Mapping[str, float]


class WorkOffsets:
    """The offsets that hold shifts_before, by letter: of the work (G54 …), G92 and G52, and of the length of the tool.

    A position of an axis is the program's number and all of them.
    """

    def __init__(self, letters: Sequence[str], systems: Mapping[str, Offsets]) -> None:
        self.system = "G54"
        self.total: dict[str, float] = dict.fromkeys(letters, 0.0)
        self._letters = letters
        self._systems = {name: dict(systems[name]) for name in SYSTEMS if name in systems}
        self._systems.setdefault("G54", dict.fromkeys(letters, 0.0))
        self._shift = dict.fromkeys(letters, 0.0)
        self._is_shifted = True
        self._tool = dict.fromkeys(letters, 0.0)
        self._update()

    def choose_system(self, name: str) -> None:
        """Choose a work offset. Raises `LineError` if it is not known."""
        offsets = self._systems.get(name)
        if offsets is None or len(offsets) < len(self._letters):
            points = ", ".join("0" for _ in self._letters)
            raise LineError(0, f"where {name} is, is not known: write `gcode: {{offsets: {{{name}: [{points}]}}}}`")
        self.system = name
        self._update()

    def name_system(self, number: float) -> str:
        """The system of a P word: 0 is the present one. Raises `LineError`."""
        if number != int(number) or not 0 <= number <= len(SYSTEMS):
            raise LineError(0, f"a work offset has a number from 1 to {len(SYSTEMS)}, not {number:g}")
        return SYSTEMS[int(number) - 1] if number else self.system

    def place_system(self, name: str, origins: Offsets) -> None:
        """G10 L2: the zero of a system, of the letters that are given."""
        self._systems.setdefault(name, {}).update(origins)
        self._update()

    def place_point(self, name: str, point: Offsets, at: Offsets) -> None:
        """G10 L20: the zero of a system by which the present position has these numbers."""
        origins = {
            letter: at[letter] - value - (self._shift[letter] if self._is_shifted else 0.0) - self._tool[letter]
            for letter, value in point.items()
        }
        self.place_system(name, origins)

    def shift(self, shifts: Offsets) -> None:
        """G52: shift all systems, by letter."""
        self._shift.update(shifts)
        self._is_shifted = True
        self._update()

    def shift_to(self, point: Offsets, at: Offsets) -> None:
        """G92: shift all systems so that the present position has these numbers."""
        if not self._is_shifted:
            self._shift = dict.fromkeys(self._letters, 0.0)
        changes = {letter: at[letter] - self.total[letter] - value for letter, value in point.items()}
        self.shift({letter: self._shift[letter] + change for letter, change in changes.items()})

    def end_shift(self, *, forget: bool) -> None:
        """G92.1 and G92.2."""
        if forget:
            self._shift = dict.fromkeys(self._letters, 0.0)
        self._is_shifted = False
        self._update()

    def restore_shift(self) -> None:
        """G92.3."""
        self._is_shifted = True
        self._update()

    def choose_tool(self, lengths: Offsets) -> None:
        """G43, G43.1 and G49: the lengths of the tool, by letter; those that are not named are 0."""
        self._tool = {letter: lengths.get(letter, 0.0) for letter in self._letters}
        self._update()

    def _update(self) -> None:
        system = self._systems[self.system]
        for letter in self._letters:
            shift = self._shift[letter] if self._is_shifted else 0.0
            self.total[letter] = system.get(letter, 0.0) + shift + self._tool[letter]


def read_tools(path: Path) -> dict[int, dict[str, float]]:
    """LinuxCNC's tool table: offsets by number of the tool, mm, by letter. Raises `FileError`."""
    name = str(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise FileError([FileProblem(name, 1, "", f"the tool table cannot be read: {reason}")]) from None
    tools: dict[int, dict[str, float]] = {}
    for number, line in enumerate(lines[:MOST_TOOLS], 1):
        text = line.partition(";")[0].rstrip()
        words: dict[str, float] = {}
        at = 0
        while at < len(text):
            match = _TOOL_WORD.match(text, at)
            if match is None:
                raise FileError([FileProblem(name, number, f"column {at + 1}", f"{text[at : at + 20]!r} is no word")])
            words[match[1].upper()] = float(match[2])
            at = match.end()
        if "T" in words:
            tools[int(words["T"])] = {letter: words[letter] for letter in "XYZABCUVW" if letter in words}
    return tools
