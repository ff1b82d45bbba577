"""Lines and arcs of a program, as pieces of a path."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import hypot, pi
from typing import Any

from orchestrator.model.paths.circles import IN_MM, ROUNDING_MM, Arc, fit_arc
from orchestrator.model.paths.files.base.imported import format_number
from orchestrator.model.paths.files.gcode.contacts import Contacts
from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.line import CodeLine
from orchestrator.model.paths.files.gcode.modes import PLANES, Modes, Plane
from orchestrator.model.paths.files.gcode.offsets import WorkOffsets
from orchestrator.model.paths.files.gcode.words import Word
from orchestrator.model.paths.files.gcode.writer import StepWriter, Way, write_length
from orchestrator.model.paths.origin import Place

Point = dict[str, float]
MOST_TURNS = 10_000
NO_FEED = "no feed is chosen; write F with a speed a minute before the first G1"


@dataclass(slots=True)
class Machine:
    """What moves: modes, offsets, and where the program stands. at: positions of the axes, mm, by letter, which of an
    axis that stands beside a contact are so far from the number that stands for it; has_rapids: whether G0 is faster
    than the feed."""

    letters: list[str]
    modes: Modes
    offsets: WorkOffsets
    writer: StepWriter
    at: Point
    has_rapids: bool = True
    contacts: Contacts = field(default_factory=Contacts)

    def find_target(self, words: Mapping[str, float], *, is_machine: bool = False) -> Point:
        """Where a motion to these numbers ends. is_machine: they are positions of the axes (G53)."""
        target = dict(self.at)
        for letter, value in words.items():
            if is_machine:
                target[letter] = value
            else:
                target[letter] = value + (self.at if self.modes.is_relative else self.offsets.total)[letter]
        return target

    def list_fixed(self, words: Collection[str], *, is_machine: bool = False) -> Collection[str]:
        """The letters of words that are places, whatever the axes stand at."""
        return () if self.modes.is_relative and not is_machine else words

    def list_moved(self, to: Mapping[str, float], fixed: Collection[str]) -> list[str]:
        """The letters of the axes that a motion moves. fixed: see `list_fixed`."""
        return [
            letter
            for letter in self.letters
            if to[letter] != self.at[letter] or (letter in fixed and letter in self.contacts.present)
        ]

    def make_targets(
        self, to: Mapping[str, float], letters: Sequence[str], fixed: Collection[str]
    ) -> dict[str, dict[str, Any]]:
        """`to` and `by` of a step that moves the axes of letters from rest."""
        targets: dict[str, dict[str, Any]] = {"to": {}, "by": {}}
        for letter, axis in zip(letters, self.writer.find_axes(letters), strict=True):
            contact = None if letter in fixed else self.contacts.present.get(letter)
            if contact is None:
                targets["to"][axis] = write_length(to[letter])
            elif contact.is_certain:
                shift = write_length(to[letter] - contact.nominal)
                target = {"of": f"{contact.name}.{axis}", "plus": shift}
                targets["to"][axis] = {key: value for key, value in target.items() if value != "0 mm"}
            else:
                targets["by"][axis] = write_length(to[letter] - self.at[letter])
        return {key: value for key, value in targets.items() if value}

    def go(self, to: Point, place: Place, *, is_rapid: bool, fixed: Collection[str] = ()) -> None:
        """A straight line. fixed: the letters whose targets are places, see `list_fixed`."""
        speed = (
            None
            if is_rapid and (self.has_rapids or self.modes.feed is None)
            else self.find_speed(hypot(*(to[letter] - self.at[letter] for letter in self.letters)))
        )
        if self.contacts.present:
            self._go_from_rest(to, place, speed, fixed)
        else:
            self.writer.add_line(to, Way(speed, self.modes.corner, place))
        self.at = to

    def _go_from_rest(self, to: Point, place: Place, speed: float | None, fixed: Collection[str]) -> None:
        """A straight line that begins where an axis stands beside a contact: a move, as a path has a known start."""
        letters = self.list_moved(to, fixed)
        if not letters:
            return
        step: dict[str, Any] = {"do": "move", "name": f"line {place.line}", **self.make_targets(to, letters, fixed)}
        step["sync"] = "phase"
        if speed is not None:
            step["speed"] = f"{format_number(speed)} mm/s"
        self.writer.add_step(step, place.line)
        self.writer.stand_at(to)
        for letter in fixed:
            self.contacts.present.pop(letter, None)

    def find_speed(self, length: float) -> float:
        """The speed of a motion of a length, mm/s. Raises `LineError`."""
        modes = self.modes
        if modes.feed is None:
            raise LineError(0, "each motion needs its F with G93" if modes.feed_mode == "G93" else NO_FEED)
        if modes.feed_mode == "G93":
            return max(length, 1e-9) * modes.feed / 60
        if modes.feed_mode == "G95":
            if not modes.spindle_speed:
                raise LineError(0, "G95 is a feed per turn, and the speed of the spindle is not known; write S")
            return modes.feed * modes.spindle_speed / 60
        return modes.feed / 60


def take_words(line: CodeLine, machine: Machine, meaning: str) -> dict[str, float]:
    """The axis words of a line, mm. Raises `LineError`."""
    values: dict[str, float] = {}
    for letter in line.letters:
        if letter not in machine.at:
            continue
        word = line.take(letter, meaning)
        assert word is not None
        if letter in "ABC" and machine.modes.scale != 1.0:
            raise LineError(word.column, f"{letter} is an angle, and has no meaning in inches (G20)")
        values[letter] = word.value * machine.modes.scale
    return values


def make_arc(line: CodeLine, machine: Machine, place: Place) -> None:
    """G2 and G3: an arc, or a helix where another axis moves as well, or with several turns. Raises `LineError`."""
    modes, writer, name = machine.modes, machine.writer, machine.modes.motion
    plane = PLANES[modes.plane]
    if plane.first not in machine.at or plane.second not in machine.at:
        raise LineError(0, f"an arc in the plane of {plane.first} and {plane.second} needs both as axes")
    to = machine.find_target(take_words(line, machine, name))
    ends = _ArcEnds(machine.at, to, plane)
    radius, turns_word = line.take("R", name), line.take("P", f"the turns of {name}")
    centre = _find_centre(line, machine, ends, radius)
    turns = 0 if turns_word is None else _count_turns(turns_word)
    arc = _fit_arc(writer.point, ends, centre, name, radius)
    if radius is not None and arc.is_full:
        raise LineError(radius.column, f"no arc of radius {abs(radius.value):g}: a full circle needs I and J")
    end = (
        {**to, plane.first: writer.point[plane.first], plane.second: writer.point[plane.second]} if arc.is_full else to
    )
    rises = [to[letter] - machine.at[letter] for letter in machine.letters if letter not in plane[:2]]
    length = hypot((arc.angle + 2 * pi * turns) * hypot(*ends.from_centre(centre)), *rises)
    piece: dict[str, Any] = {
        "piece": "helix" if any(rises) or arc.is_full or turns else "arc",
        "centre": [f"{format_number(coordinate)} mm" for coordinate in centre],
        "plane": writer.find_axes(plane[:2]),
        "direction": "cw" if name == "G2" else "ccw",
    }
    if turns:
        piece["turns"] = turns
    writer.add_arc(piece, end, Way(machine.find_speed(length), modes.corner, place))
    machine.at = to


@dataclass(frozen=True, slots=True)
class _ArcEnds:
    """The ends of an arc in its plane."""

    begin: Mapping[str, float]
    finish: Mapping[str, float]
    plane: Plane

    @property
    def start(self) -> tuple[float, float]:
        return self.begin[self.plane.first], self.begin[self.plane.second]

    @property
    def end(self) -> tuple[float, float]:
        return self.finish[self.plane.first], self.finish[self.plane.second]

    def from_centre(self, centre: tuple[float, float]) -> tuple[float, float]:
        """The start from the centre."""
        return self.start[0] - centre[0], self.start[1] - centre[1]


def _fit_arc(
    point: Mapping[str, float], ends: _ArcEnds, centre: tuple[float, float], name: str, radius: Word | None
) -> Arc:
    """The arc as the planner makes it, from where the last piece ends."""
    begin = point[ends.plane.first], point[ends.plane.second]
    try:
        return fit_arc(begin, ends.end, centre, ccw=name == "G3", precision=IN_MM)
    except ValueError as error:
        raise LineError(0 if radius is None else radius.column, str(error)) from None


def _count_turns(word: Word) -> int:
    """The full turns in addition to the arc to its end."""
    if word.value != int(word.value) or not 1 <= word.value <= MOST_TURNS:
        raise LineError(word.column, f"P of an arc is its number of turns, from 1 to {MOST_TURNS}, not {word.value:g}")
    return int(word.value) - 1


def _find_centre(line: CodeLine, machine: Machine, ends: _ArcEnds, radius: Word | None) -> tuple[float, float]:
    """The centre by its offsets, or by the radius. Raises `LineError`."""
    modes, offsets, name = machine.modes, ends.plane[2:4], machine.modes.motion
    if radius is not None:
        return _find_centre_of_radius(radius, radius.value * modes.scale, ends, name)
    words = [line.take(letter, f"the centre of {name}") for letter in offsets]
    values = [0.0 if word is None else word.value * modes.scale for word in words]
    if modes.has_absolute_centres:
        if None in words:
            raise LineError(0, f"an arc needs its centre with G90.1: {offsets[0]} and {offsets[1]}, or R")
        total = machine.offsets.total
        return values[0] + total[ends.plane.first], values[1] + total[ends.plane.second]
    if hypot(*values) == 0.0:
        raise LineError(0, f"an arc needs its centre: {offsets[0]} and {offsets[1]}, or R")
    return ends.start[0] + values[0], ends.start[1] + values[1]


def _find_centre_of_radius(word: Word, radius: float, ends: _ArcEnds, name: str) -> tuple[float, float]:
    """The centre of an arc with a radius; a negative one is that of the longer arc."""
    x, y = (ends.end[0] - ends.start[0]) / 2, (ends.end[1] - ends.start[1]) / 2
    half = hypot(x, y)
    if half == 0 or half > abs(radius) + ROUNDING_MM:
        reason = (
            "a full circle has no radius form; give its centre" if half == 0 else f"its ends are {2 * half:g} mm apart"
        )
        raise LineError(word.column, f"no arc of radius {abs(radius):g} mm: {reason}")
    height = max(0.0, radius**2 - half**2) ** 0.5 / half
    if (name == "G3") == (radius < 0):
        height = -height
    return ends.start[0] + x - y * height, ends.start[1] + y + x * height
