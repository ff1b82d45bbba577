"""What an importer makes: the steps of a job, with the places of what they were made of."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.model.paths.origin import Place
from orchestrator.model.paths.source import PathSource

DIGITS = 10  # of a number: more than any controller counts


def format_number(value: float) -> str:
    """A number as it stands in a job file."""
    text = f"{value:.{DIGITS}g}"
    return "0" if text == "-0" else text


@dataclass(frozen=True, slots=True)
class ImportedSteps:
    """The steps of a job that a file stands for. places: of the pieces of each path in the file; none for other steps.

    notes: what was left out, and why that changes nothing; modes: with which a part of a program begins, in words.
    digests: by name, of the file and of what it needs. lines: by step, where one that is no path stands; 0: it is not
    known.
    """

    file: str
    steps: list[dict[str, Any]]
    places: list[list[Place]]
    notes: list[str] = field(default_factory=list[str])
    modes: list[str] = field(default_factory=list[str])
    digests: dict[str, str] = field(default_factory=dict[str, str])
    lines: list[int] = field(default_factory=list[int])

    def find_places(self, step: int) -> Sequence[Place]:
        """Where the pieces of a path stand, or another step; none where that is not known."""
        line = self.lines[step] if step < len(self.lines) else 0
        return self.places[step] or ([Place(line)] if line else [])

    def make_source(self, step: int) -> dict[str, Any]:
        """What the pieces of a path were made of, as a field of its step."""
        lines = [line for line, _ in self.places[step]]
        source = PathSource.of_lines(Path(self.file).name, lines, self.digests)
        return {"source": source.model_dump(mode="json", exclude_defaults=True)}


def make_job(name: str, steps: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """A job file of steps, in plain values."""
    return {"schema": "tutti.job/1", "name": name, "steps": list(steps)}
