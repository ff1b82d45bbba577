"""Moves of curved virtual axes that stand for several real ones: a path of the real axes.

The virtual axes of the group go along a straight line; the real ones follow its curve. It is planned as a spline
through points of the curve, in counts: so axes of different units are alike, and a distance from it is one of counts.
How far the spline leaves the line is measured in the virtual axes themselves, and part of their bound.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from math import hypot
from typing import Any, Literal

import numpy as np
from pydantic import PrivateAttr

from orchestrator.model.curved_map import CurvedMap
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.linear_map import MapError
from orchestrator.model.names import controller_of
from orchestrator.model.paths.pieces import LinePiece, SplinePiece
from orchestrator.model.report import PathReport
from orchestrator.model.steps.kinds import Motion
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.tree import as_move
from orchestrator.model.units import Quantity, Unit
from orchestrator.plan.path_profiles import Array
from orchestrator.plan.path_step import PathStart, PlannedPath, describe_jerk_remedy, make_moves, plan_path_step
from orchestrator.plan.racks import require_single_motor
from orchestrator.plan.shape import PlanError
from orchestrator.plan.speeds import limit_speeds
from orchestrator.plan.step import AxisMove, StepPlan
from orchestrator.plan.virtual_bound import CurvedLine
from orchestrator.plan.virtual_moves import (
    VirtualWay,
    find_curved_group,
    find_virtual_way,
    go_straight,
    require_apart,
)

FIT_COUNTS = 0.5
"""How far the profiles may be off the spline."""
FIRST_POINTS, MOST_POINTS = 16, 1024
MOST_CURVE_COUNTS = 0.5
"""How far the spline may be off the curve, in counts of its real axes."""
SAMPLES_PER_POINT = 4
OPTIONS = ("name", "record", "align", "max_start_skew", "triggers")
"""What a path and a move have in common."""


class CurvedMove(FollowPath):
    """The step that moves curved virtual axes of a group. It is made when its turn comes, and never sent or stored."""

    do: Literal["move"] = "move"  # pyright: ignore[reportIncompatibleVariableOverride] - of its report
    _move: Move = PrivateAttr()
    _group: str = PrivateAttr()

    @property
    def move(self) -> Move:
        """The step as it was written."""
        return self._move

    @property
    def group(self) -> str:
        """The group of its virtual axes."""
        return self._group

    @classmethod
    def make(cls, fleet: Fleet, move: Move, group: str) -> "CurvedMove":
        """The step for a move of a group."""
        axes = list(fleet.virtual_axes.maps[group].real)
        point: list[Quantity] = [0.0] * len(axes)  # where it goes is found from where its axes stand
        options: dict[str, Any] = {name: getattr(move, name) for name in OPTIONS} | {"start_class": move.start_wish}
        path = cls(axes=axes, start=point, pieces=[LinePiece(piece="line", to=point)], tolerance=1.0)
        path = path.model_copy(update=options)
        path._move, path._group = move, group  # noqa: SLF001
        return path


def straighten(fleet: Fleet, step: Motion) -> Motion:
    """The step as it is planned: one of virtual axes goes along a straight line of its real axes, or, in a curved group
    of several, along a path of them."""
    move = as_move(step)
    if move is None:
        return step
    group = find_curved_group(fleet, move)
    return go_straight(fleet, move) if group is None else CurvedMove.make(fleet, move, group)


def plan_curved_move(step: CurvedMove, starts: Sequence[PathStart], fleet: Fleet) -> PlannedPath:
    """Plan a move of a curved group from where its real axes stand. Raises `Refusal`, `PlanError`."""
    virtual_map = fleet.virtual_axes.maps[step.group]
    assert isinstance(virtual_map, CurvedMap)
    require_apart(fleet, step.move)
    _require_path_makes(step, starts)
    positions = [start.here + start.offset for start in starts]
    way = find_virtual_way(fleet, step.move, step.group, positions)
    assert way is not None, "all positions are known"
    curve = _Curve(virtual_map, way, starts)
    exact = {
        start.name: (target - start.offset, counts)
        for start, target, counts in zip(starts, way.targets, curve.last, strict=True)
    }
    moves = limit_speeds(fleet, step.move, make_moves(starts, exact))
    if not curve.is_moved:
        return _stand(moves, exact)
    counted_starts = [_count_in_counts(start, move.velocity) for start, move in zip(starts, moves, strict=True)]
    points = FIRST_POINTS
    while True:
        path = plan_path_step(_make_spline(step, curve, points), counted_starts)
        line = curve.measure(path, points * SAMPLES_PER_POINT + 1)
        if all(line.errors[name] <= factor * MOST_CURVE_COUNTS for name, factor in line.factors.items()):
            break
        points *= 4
        if points > MOST_POINTS:
            text = f"the curve of {step.group} bends too sharply on its way to be followed within a count"
            raise PlanError(f"{text}; choose a nearer target")
    # A move states no tolerance: what it keeps is the bound of its virtual axes.
    return replace(path, exact=exact, tolerance=path.report.length, line=line)


class _Curve:
    """The real axes on the line of a group, in counts."""

    def __init__(self, virtual_map: CurvedMap, way: VirtualWay, starts: Sequence[PathStart]) -> None:
        self._map, self._starts = virtual_map, starts
        self._begin, self._end = (np.array([float(value) for value in end]) for end in (way.begin, way.end))
        self._sizes = [abs(float(start.axis.counts_per_unit)) for start in starts]
        self.first = [start.start_counts for start in starts]
        self.last = [
            start.axis.to_target_counts(target - start.offset)
            for start, target in zip(starts, way.targets, strict=True)
        ]

    @property
    def is_moved(self) -> bool:
        return self.first != self.last

    def list_points(self, count: int) -> list[list[Quantity]]:
        """Points of the curve behind its begin, in counts of the real axes, the last one its end."""
        points: list[list[Quantity]] = []
        for share in np.linspace(0.0, 1.0, count + 1)[1:-1].tolist():
            virtual = [Fraction(value) for value in (self._begin + share * (self._end - self._begin)).tolist()]
            try:
                real = self._map.to_real(virtual)
            except MapError as error:
                raise Refusal("outside-map", str(error), "choose other targets") from None
            points.append(
                [
                    float((position - start.offset) * start.axis.counts_per_unit)
                    for position, start in zip(real, self._starts, strict=True)
                ]
            )
        return [*points, list(map(float, self.last))]

    def measure(self, path: PlannedPath, count: int) -> CurvedLine:
        """How far the virtual axes leave their line on a planned path, by `count` samples of it."""
        assert path.course is not None
        times_s = np.linspace(0.0, path.course.duration_s, count)
        samples = path.course.motion.evaluate(times_s)[0]
        reals = [
            [
                value / float(start.axis.counts_per_unit) + float(start.offset)
                for value, start in zip(row, self._starts, strict=True)
            ]
            for row in samples.tolist()
        ]
        factors = np.max([self._find_factors(real) for real in reals[:: max(1, count // 64)]], axis=0)
        virtual = np.array([self._map.observe(real) for real in reals])
        errors = np.max(np.abs(self._find_distances(virtual, factors)), axis=0)
        names = self._map.virtual
        return CurvedLine(
            dict(zip(names, errors.tolist(), strict=True)), dict(zip(names, factors.tolist(), strict=True))
        )

    def _find_factors(self, real: Sequence[float]) -> list[float]:
        """How far each virtual axis moves by one count of the real axes together, at a position."""
        rows = self._map.find_rows(real)
        return [hypot(*(part / size for part, size in zip(row, self._sizes, strict=True))) for row in rows]

    def _find_distances(self, virtual: Array, factors: Array) -> Array:
        """From positions to the nearest ones of the line, where what moves an axis by one count is one length."""
        way = (self._end - self._begin) / factors
        offsets = (virtual - self._begin) / factors
        shares = offsets @ way / (way @ way)
        return (offsets - shares[:, None] * way) * factors


def _count_in_counts(start: PathStart, velocity: float) -> PathStart:
    """The start of an axis whose unit is one count. velocity: its limit in this step, counts/s."""
    axis, size = start.axis, abs(float(start.axis.counts_per_unit))
    limits: dict[str, float] = {"velocity": velocity, "acceleration": axis.limits.acceleration * size}
    if axis.limits.jerk is not None:
        limits["jerk"] = axis.limits.jerk * size
    plain: dict[str, Any] = {"motors": axis.motors, "unit": Unit.COUNTS.value, "scale": 1, "limits": limits}
    ends = axis.soft_limits_counts
    if ends is not None:
        plain["soft_limits"] = {"min": ends[0], "max": ends[1]}
    counted_axis = Axis.model_validate(plain)
    return start._replace(axis=counted_axis, here=Fraction(start.start_counts), offset=Fraction(0))


def _make_spline(step: CurvedMove, curve: _Curve, points: int) -> FollowPath:
    piece = SplinePiece(piece="spline", through=curve.list_points(points))
    begin: list[Quantity] = [*map(float, curve.first)]
    return FollowPath(axes=step.axes, start=begin, pieces=[piece], tolerance=FIT_COUNTS)


def _require_path_makes(step: CurvedMove, starts: Sequence[PathStart]) -> None:
    """Raise `Refusal` for a real axis that cannot follow a curve."""
    for start in starts:
        owner = controller_of(start.name)
        require_single_motor(start.name, start.axis, f"make {step.group}")
        if start.axis.is_compensated:
            text = f"axis {start.name} has `backlash` or `correction`, which a move of the curved {step.group} lacks"
            raise Refusal("not-compensated", text, "move its real axes", owner)
        if start.order < 3:
            text = f"{step.group} is curved, and {start.name} cannot follow the curve: its controller executes moves "
            remedy = f"move its real axes{describe_jerk_remedy(start.axis)}"
            raise Refusal("curved", text + "from rest to rest only", remedy, owner)


def _stand(moves: list[AxisMove], exact: Mapping[str, tuple[Fraction, int]]) -> PlannedPath:
    """The path of axes that are at their targets."""
    names, times_s = list(exact), np.zeros(2)
    return PlannedPath(
        plan=StepPlan(0.0, {}, names),
        moves=moves,
        exact=exact,
        report=PathReport(unit=Unit.COUNTS, length=0.0, duration_s=0.0),
        tolerance=0.0,
        fit_error=0.0,
        counts_per_unit=dict.fromkeys(names, 1.0),
        times_s=times_s,
        speeds=dict.fromkeys(names, times_s),
        course=None,
    )
