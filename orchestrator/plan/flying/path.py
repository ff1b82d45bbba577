"""Several lines of a scan as one step of a job: a path whose motion is that of a flight."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from pydantic import PrivateAttr

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.frame import FrameSpec
from orchestrator.model.names import controller_of
from orchestrator.model.paths.pieces import LinePiece
from orchestrator.model.report import PathReport, PathStretch
from orchestrator.model.steps.fly import WindowPlace
from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.flying.flight import Flight, plan_flight
from orchestrator.plan.flying.line_room import check_curve_room
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.path_course import PathCourse
from orchestrator.plan.path_profiles import MAX_PIECES, Array, FittedMotion, make_profile
from orchestrator.plan.path_step import (
    MAX_STRETCHES,
    PathStart,
    PlannedPath,
    find_unit,
    make_fitted_axis,
    make_moves,
    require_start,
)
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import StepPlan
from orchestrator.plan.triggers import MAX_CHUNKED_INSTANTS, ResolvedTrigger

CONSTANT, CURVED, TURN = "constant speed through windows", "constant time in windows", "turn-around"
USES = (1.0, 0.8, 0.6)
"""Of the acceleration and jerk of the axes in turn-arounds: the first that leaves room to brake along the path."""

FLIGHT_MOST_S = 600.0  # a longer scan is flown in several motions of whole lines
FLIGHT_MOST_LINES = 1000
TRIGGERED_MOST_S = 60.0
"""The same for one with triggers whose controller shows what its outputs did at its end only: its rows are certain
then."""

_PLACES: dict[WindowPlace, float] = {"start": 0.0, "middle": 0.5, "end": 1.0}
RAMP_SHARE = 0.05  # of the tolerance: how far a stopping tail may be off its path


@dataclass(frozen=True, slots=True)
class FlownPart:
    """Points of a scan that are flown in one motion: from `first` on, before `end`, from 0; `end` begins a line.
    flight: through them, in user positions. shows_switching: what its output does can be read while it flies."""

    lines: FlownLines
    first: int
    end: int
    flight: Flight
    shows_switching: bool = False


class FlightPath(FollowPath):
    """The step that flies lines of a scan in one motion. It is made when its turn comes, and never sent or stored."""

    _part: FlownPart = PrivateAttr()

    @property
    def part(self) -> FlownPart:
        """What it flies."""
        return self._part

    @classmethod
    def make(cls, part: FlownPart) -> "FlightPath":
        """The step for a part of a scan."""
        ends = part.flight.motion.positions[[0, -1]].tolist()
        path = cls(
            name=part.lines.scan.name,
            axes=list(part.lines.scan.axes),
            start=ends[0],
            pieces=[LinePiece(piece="line", to=ends[1])],
            tolerance=part.lines.tolerance,
            triggers=part.lines.make_triggers(part.first),
        )
        path._part = part
        return path


class ChunkAbility(NamedTuple):
    """How a controller takes paths in chunks. most_s: the longest one; 0: none. switches: outputs with them. shows:
    what it has switched, while it moves."""

    most_s: float
    switches: bool
    shows: bool = False


def list_members(lines: FlownLines) -> list[str]:
    """The controllers of a scan's axes and of the output that is switched in its windows."""
    return list(dict.fromkeys(map(controller_of, [*lines.scan.axes, *lines.scan.trigger_outputs])))


def explain_single_lines(lines: FlownLines, fleet: Fleet, abilities: Mapping[str, ChunkAbility]) -> str:
    """Why the lines of a scan are flown one by one; empty if several are one motion. abilities: by controller, of
    those of the axes and outputs of the scan."""
    if lines.line_count < 2 and not lines.scan.is_curved:
        return "it has one line"
    if lines.scan.fly is not None and lines.scan.fly.wait is not None:
        return f"it waits for {lines.scan.fly.wait.input} before each"
    units = {fleet.axis(name).unit for name in lines.scan.axes}
    if len(units) > 1:
        return f"its axes have several units ({', '.join(sorted(units))}), and a motion along a path has one"
    for member in list_members(lines):
        if not abilities[member].most_s:
            return f"{member} loads no path in chunks"
    owners = [controller_of(output) for output in lines.scan.trigger_outputs]
    slow_owner = next((owner for owner in owners if not abilities[owner].switches), None)
    return "" if slow_owner is None else f"{slow_owner} switches no outputs on a path in chunks"


def place_triggers(part: FlownPart, triggers: Sequence[ResolvedTrigger]) -> list[ResolvedTrigger]:
    """The triggers of a flight, at their place in each of its windows."""
    share = _PLACES[part.lines.trigger_place]
    places = [line.begin_s + line.window_s * (np.arange(line.points) + share) for line in part.flight.lines]
    places_s = tuple(np.concatenate(places).tolist())
    return [replace(trigger, positions=(), places_s=places_s) for trigger in triggers]


def plan_part(lines: FlownLines, fleet: Fleet, first: int, most_s: float, *, shows_switching: bool) -> FlownPart:
    """The longest part of a scan from a point on that is flown in one motion, a line at least. most_s: the longest
    chunk that its members load. shows_switching: what its output does can be read while it flies. Raises `PlanError`
    for lines that cannot be joined so."""
    most_points = lines.scan.point_count if lines.trigger is None else MAX_CHUNKED_INSTANTS
    rest_points = lines.count - first % lines.count
    line_s = lines.count * lines.window_s + 2 * lines.run_up_s
    most_flown_s = FLIGHT_MOST_S if lines.trigger is None or shows_switching else TRIGGERED_MOST_S
    most_lines = min(FLIGHT_MOST_LINES, MAX_PIECES // (2 * lines.count)) if lines.scan.is_curved else FLIGHT_MOST_LINES
    more = min(int(most_flown_s / line_s), most_lines, (most_points - rest_points) // lines.count)
    end = min(first + rest_points + max(0, more) * lines.count, lines.scan.point_count)
    axes = [fleet.axis(name) for name in lines.scan.axes]
    starts = [
        PathStart(name, axis, Fraction(0), 0, Fraction(0), 3) for name, axis in zip(lines.scan.axes, axes, strict=True)
    ]
    for use in USES:
        flight = plan_flight(lines, fleet, (first, end), use)
        if _make_course(flight.motion, starts, lines).has_chunks(most_s):
            return FlownPart(lines, first, end, flight, shows_switching)
    stretch_words = "along it" if lines.scan.is_curved else "between two of them"
    raise PlanError(f"lines of {lines.count} points of {lines.words} are too short to be braked {stretch_words}")


def choose_part(
    lines: FlownLines, fleet: Fleet, first: int, abilities: Mapping[str, ChunkAbility]
) -> tuple[FlownPart | None, str]:
    """The lines from a point on that are flown in one motion; None, and why, where they are flown one by one.
    abilities: by controller, of `list_members`. Raises `Refusal` for a curve, which is not flown by itself."""
    reason = explain_single_lines(lines, fleet, abilities)
    if reason and lines.scan.is_curved:
        remedy = "leave out `Fly`, and it is stepped; or take axes of one unit, of makes that load paths in chunks"
        raise Refusal("fly-curve", f"the curve of {lines.words} cannot be flown: {reason}", remedy)
    if reason:
        return None, reason
    try:
        most_s = min(ability.most_s for ability in abilities.values())
        owners = [controller_of(output) for output in lines.scan.trigger_outputs]
        shows = bool(owners) and all(abilities[owner].shows for owner in owners)
        return plan_part(lines, fleet, first, most_s, shows_switching=shows), ""
    except PlanError as error:
        if lines.scan.is_curved:
            remedy = f"write a longer `duration` than {lines.window_s * 1e3:.4g} ms; or leave out `Fly`"
            raise Refusal("fly-curve", f"the curve of {lines.words} cannot be flown: {error}", remedy) from None
        return None, str(error)


def plan_flight_step(
    step: FlightPath, starts: Sequence[PathStart], frames: Mapping[str, FrameSpec] | None = None
) -> PlannedPath:
    """Plan a flight whose axes stand at its start. Raises `Refusal`."""
    unit, part = find_unit(starts), step.part
    require_start(step, starts, frames or {})
    shift = np.array([float(start.offset) for start in starts])
    motion = part.flight.motion._replace(positions=part.flight.motion.positions - shift)
    if part.lines.scan.is_curved:
        check_curve_room(motion, [(start.name, start.axis) for start in starts])
    course = _make_course(motion, starts, part.lines)
    exact = {
        start.name: (Fraction(end), axis.end_counts)
        for start, axis, end in zip(starts, course.axes, motion.positions[-1].tolist(), strict=True)
    }
    profiles = {
        course.axes[column].name: make_profile(motion, column, course.axes[column]) for column in course.columns
    }
    edges_s, speeds = _sample_windows(part, motion)
    return PlannedPath(
        plan=StepPlan(course.duration_s, profiles, [start.name for start in starts if start.name not in profiles]),
        moves=make_moves(starts, exact),
        exact=exact,
        report=PathReport(
            unit=unit,
            length=float(np.linalg.norm(np.diff(motion.positions, axis=0), axis=1).sum()),
            duration_s=course.duration_s,
            stretches=_list_stretches(part),
        ),
        tolerance=part.lines.tolerance,
        fit_error=0.5 / min(abs(axis.counts_per_unit) for axis in course.axes),
        counts_per_unit={axis.name: axis.counts_per_unit for axis in course.axes},
        times_s=edges_s,
        speeds={start.name: row for start, row in zip(starts, speeds, strict=True)},
        course=course,
    )


def _sample_windows(part: FlownPart, motion: FittedMotion) -> tuple[Array, Array]:
    """Instants of the windows, s, and the speed of each axis there, (axes, instants). Only in the windows does it
    matter what sets members apart in time, and only if axes of several move there: else all speeds are 0."""
    if len({controller_of(name) for name in part.lines.scan.flown_axes}) < 2:
        return np.array([0.0, motion.duration_s]), np.zeros((motion.positions.shape[1], 2))
    places = [line.begin_s + line.window_s * np.arange(2 * line.points + 1) / 2 for line in part.flight.lines]
    edges_s = np.concatenate(places)
    return edges_s, np.abs(motion.evaluate(edges_s)[1]).T


def _make_course(motion: FittedMotion, starts: Sequence[PathStart], lines: FlownLines) -> PathCourse:
    """The course of a flight in motor positions."""
    axes = [
        make_fitted_axis(start, start.axis.to_target_counts(Fraction(end)))
        for start, end in zip(starts, motion.positions[-1].tolist(), strict=True)
    ]
    columns = [column for column in range(len(axes)) if np.ptp(motion.positions[:, column]) > 0.0]
    return PathCourse(motion, axes, columns, motion.positions[0], lines.tolerance * RAMP_SHARE)


def _list_stretches(part: FlownPart) -> list[PathStretch]:
    """The lines of a flight, and the turn-arounds between them; of a long one only itself."""
    lines, last = part.flight.lines, part.flight.duration_s
    binds = CURVED if part.lines.scan.is_curved else CONSTANT
    if 2 * len(lines) + 1 > MAX_STRETCHES:
        return [PathStretch(from_s=0.0, to_s=last, binds=f"{binds}, and {TURN}s")]
    stretches, at_s = list[PathStretch](), 0.0
    for line in lines:
        between_words = TURN if stretches else "run-up"
        stretches.append(PathStretch(from_s=at_s, to_s=line.begin_s, binds=between_words))
        stretches.append(PathStretch(from_s=line.begin_s, to_s=line.end_s, binds=binds))
        at_s = line.end_s
    return [*stretches, PathStretch(from_s=at_s, to_s=last, binds="run-down")]
