"""The curves of a path by arc length: lines, arcs and polynomials, evaluated many at a time.

Everything here is in the space of the coordinates, in which lengths are measured; `frame` of a track maps to the axes.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orchestrator.plan.path.arc_length import (
    NEWTON_ROUNDS,
    Array,
    Index,
    LengthTable,
    find_parameters,
)

LINE, ARC, POLY = 0, 1, 2
QUICK = 0  # rounds of Newton where 1e-6 of a cell is enough


class Lines(NamedTuple):
    """Straight lines: start and unit direction, shape (n, coordinates)."""

    start: Array
    direction: Array


class Arcs(NamedTuple):
    """Arcs and helices: centre + first cos(w s) + second sin(w s) + rise s, with w = `turn` in rad per length.

    first and second: of the radius's length, at right angles to each other and to `rise`.
    """

    centre: Array
    first: Array
    second: Array
    rise: Array
    turn: Array


class Polys(NamedTuple):
    """Polynomials of degree 5 in u, with their lengths."""

    coefficients: Array
    table: LengthTable


class Derivatives(NamedTuple):
    """q and its derivatives with respect to arc length, each of shape (points, coordinates or axes)."""

    q: Array
    first: Array
    second: Array
    third: Array


@dataclass(frozen=True, slots=True)
class Shapes:
    """All curves of a path by kind."""

    lines: Lines
    arcs: Arcs
    polys: Polys

    def evaluate(self, kind: Index, row: Index, s: Array, rounds: int = NEWTON_ROUNDS) -> Derivatives:
        """Evaluate curve `row` of `kind` at length `s` from its own start. rounds: of Newton, for polynomials."""
        parts: list[tuple[Index, Derivatives]] = []
        for of, evaluator in ((LINE, self._evaluate_lines), (ARC, self._evaluate_arcs)):
            at = np.flatnonzero(kind == of)
            if len(at):
                parts.append((at, evaluator(row[at], s[at])))
        at = np.flatnonzero(kind == POLY)
        if len(at):
            u = find_parameters(*self.polys, row[at], s[at], rounds)
            parts.append((at, evaluate_polys(self.polys.coefficients, row[at], u)))
        if len(parts) == 1:
            return parts[0][1]
        out = Derivatives(*(np.empty((len(s), self.lines.start.shape[1])) for _ in range(4)))
        for at, part in parts:
            for target, values in zip(out, part, strict=True):
                target[at] = values
        return out

    def _evaluate_lines(self, row: Index, s: Array) -> Derivatives:
        direction = self.lines.direction[row]
        zero = np.zeros_like(direction)
        return Derivatives(self.lines.start[row] + s[:, None] * direction, direction, zero, zero)

    def _evaluate_arcs(self, row: Index, s: Array) -> Derivatives:
        centre, first, second, rise = (part[row] for part in self.arcs[:4])
        turn = self.arcs.turn[row][:, None]
        angle = turn * s[:, None]
        cos, sin = np.cos(angle), np.sin(angle)
        radial, along = first * cos + second * sin, second * cos - first * sin
        q = centre + radial + rise * s[:, None]
        return Derivatives(q, turn * along + rise, -(turn**2) * radial, -(turn**3) * along)


def evaluate_polys(coefficients: Array, row: Index, u: Array) -> Derivatives:
    """Evaluate the curves `row` at `u`: derivatives by arc length from those by u.

    With u' = 1/|x1|: u'' = -(x1·x2)/|x1|^4, u''' = u' (4 (x1·x2)²/|x1|^6 - (x2·x2 + x1·x3)/|x1|^4).
    """
    c0, c1, c2, c3, c4, c5 = (coefficients[:, k].take(row, axis=0) for k in range(6))
    # The Taylor coefficients at u, by dividing by (x - u) again and again. A full array is multiplied faster than a
    # column is spread.
    w = np.repeat(u[:, None], c0.shape[1], axis=1)
    for lowest in range(4):
        c4 += c5 * w
        c3 += c4 * w
        if lowest < 3:
            c2 += c3 * w
        if lowest < 2:
            c1 += c2 * w
        if lowest < 1:
            c0 += c1 * w
    x1, x2, x3 = c1, 2.0 * c2, 6.0 * c3
    square = np.einsum("ij,ij->i", x1, x1)
    cross_term = np.einsum("ij,ij->i", x1, x2)
    second_term = np.einsum("ij,ij->i", x2, x2) + np.einsum("ij,ij->i", x1, x3)
    rate = 1.0 / np.sqrt(square)
    rate_2 = -cross_term / square**2
    rate_3 = rate * (4 * cross_term**2 / square**3 - second_term / square**2)
    third = x3 * (rate**3)[:, None] + x2 * (3 * rate * rate_2)[:, None] + x1 * rate_3[:, None]
    second = x2 * (rate**2)[:, None] + x1 * rate_2[:, None]
    return Derivatives(c0, x1 * rate[:, None], second, third)
