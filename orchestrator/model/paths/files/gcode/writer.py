"""The steps of a job that a program makes: paths, and what stands between them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from orchestrator.model.paths.files.base.imported import format_number
from orchestrator.model.paths.files.gcode.errors import LineError, ProgramLimit
from orchestrator.model.paths.origin import Place
from orchestrator.model.paths.pieces import MAX_PIECES

MOVING = ("path", "move", "probe")
LARGEST_MM = 1e9
PLACES = 9  # of mm: increments are summed up with rounding


@dataclass(frozen=True, slots=True)
class Way:
    """How a piece is gone along. speed: mm/s; None: as fast as the axes may. corner: at its end; None: what the job
    says. place: of its line."""

    speed: float | None
    corner: str | dict[str, str] | None
    place: Place


@dataclass(slots=True)
class _Path:
    """A path that is being made, and the place of each piece."""

    start: list[str]
    pieces: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    places: list[Place] = field(default_factory=list[Place])


class StepWriter:
    """Writes paths. steps, places: with the places of the pieces of each step; lines: of the steps that
    are no paths.

    point: where the last piece ends, mm, by letter: what is written is a full circle's start where its end is off by
    rounding.
    """

    def __init__(self, axes: Mapping[str, str], start: Mapping[str, float]) -> None:
        self.steps: list[dict[str, Any]] = []
        self.places: list[list[Place]] = []
        self.lines: list[int] = []
        self.point = {letter: start.get(letter, 0.0) for letter in axes}
        self._letters = list(axes)
        self._axes = list(axes.values())
        self._path: _Path | None = None
        self._texts = self._write(self.point)

    def add_line(self, to: Mapping[str, float], way: Way) -> None:
        """Add a line; none to where the axes stand already."""
        texts = self._write(to)
        if texts != self._texts:
            self._add({"piece": "line", "to": texts}, to, way)

    def add_arc(self, piece: dict[str, Any], to: Mapping[str, float], way: Way) -> None:
        """Add an arc or a helix, to which its end is added."""
        self._add({**piece, "to": self._write(to)}, to, way)

    def add_step(self, step: dict[str, Any], line: int = 0) -> None:
        """Add a step behind the present path, which ends at rest. line: that it was made of."""
        self.end_path()
        self.steps.append(step)
        self.places.append([])
        self.lines.append(line)

    def add_dwell(self, seconds: float) -> None:
        """End the path, and wait."""
        self.end_path()
        if seconds > 0:
            self.add_step({"do": "dwell", "duration": f"{format_number(seconds)} s"})

    def end_path(self) -> None:
        """End the present path."""
        path, self._path = self._path, None
        if path is None:
            return
        step: dict[str, Any] = {"do": "path", "axes": self._axes, "start": path.start, "pieces": path.pieces}
        speeds = {piece.get("speed") for piece in path.pieces}
        if len(speeds) == 1 and speeds != {None}:
            step["speed"] = speeds.pop()
            for piece in path.pieces:
                del piece["speed"]
        self.steps.append(step)
        self.places.append(path.places)
        self.lines.append(0)

    @property
    def has_moved(self) -> bool:
        """Whether a step or a piece moves axes."""
        return self._path is not None or any(step["do"] in MOVING for step in self.steps)

    def stand_at(self, point: Mapping[str, float]) -> None:
        """The axes stand elsewhere behind a step that is no path."""
        self.point = dict(point)
        self._texts = self._write(point)

    def list_places(self) -> dict[str, str]:
        """Where the axes stand, by axis."""
        return dict(zip(self._axes, self._texts, strict=True))

    def forget(self) -> None:
        """Forget all steps: what is written begins here."""
        self.end_path()
        self.steps.clear()
        self.places.clear()
        self.lines.clear()

    def move_here(self) -> dict[str, Any]:
        """A move of all axes to where the program stands."""
        return {"do": "move", "to": self.list_places()}

    def find_axes(self, letters: Sequence[str]) -> list[str]:
        """The axes of letters."""
        return [self._axes[self._letters.index(letter)] for letter in letters]

    def _add(self, piece: dict[str, Any], to: Mapping[str, float], way: Way) -> None:
        if self._path is None:
            self._path = _Path(self._texts)
        path = self._path
        if len(path.pieces) >= MAX_PIECES:
            raise ProgramLimit(0, f"a path has at most {MAX_PIECES} pieces; split the program")
        if way.speed is None:
            if path.pieces:
                path.pieces[-1]["corner"] = "stop"  # no rounding from a feed into a rapid
            piece["corner"] = "stop"
        else:
            if way.corner is not None:
                piece["corner"] = way.corner
            piece["speed"] = f"{format_number(way.speed)} mm/s"
        path.pieces.append(piece)
        path.places.append(way.place)
        self.point = dict(to)
        self._texts = piece["to"]

    def _write(self, point: Mapping[str, float]) -> list[str]:
        for letter in self._letters:
            if not -LARGEST_MM <= point[letter] <= LARGEST_MM:
                raise LineError(0, f"{letter} would go to {point[letter]:g} mm; the farthest is {LARGEST_MM:g}")
        return [write_length(point[letter]) for letter in self._letters]


def write_length(value: float) -> str:
    """A length as it stands in a job file. value: mm."""
    return f"{format_number(round(value, PLACES))} mm"
