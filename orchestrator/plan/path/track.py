"""A track: spans in order, corners blended or marked as stops, ready to be evaluated by length and planned."""

from dataclasses import dataclass

import numpy as np

from orchestrator.plan.path.arc_length import NEWTON_ROUNDS, Array, Flags, Index
from orchestrator.plan.path.curves import Derivatives, Shapes


@dataclass(frozen=True, slots=True)
class Frame:
    """The affine map from coordinates to axes: matrix (axes, coordinates) and offset."""

    matrix: Array
    offset: Array

    def apply(self, values: Derivatives) -> Derivatives:
        """Map positions and derivatives to the axes."""
        q, *derivatives = (part @ self.matrix.T for part in values)
        return Derivatives(q + self.offset, *derivatives)


@dataclass(frozen=True, slots=True)
class Track:
    """Spans of curves, one entry each: `kind` and `row` in `shapes`; `low`: where on its curve it begins; its length.

    piece: its number from 0, and source: its span of the outline (of a blend, those before it); blend: whether it
    rounds a corner; stop: whether the motion rests at its end (the last one does). speed: the highest one along it,
    beside that of the path (inf: none). start: lengths from the track's start, one more entry.
    """

    shapes: Shapes
    frame: Frame | None
    kind: Index
    row: Index
    low: Array
    length: Array
    piece: Index
    source: Index
    blend: Flags
    stop: Flags
    speed: Array
    start: Array

    @property
    def end(self) -> float:
        """The length of all."""
        return float(self.start[-1])

    def find_spans(self, s: Array) -> Index:
        """The span at each length; at a junction the later one."""
        return np.searchsorted(self.start[1:-1], s, side="right")

    def evaluate(self, s: Array, rounds: int = NEWTON_ROUNDS, section: Index | None = None) -> Derivatives:
        """Positions of the axes and their derivatives at lengths `s`. section: the number of the stretch from rest to
        rest that each point belongs to, because where it rests the path may turn."""
        span = self.find_spans_of(s, section)
        return self.evaluate_spans(span, s - self.start[span], rounds)

    def find_spans_of(self, s: Array, section: Index | None) -> Index:
        """The span at each length, in the section of each point."""
        span = self.find_spans(s)
        if section is None:
            return span
        last = np.flatnonzero(self.stop)
        return np.clip(span, np.concatenate([[0], last[:-1] + 1])[section], last[section])

    def evaluate_spans(self, span: Index, local: Array, rounds: int = NEWTON_ROUNDS) -> Derivatives:
        """The same, at `local` lengths from the starts of spans."""
        local = np.clip(local, 0.0, self.length[span])
        shape = self.shapes.evaluate(self.kind[span], self.row[span], self.low[span] + local, rounds)
        return shape if self.frame is None else self.frame.apply(shape)
