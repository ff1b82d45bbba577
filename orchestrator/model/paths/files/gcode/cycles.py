"""Canned cycles: holes, as the lines that they stand for."""

from dataclasses import dataclass, field

from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.line import CodeLine
from orchestrator.model.paths.files.gcode.modes import PLANES
from orchestrator.model.paths.files.gcode.motions import Machine, Point, take_words
from orchestrator.model.paths.origin import Place

CLEARANCE_MM = 0.254  # above the last depth, from which a peck goes on at feed (LinuxCNC: 0.010 inch)
MOST_HOLES = 10_000  # of one line
MOST_PECKS = 10_000  # of one hole
_WORDS = {"G73": "Q", "G82": "P", "G83": "Q", "G89": "P"}  # that a cycle needs beside its depth and R


@dataclass(slots=True)
class CycleRunner:
    """Runs cycles. words: those that hold until the cycle changes: depth, R, Q and P. initial: the height before the
    first hole, to which G98 returns. pause_unit_s: of P.
    """

    machine: Machine
    pause_unit_s: float = 1.0
    words: dict[str, float] = field(default_factory=dict[str, float])
    cycle: str = ""
    plane: str = ""
    initial: float = 0.0

    def run(self, line: CodeLine, place: Place) -> None:
        """The holes of a line. Raises `LineError`."""
        machine, modes = self.machine, self.machine.modes
        name, plane = modes.motion, PLANES[modes.plane]
        if modes.feed_mode == "G93":
            raise LineError(0, f"{name} has no time of its own: it needs G94 or G95, not G93")
        if any(letter not in machine.at for letter in (*plane[:2], plane.across)):
            raise LineError(0, f"{name} needs {plane.first}, {plane.second} and {plane.across} as axes")
        if (self.cycle, self.plane) != (name, modes.plane):
            self.cycle, self.plane, self.initial = name, modes.plane, machine.at[plane.across]
            self.words.clear()
        values = take_words(line, machine, name)
        self._take_words(line, plane.across, values)
        times = self._count_holes(line)
        first = machine.at[plane.across]
        base = first if modes.is_relative else machine.offsets.total[plane.across]
        clear = base + self.words["R"]
        bottom = self.words["depth"] + (clear if modes.is_relative else base)
        if bottom > clear:
            raise LineError(0, f"R of {name} is below its {plane.across}; the hole begins at R")
        steps = {letter: value for letter, value in values.items() if letter != plane.across}
        if first < clear:
            self._go(plane.across, clear, place, is_rapid=True)
        for _ in range(times):
            machine.go(machine.find_target(steps), place, is_rapid=True)
            self._go(plane.across, clear, place, is_rapid=True)
            self._drill(clear, bottom, place)
            height = clear if modes.returns_to_r else max(clear, self.initial)
            self._go(plane.across, height, place, is_rapid=True)

    def end(self) -> None:
        """Another motion: the words of the cycle do not hold any more."""
        self.cycle = ""

    def _take_words(self, line: CodeLine, across: str, values: Point) -> None:
        name, scale = self.cycle, self.machine.modes.scale
        if across in values:
            self.words["depth"] = values[across]
        for letter in ("R", *_WORDS.get(name, "")):
            word = line.take(letter, name)
            if word is not None:
                self.words[letter] = word.value * (1.0 if letter == "P" else scale)
                if (letter == "Q" and word.value <= 0) or (letter == "P" and word.value < 0):
                    raise LineError(word.column, f"{letter} of {name} must be above 0")
        needed_words = {"depth": across, "R": "R", **{letter: letter for letter in _WORDS.get(name, "")}}
        missing_words = [letter for key, letter in needed_words.items() if key not in self.words]
        if missing_words:
            raise LineError(0, f"{name} needs {', '.join(missing_words)}")

    def _count_holes(self, line: CodeLine) -> int:
        word = line.take("L", self.cycle)
        if word is None:
            return 1
        if word.value != int(word.value) or not 1 <= word.value <= MOST_HOLES:
            raise LineError(word.column, f"L of {self.cycle} is a number of holes, from 1 to {MOST_HOLES}")
        return int(word.value)

    def _drill(self, clear: float, bottom: float, place: Place) -> None:
        """Down to the bottom, in pecks where the cycle has them, with its dwell there."""
        across, name = PLANES[self.plane].across, self.cycle
        depth = clear
        if name in ("G73", "G83"):
            peck = self.words["Q"]
            if (clear - bottom) / peck > MOST_PECKS:
                raise LineError(0, f"Q of {name} makes more than {MOST_PECKS} pecks")
            while depth - peck > bottom:
                depth -= peck
                self._go(across, depth, place, is_rapid=False)
                if name == "G83":
                    self._go(across, clear, place, is_rapid=True)
                self._go(across, min(clear, depth + CLEARANCE_MM), place, is_rapid=True)
        self._go(across, bottom, place, is_rapid=False)
        if name in ("G82", "G89"):
            self.machine.writer.add_dwell(self.words["P"] * self.pause_unit_s)
        if name in ("G85", "G89"):
            self._go(across, clear, place, is_rapid=False)

    def _go(self, letter: str, to: float, place: Place, *, is_rapid: bool) -> None:
        self.machine.go({**self.machine.at, letter: to}, place, is_rapid=is_rapid)
