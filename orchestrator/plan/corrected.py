"""Motions of corrected axes: where the errors of their tables are counted, and how far they may be off.

A move takes its real axes to where its targets are, each in its own time, and is exact at both ends; on the way an axis
is off by what its errors differ there. A path turns each of its points into positions of the real axes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from orchestrator.model.compensation import Approach
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.linear_map import CorrectedMap
from orchestrator.model.names import controller_of
from orchestrator.model.profile import Profile
from orchestrator.model.report import PositionBound
from orchestrator.model.steps.base import Step
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path_profiles import PathStates
from orchestrator.plan.play import ROUNDED_COUNTS, bound_way
from orchestrator.plan.virtual_moves import group_virtual

LEAST_FACTOR = 1e-7  # less is what is left of a cosine
LIMITS = ("velocity", "acceleration", "jerk")


def require_no_offset(fleet: Fleet, group: str, offsets: Mapping[str, Fraction]) -> None:
    """Raise `Refusal` for real axes of a corrected group that have a user offset. offsets: by axis."""
    table_map = fleet.virtual_axes.maps[group]
    if isinstance(table_map, CorrectedMap):
        require_own_zero(table_map, offsets)


def require_own_zero(corrected: CorrectedMap, offsets: Mapping[str, Fraction]) -> None:
    """The same, by the map of the group."""
    for name in corrected.real:
        text = corrected.explain_offset(name, offsets[name])
        if text is not None:
            remedy = f"remove it: a step `{{do: set-position, axes: {{{name}: null}}}}`"
            raise Refusal("user-offset", text, remedy, controller_of(name))


def find_followers(fleet: Fleet, group: str, names: Sequence[str]) -> list[str]:
    """The real axes of a corrected group that move along with some of its axes by its errors, and are not named."""
    table_map = fleet.virtual_axes.maps[group]
    if not isinstance(table_map, CorrectedMap):
        return []
    columns = [number for number, name in enumerate(table_map.virtual) if name in names]
    return [
        name
        for number, (name, factors) in enumerate(zip(table_map.real, table_map.steepest, strict=True))
        if number not in columns and any(factors[column] > LEAST_FACTOR for column in columns)
    ]


def bound_ends(fleet: Fleet, step: Step, bounds: Mapping[str, PositionBound]) -> dict[str, PositionBound]:
    """How far the axes of the corrected groups that a step names may be from their targets at its end. bounds: of those
    of its real axes that are compensated themselves."""
    corrected_bounds: dict[str, PositionBound] = {}
    for group in group_virtual(fleet, step):
        table_map = fleet.virtual_axes.maps[group]
        if isinstance(table_map, CorrectedMap):
            corrected_bounds |= bound_corrected(table_map, list(map(fleet.axis, table_map.real)), bounds, None)
    return corrected_bounds


def bound_corrected(
    corrected: CorrectedMap, axes: Sequence[Axis], bounds: Mapping[str, PositionBound], bends: Sequence[float] | None
) -> dict[str, PositionBound]:
    """How far the axes of a corrected group may be from where they should be, by axis. axes: the real ones, in order.
    bounds: of those of them that are compensated themselves. bends: what else the tables have between the ends of a
    straight way; None: at its ends."""
    reals = [bounds.get(name) or _bound_rounding(axis) for name, axis in zip(corrected.real, axes, strict=True)]
    corrected_bounds: dict[str, PositionBound] = {}
    for number, (name, shares) in enumerate(zip(corrected.virtual, corrected.factors, strict=True)):
        rounding, table, play = (
            sum(share * getattr(real, field) for share, real in zip(shares, reals, strict=True))
            for field in ("rounding", "table", "play")
        )
        table += corrected.errors.uncertainties[number] + (0.0 if bends is None else bends[number])
        unit = axes[number].unit
        most = rounding + table + play
        corrected_bounds[name] = PositionBound(most=most, rounding=rounding, table=table, play=play, unit=unit)
    return corrected_bounds


def _bound_rounding(axis: Axis) -> PositionBound:
    rounding = ROUNDED_COUNTS / float(axis.scale)
    return PositionBound(most=rounding, rounding=rounding, table=0.0, play=0.0, unit=axis.unit)


class TableWay(NamedTuple):
    """Where the real axes of a corrected group move: a box of all of them, in which those that stand may be anywhere,
    and the numbers of those that move."""

    box: Sequence[tuple[float, float]]
    columns: Sequence[int]

    @classmethod
    def of_profiles(cls, fleet: Fleet, corrected: CorrectedMap, profiles: Mapping[str, Profile]) -> "TableWay":
        """Of a step with these profiles of real axes."""
        box, columns = list(corrected.box), list[int]()
        for number, name in enumerate(corrected.real):
            if (profile := profiles.get(name)) is not None:
                axis = fleet.axis(name)
                low, high = sorted(axis.to_unit(counts) for counts in (profile.start_counts, profile.end_counts))
                box[number] = low, high
                columns.append(number)
        return cls(box, columns)


def bound_straight(corrected: CorrectedMap, way: TableWay) -> list[float]:
    """How far each axis of a corrected group may be off a straight line because of its tables, while the real axes are
    on one: by their uncertainty, and by how they bend. The errors on the way and on a line between its ends are both
    between the smallest and the largest one there."""
    spans = corrected.errors.find_spans(way.box, way.columns)
    return list(map(float.__add__, corrected.errors.uncertainties, spans))


def bound_apart(fleet: Fleet, corrected: CorrectedMap, way: TableWay, approach: Approach | None) -> list[float]:
    """How far each axis of a corrected group may be outside the range between its begin and its end while the real axes
    move in their own time, each between its ends, to a count. approach: of the step."""
    reals = [abs(fleet.axis(name).to_length(1)) + bound_way(fleet.axis(name), approach) for name in corrected.real]
    spans = corrected.find_spans(way.box, way.columns)
    return [
        span + uncertainty + sum(factor * real for factor, real in zip(factors, reals, strict=True))
        for span, uncertainty, factors in zip(spans, corrected.errors.uncertainties, corrected.factors, strict=True)
    ]


# On a path


def turn_states(corrected: CorrectedMap, states: PathStates) -> PathStates:
    """The states of real axes for those that they would have without errors."""
    positions = corrected.turn(states.positions)
    matrix = np.array(corrected.rows)
    slopes = corrected.errors.find_slopes_at(positions)
    shares = np.linalg.solve(matrix + slopes, np.broadcast_to(matrix, slopes.shape))
    velocities, accelerations = (
        np.einsum("nij,nj->ni", shares, rows) for rows in (states.velocities, states.accelerations)
    )
    return PathStates(positions, velocities, accelerations)


def limit_axes(corrected: CorrectedMap, axes: Sequence[PathAxis]) -> list[PathAxis]:
    """The axes of a path as the planner sees them, without errors: limits of which enough is left for what the tables
    add, by their own motion and by that of the others, and soft limits that hold wherever the others are."""
    inverse = np.array(corrected.inverse_rows)
    slopes = np.abs(inverse) @ corrected.errors.steepest
    # r = p - d(r), so that r' is at most p' and what the slopes of d make of r' of all.
    factors = np.eye(len(axes)) + slopes @ np.linalg.inv(np.eye(len(axes)) - slopes)
    shares = [
        float((values / (factors @ values)).min())
        for values in (np.array([getattr(axis, name) for axis in axes]) for name in LIMITS)
    ]
    ranges = np.array(corrected.errors.find_ranges(corrected.box))
    limited_axes: list[PathAxis] = []
    for axis, row in zip(axes, inverse, strict=True):
        low, high = (
            (np.minimum if end == 0 else np.maximum)(row * ranges[:, 0], row * ranges[:, 1]).sum() for end in (0, 1)
        )
        soft = axis.soft_limits
        if soft is not None:
            soft = soft[0] + max(float(high), 0.0), soft[1] + min(float(low), 0.0)
        rates = {name: getattr(axis, name) * share for name, share in zip(LIMITS, shares, strict=True)}
        limited_axes.append(replace(axis, soft_limits=soft, **rates))
    return limited_axes
