"""G-code, the part of it that describes a path: G0 to G4, G17 to G21, G61, G64 P, G90, G91, F.

Meanings are those of LinuxCNC's G-code reference (RS274/NGC). Whatever else a file has is refused, with line and
column: a word that is left out could be the one on which the machine depends.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import hypot, isclose
from typing import Any, NamedTuple

from orchestrator.model.paths.files.imported import ImportProblems, format_number

LETTERS = "XYZABC"
INCH_MM = 25.4
ARC_ERROR = (
    0.005  # mm, and a thousandth of the radius: how far the end of an arc may be off its circle (LinuxCNC: 0.0127)
)

_WORD = re.compile(r"\s*([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_COMMENT = re.compile(r"\([^()]*\)|;.*")
_PLANES = {17: ("X", "Y", "I", "J"), 18: ("Z", "X", "K", "I"), 19: ("Y", "Z", "J", "K")}
_MOTION = frozenset({0, 1, 2, 3})
_MODES = frozenset({17, 18, 19, 20, 21, 61, 64, 90, 91})


class _Word(NamedTuple):
    """A letter with its number. column: where it begins, from 1."""

    letter: str
    value: float
    column: int


@dataclass(slots=True)
class _Modes:
    """The modes of a program: they hold until they are changed."""

    motion: int | None = None
    plane: int = 17
    scale: float = 1.0  # mm of a unit of the program
    relative: bool = False
    feed: float | None = None  # mm a minute
    corner: str | dict[str, str] = "stop"


@dataclass(slots=True)
class _Path:
    """A path that is being made. Its pieces have the speed of their feed; those of G0 none: as fast as the axes may."""

    start: list[str]
    pieces: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])


class GcodeReader:
    """Reads one program. axes: by letter, the axis of the fleet, e.g. `{"X": "gantry.x"}`; linear ones in mm.

    start: where the axes stand, mm, by letter; those that are not named stand at 0.
    """

    def __init__(self, name: str, axes: Mapping[str, str], start: Mapping[str, float] | None = None) -> None:
        self._letters = [axis.upper() for axis in axes]
        self._axes = list(axes.values())
        self._problems = ImportProblems(name)
        self._modes = _Modes()
        self._at = {letter: (start or {}).get(letter, 0.0) for letter in self._letters}
        self._steps: list[dict[str, Any]] = []
        self._path: _Path | None = None
        self._line = 0

    def read_steps(self, lines: Sequence[str]) -> list[dict[str, Any]]:
        """The steps of a job: paths, and dwells between them. Raises `FileError` with every mistake."""
        for self._line, text in enumerate(lines, 1):
            self._read_line(text)
        self._end_path()
        if not self._steps and not self._problems.found:
            self._problems.add(max(1, self._line), 0, "the program moves nothing")
        self._problems.raise_any()
        return self._steps

    # A line

    def _read_line(self, text: str) -> None:
        bare = _COMMENT.sub(lambda match: " " * len(match.group()), text.rstrip("\r\n"))
        if bare.strip() in ("", "%"):
            return
        words = list(self._read_words(bare))
        count = len(self._problems.found)
        codes = [(_find_code(word), word) for word in words if word.letter == "G"]
        for code, word in codes:
            if code not in _MOTION | _MODES and code != 4:
                self._refuse(
                    word, f"G{word.value:g} is not supported; supported are G0 to G4, G17 to G21, G61, G64, G90, G91"
                )
        values = self._collect_values(words)
        if len(self._problems.found) > count:
            return
        self._change_modes([code for code, _ in codes if code is not None], values)
        if any(code == 4 for code, _ in codes):
            self._dwell(values)
        elif self._moves(values):
            self._move(values)
        elif values.keys() - {"F", "P", "N"}:
            word = next(iter(value for letter, value in values.items() if letter not in "FPN"))
            self._refuse(word, f"{word.letter} has no meaning without a move")

    def _read_words(self, text: str) -> Iterator[_Word]:
        at = 0
        while text[at:].strip():
            match = _WORD.match(text, at)
            if match is None:
                column = at + 1 + len(text[at:]) - len(text[at:].lstrip())
                self._problems.add(
                    self._line, column, f"{text[column - 1 :][:20]!r} is no word of a letter and a number"
                )
                return
            yield _Word(match[1].upper(), float(match[2]), match.start(1) + 1)
            at = match.end()

    def _collect_values(self, words: Sequence[_Word]) -> dict[str, _Word]:
        """The words of a line by letter, without G and line numbers; mistakes are noted."""
        values: dict[str, _Word] = {}
        for word in words:
            if word.letter in "GN":
                continue
            if word.letter in values:
                self._refuse(word, f"{word.letter} stands twice in this line")
            elif word.letter in LETTERS and word.letter not in self._letters:
                self._refuse(word, f"no axis is named for {word.letter}; name it: --axis {word.letter}=CONTROLLER.AXIS")
            elif word.letter not in f"{LETTERS}FIJKPR":
                self._refuse(word, f"{word.letter}{word.value:g} is not supported")
            values[word.letter] = word
        return values

    def _change_modes(self, codes: Sequence[int], values: Mapping[str, _Word]) -> None:
        modes = self._modes
        for code in codes:
            if code in _MOTION:
                modes.motion = code
            elif code in _PLANES:
                modes.plane = code
            elif code in (20, 21):
                modes.scale = INCH_MM if code == 20 else 1.0
            elif code in (90, 91):
                modes.relative = code == 91
            elif code == 61:
                modes.corner = "stop"
            elif code == 64:
                self._change_corner(values)
        feed = values.get("F")
        if feed is not None:
            if feed.value <= 0:
                self._refuse(feed, f"a feed must be above 0, not {feed.value:g}")
            modes.feed = feed.value * modes.scale

    def _change_corner(self, values: Mapping[str, _Word]) -> None:
        tolerance = values.get("P")
        if tolerance is None or tolerance.value <= 0:
            self._problems.add(self._line, 0, "G64 needs a tolerance above 0: write for example G64 P0.05")
            return
        self._modes.corner = {"within": f"{format_number(tolerance.value * self._modes.scale)} mm"}

    def _moves(self, values: Mapping[str, _Word]) -> bool:
        """Whether a line moves: it names an axis, or the centre of a full circle."""
        is_circle = self._modes.motion in (2, 3) and bool({"I", "J", "K"} & values.keys())
        return is_circle or any(letter in values for letter in self._letters)

    # What it does

    def _dwell(self, values: Mapping[str, _Word]) -> None:
        pause = values.get("P")
        if pause is None or pause.value < 0:
            self._problems.add(self._line, 0, "G4 needs a time in seconds: write for example G4 P0.5")
            return
        self._end_path()
        if pause.value > 0:
            self._steps.append({"do": "dwell", "duration": f"{format_number(pause.value)} s"})

    def _move(self, values: Mapping[str, _Word]) -> None:
        modes, start = self._modes, dict(self._at)
        if modes.motion is None:
            self._problems.add(self._line, 0, "no motion is chosen; begin with G0, G1, G2 or G3")
            return
        if modes.motion and modes.feed is None:
            self._problems.add(self._line, 0, "no feed is chosen; write F with a speed a minute before the first G1")
            return
        for letter in self._letters:
            if letter in values:
                value = values[letter].value * modes.scale
                self._at[letter] = start[letter] + value if modes.relative else value
        piece = self._make_line() if modes.motion < 2 else self._make_arc(values, start)
        if piece is None or (modes.motion < 2 and self._at == start):
            return  # a mistake, or a move to where it stands
        if self._path is None:
            self._path = _Path([self._write(start[letter]) for letter in self._letters])
        rapid = not modes.motion
        if rapid and self._path.pieces:
            self._path.pieces[-1]["corner"] = "stop"  # no rounding from a feed into a rapid
        piece["corner"] = "stop" if rapid else modes.corner
        if not rapid and modes.feed is not None:
            piece["speed"] = f"{format_number(modes.feed / 60)} mm/s"
        self._path.pieces.append(piece)

    def _make_line(self) -> dict[str, Any]:
        return {"piece": "line", "to": self._write_point()}

    def _make_arc(self, values: Mapping[str, _Word], before: Mapping[str, float]) -> dict[str, Any] | None:
        """An arc, or a helix where another axis moves as well; None after a mistake."""
        first, second, *offsets = _PLANES[self._modes.plane]
        if first not in self._letters or second not in self._letters:
            self._problems.add(self._line, 0, f"an arc in the plane of {first} and {second} needs both as axes")
            return None
        centre = self._find_centre(values, before, offsets)
        if centre is None:
            return None
        plane = [self._axes[self._letters.index(letter)] for letter in (first, second)]
        other_letters = [
            letter for letter in self._letters if letter not in (first, second) and self._at[letter] != before[letter]
        ]
        is_circle = all(isclose(self._at[letter], before[letter], abs_tol=1e-9) for letter in (first, second))
        return {
            "piece": "helix" if other_letters or is_circle else "arc",
            "to": self._write_point(),
            "centre": [self._write(coordinate) for coordinate in centre],
            "plane": plane,
            "direction": "cw" if self._modes.motion == 2 else "ccw",
        }

    def _find_centre(
        self, values: Mapping[str, _Word], before: Mapping[str, float], offsets: Sequence[str]
    ) -> tuple[float, float] | None:
        first, second, *_ = _PLANES[self._modes.plane]
        start, end = (before[first], before[second]), (self._at[first], self._at[second])
        if "R" in values:
            return self._find_centre_of_radius(values["R"], start, end)
        given_values = [values[offset].value * self._modes.scale if offset in values else 0.0 for offset in offsets]
        centre = start[0] + given_values[0], start[1] + given_values[1]
        radius, end_radius = hypot(*given_values), hypot(end[0] - centre[0], end[1] - centre[1])
        if radius == 0:
            self._problems.add(self._line, 0, f"an arc needs its centre: {offsets[0]} and {offsets[1]}, or R")
            return None
        if abs(radius - end_radius) > ARC_ERROR + radius / 1000:
            text = f"the end of the arc is {end_radius:g} mm from its centre, and its start {radius:g} mm"
            self._problems.add(self._line, 0, text)
            return None
        return centre

    def _find_centre_of_radius(
        self, word: _Word, here: tuple[float, float], there: tuple[float, float]
    ) -> tuple[float, float] | None:
        """The centre of an arc with a radius; a negative one is that of the longer arc."""
        radius = word.value * self._modes.scale
        x, y = (there[0] - here[0]) / 2, (there[1] - here[1]) / 2
        half = hypot(x, y)
        if half == 0 or half > abs(radius) + ARC_ERROR:
            reason = (
                "a full circle has no radius form; give its centre"
                if half == 0
                else f"its ends are {2 * half:g} mm apart"
            )
            self._refuse(word, f"no arc of radius {abs(radius):g} mm: {reason}")
            return None
        height = max(0.0, radius**2 - half**2) ** 0.5 / half
        if (self._modes.motion == 3) == (radius < 0):
            height = -height
        return here[0] + x - y * height, here[1] + y + x * height

    # Inside

    def _end_path(self) -> None:
        path, self._path = self._path, None
        if path is not None:
            step: dict[str, Any] = {"do": "path", "axes": self._axes, "start": path.start, "pieces": path.pieces}
            speeds = {piece.get("speed") for piece in path.pieces}
            if len(speeds) == 1 and speeds != {None}:
                step["speed"] = speeds.pop()
                for piece in path.pieces:
                    del piece["speed"]
            self._steps.append(step)

    def _write_point(self) -> list[str]:
        return [self._write(self._at[letter]) for letter in self._letters]

    def _write(self, value: float) -> str:
        return f"{format_number(value)} mm"

    def _refuse(self, word: _Word, text: str) -> None:
        self._problems.add(self._line, word.column, text)


def _find_code(word: _Word) -> int | None:
    """The number of a G word; None for one with a fraction, such as G61.1."""
    return int(word.value) if word.value == int(word.value) else None
