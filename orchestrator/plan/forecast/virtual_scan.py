"""The forecast of a scan that positions virtual axes, without the steps at its points.

Its real axes are at their extremes where the virtual ones are at some of theirs, because their maps are linear, or
where their tables of errors have extremes: so a scan of `axes` is run to each of these, a table to its points, and
limits hold at all others. Times follow from the distances between neighbouring points.
"""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import product

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.linear_map import CorrectedMap, LinearMap
from orchestrator.model.steps.scan import Scan
from orchestrator.model.units import Unit, UnitError, parse_quantity
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.motion import plan_ways
from orchestrator.plan.forecast.move import forecast_move
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.forecast.zones import check_area, find_area, join_known
from orchestrator.plan.scan_ways import ScanCorner, ScanWays, Way, find_corners, iterate_ways
from orchestrator.plan.targets import make_axis_move
from orchestrator.plan.virtual_moves import find_virtual_names, group_virtual

MOST_ROWS = 1000
"""Points of a table that are looked at one by one; of a longer one its extremes are."""


def forecast_virtual_scan(state: ForecastState, at: ForecastContext, step: Scan) -> Span:
    """Run a scan of virtual axes forward, with those of its axes that are real."""
    if step.fly is not None:
        text = f"{find_virtual_names(state.fleet, step)[0]} is virtual, and only real axes fly through points"
        state.add_problem(at, ("fly",), Refusal("bad-step", text, "leave out `fly`, and it stops at each point"))
        return Span()
    names = step.axis_names
    if any(state.fleet.names.explain_unknown(name, "target") for name in names):
        state.find_named(at, names, "axes")
        return Span()
    if unknown := state.note_unknown_positions(step):
        state.lose_positions(at, state.fleet.find_real_axes(unknown))
        return Span(0.0, None)
    units = [state.fleet.unit_of(name) for name in names]
    try:
        corners, kinds = find_corners(step, units), list(iterate_ways(step, units))
        points = list(_list_points(state.fleet, step, corners, units))
    except UnitError as error:
        state.add_problem(at, (), Refusal("bad-unit", str(error), "correct the unit"))
        return Span()
    problems, first_span, area = len(state.problems), Span(), find_area(state, step.find_axes(state.fleet))
    for number, (point, words) in enumerate(points):
        with state.without_zones():
            span = forecast_move(state, at.at_time(words + at.when), step.make_move(point))
        area |= {name: join_known(area[name], reach) for name, reach in find_area(state, area).items()}
        first_span = span if number == 0 else first_span
        if len(state.problems) > problems:
            return Span()
    state.motion = None
    has_curve = any(
        not isinstance(state.fleet.virtual_axes.maps[group], LinearMap) for group in group_virtual(state.fleet, step)
    )
    check_area(state, dict.fromkeys(area) if has_curve else area, "ways between points")
    between_span = Span()
    for kind in kinds:
        between_span = between_span.followed_by(_plan_kind(state, at, step, kind), kind.often)
    return first_span.followed_by(between_span)


def _list_points(
    fleet: Fleet, step: Scan, corners: Mapping[str, Sequence[ScanCorner]], units: Sequence[Unit]
) -> Iterator[tuple[Mapping[str, float], str]]:
    """The points to look at, the first and the last one of the scan at their ends, each with its words."""
    names, table = step.axis_names, step.points
    first, last = ({name: float(corners[name][end].position) for name in names} for end in (0, -1))
    yield first, _describe(first)
    if table is not None and table.rows is not None and len(table.rows) <= MOST_ROWS:
        for row in table.rows:
            values = (parse_quantity(text, unit) for text, unit in zip(row, units, strict=True))
            point = dict(zip(names, map(float, values), strict=True))
            yield point, _describe(point)
    else:
        positions = {name: sorted({float(corner.position) for corner in corners[name]}) for name in names}
        ends = {name: (values[0], values[-1]) for name, values in positions.items()}
        for values in product(*(sorted({*ends[name], *_find_extremes(fleet, step, name, ends)}) for name in names)):
            point = dict(zip(names, values, strict=True))
            yield point, _describe(point)
    yield last, _describe(last)


def _find_extremes(fleet: Fleet, step: Scan, name: str, ends: Mapping[str, tuple[float, float]]) -> Iterator[float]:
    """Where between its ends the tables of a corrected group have extremes along an axis. ends: of all axes of a
    scan."""
    for group in group_virtual(fleet, step):
        virtual_map = fleet.virtual_axes.maps[group]
        if isinstance(virtual_map, CorrectedMap) and name in virtual_map.virtual:
            pairs = zip(virtual_map.virtual, virtual_map.box, strict=True)
            yield from virtual_map.errors.list_extremes(
                virtual_map.virtual.index(name), [ends.get(axis, span) for axis, span in pairs]
            )


def _describe(point: Mapping[str, float]) -> str:
    return f", at {', '.join(f'{axis} {value:g}' for axis, value in point.items())}"


def _plan_kind(state: ForecastState, at: ForecastContext, step: Scan, kind: ScanWays) -> Span:
    """The duration of one kind of way between points; without a bound where a map is curved."""
    ways = MoveWays()
    for ends, moves in ((kind.nearest, ways.nearest), (kind.farthest, ways.farthest)):
        distances = _find_real_distances(state, step, ends)
        if distances is None:
            return Span(0.0, None)
        for name, distance in distances.items():
            axis = state.fleet.axis(name)
            counts = round(distance * axis.counts_per_unit)
            if counts:
                moves.append(make_axis_move(name, axis, 0, counts, state.order_of(name, axis)))
    return plan_ways(state, at, step.model_copy(update={"sync": "phase"}), ways)


def _find_real_distances(state: ForecastState, step: Scan, ends: Mapping[str, Way]) -> dict[str, Fraction] | None:
    """How far the real axes go on one way; None where that depends on where they are."""
    fleet = state.fleet
    distances = {name: end - begin for name, (begin, end) in ends.items() if name not in fleet.names.virtual}
    for group in group_virtual(fleet, step):
        virtual_map = fleet.virtual_axes.maps[group]
        if not isinstance(virtual_map, LinearMap) or isinstance(virtual_map, CorrectedMap):
            return None
        steps = [ends[name][1] - ends[name][0] if name in ends else Fraction(0) for name in virtual_map.virtual]
        for name, row in zip(virtual_map.real, virtual_map.inverse, strict=True):
            distances[name] = sum((factor * part for factor, part in zip(row, steps, strict=True)), Fraction(0))
    return distances
