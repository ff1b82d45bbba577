"""Straight lines of a scan that flies: where each begins and ends, so that its axes have their speed in all windows."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from orchestrator.model.paths.pieces import LinePiece
from orchestrator.model.steps.fly import WindowPlace
from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.motions import glide
from orchestrator.plan.path_profiles import Array, FittedMotion
from orchestrator.plan.shape import WayEnd, WayLimits

_FRACTIONS: dict[WindowPlace, Fraction] = {"start": Fraction(-1, 2), "middle": Fraction(0), "end": Fraction(1, 2)}


class LineEnds(NamedTuple):
    """Where a line begins and ends, run-up and run-down included, by axis that flies, in their unit; forward: whether
    it goes the way of the first line."""

    begin: tuple[float, ...]
    end: tuple[float, ...]
    forward: bool


class FlownAxis(NamedTuple):
    """An axis that flies. first: its first user position, in its unit. spacing: from point to point of the first line,
    also its way in a window, with its sign. share: of the way along the line that it goes, above 0 to 1."""

    name: str
    first: Fraction
    spacing: Fraction
    counts_per_unit: Fraction
    share: float

    @property
    def window_counts(self) -> float:
        """Its way in a window, counts."""
        return abs(float(self.spacing * self.counts_per_unit))


@dataclass(frozen=True, slots=True)
class StraightLines(FlownLines):
    """Straight lines, on which the axes that fly keep one ratio from the run-up to the run-down.

    axes: those that fly. length: of a window, along the line. speed, acceleration: along it as well, in the windows
    and in the run-up, per s and per s². run_up: how far along the line the axes go in `run_up_s`; ramp_s: of it, how
    long the acceleration rises.
    """

    axes: Sequence[FlownAxis]
    length: float
    speed: float
    acceleration: float
    ramp_s: float
    run_up: float

    @property
    def lead_axis(self) -> FlownAxis:
        """The axis that passes the most counts in a window."""
        return max(self.axes, key=lambda axis: axis.window_counts)

    @property
    def lead(self) -> str:
        return self.lead_axis.name

    @property
    def slowest(self) -> float:
        return self.speed

    @property
    def turn_speeds(self) -> Sequence[float]:
        return [self.find_speed(axis) for axis in self.axes]

    @property
    def rooms(self) -> Sequence[float] | None:
        return [float(self.find_run_up(axis)) for axis in self.axes]

    @property
    def window_s(self) -> float:
        return self.length / self.speed

    @property
    def line_s(self) -> float:
        """The time of a line, s, as axes with a limit of jerk take it."""
        return 2 * self.run_up / self.speed + self.run_up_s + self.count * self.window_s

    def find_run_up(self, axis: FlownAxis) -> Fraction:
        """How far an axis goes in the run-up."""
        return Fraction(self.run_up * axis.share)

    def find_speed(self, axis: FlownAxis) -> float:
        """The speed of an axis in the windows, per s."""
        return self.speed * axis.share

    @property
    def ends(self) -> LineEnds:
        """Of a line that goes forward."""
        pairs = [self._find_axis_ends(axis) for axis in self.axes]
        return LineEnds(tuple(begin for begin, _ in pairs), tuple(end for _, end in pairs), forward=True)

    def _find_axis_ends(self, axis: FlownAxis) -> tuple[float, float]:
        way = self.find_run_up(axis) * (1 if axis.spacing > 0 else -1) + axis.spacing / 2
        last = axis.first + axis.spacing * (self.count - 1)
        return self._place(axis, axis.first - way), self._place(axis, last + way)

    def _place(self, axis: FlownAxis, position: Fraction) -> float:
        """An end of a line, on a whole count: the next one begins where this one has ended, and nothing is left to
        move. Of several axes that would turn the line; a path begins and ends within a count."""
        if len(self.axes) > 1:
            return float(position)
        return float(round(position * axis.counts_per_unit) / axis.counts_per_unit)

    def find_ends(self, point: int) -> LineEnds:
        """Of the line that a point of the scan, counted from 0, belongs to."""
        ends = self.ends
        return ends if self.is_forward(point) else LineEnds(ends.end, ends.begin, forward=False)

    def find_end(self, point: int) -> tuple[float, ...]:
        return self.find_ends(point).end

    def find_velocities(self, point: int) -> list[float]:
        """Of the axes that fly, with their signs, in the window of a point."""
        forward = self.is_forward(point)
        return [self.find_speed(axis) * (1 if forward == (axis.spacing > 0) else -1) for axis in self.axes]

    def find_begin(self, point: int) -> tuple[float, ...]:
        if not point % self.count:
            return self.find_ends(point).begin
        target, places = self.find_target(point), list[float]()
        for axis, velocity in zip(self.axes, self.find_velocities(point), strict=True):
            way = self.find_run_up(axis) + abs(axis.spacing) / 2
            places.append(self._place(axis, Fraction(target[axis.name]) - (way if velocity > 0.0 else -way)))
        return tuple(places)

    def find_states(self, point: int, part: int) -> list[WayEnd]:
        target, after_s = self.find_target(point), (part - 0.5) * self.window_s
        return [
            WayEnd(target[axis.name] + after_s * velocity, velocity)
            for axis, velocity in zip(self.axes, self.find_velocities(point), strict=True)
        ]

    def make_windows(self, point: int, count: int) -> FittedMotion:
        return glide(self.find_states(point, 0), count * self.window_s)

    def list_top_speeds(self, point: int, count: int) -> Array:
        del point
        return np.tile([self.find_speed(axis) for axis in self.axes], (count, 1))

    def share_out(self, limits: Sequence[WayLimits]) -> list[WayLimits]:
        """The limits in proportion to the ways of the axes, so that they stay on the line."""
        shares = [axis.share for axis in self.axes]
        velocity, acceleration, jerk = (
            min(value / share for value, share in zip(values, shares, strict=True))
            for values in zip(*limits, strict=True)
        )
        return [WayLimits(velocity * share, acceleration * share, jerk * share) for share in shares]

    def list_positions(self, point: int, place: WindowPlace = "middle") -> list[Fraction]:
        lead, direction = self.lead_axis, 1 if self.is_forward(point) else -1
        shift = lead.spacing * _FRACTIONS[place] * direction
        positions = [lead.first + lead.spacing * number + shift for number in range(self.count)]
        return positions[::direction]

    def make_path(self, point: int) -> FollowPath:
        ends = self.find_ends(point)
        return FollowPath(
            name=self.scan.name,
            axes=self.scan.flown_axes,
            start=list(ends.begin),
            pieces=[LinePiece(piece="line", to=list(ends.end))],
            speed=self.speed,
            tolerance=self.tolerance,
            triggers=self.make_triggers(point),
        )

    def list_reach(self) -> Sequence[Sequence[float]]:
        return list(zip(*self.ends[:2], strict=True))

    def describe(self) -> str:
        flies, along = ("fly", " along their line") if len(self.axes) > 1 else ("flies", "")
        unit = self.units[-1]
        return (
            f"{self.words} {flies} through {self.count} points at {self.speed:g} {unit}/s{along}, "
            f"{self.window_s * 1e3:g} ms each, with a run-up and a run-down of {self.run_up:.4g} {unit}"
        )
