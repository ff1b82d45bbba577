"""Several lines of a scan as one step of a job: a path whose motion is that of a flight."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from pydantic import PrivateAttr

from orchestrator.model.fleet import Fleet
from orchestrator.model.frame import FrameSpec
from orchestrator.model.names import controller_of
from orchestrator.model.paths.pieces import LinePiece
from orchestrator.model.report import PathReport, PathStretch
from orchestrator.model.steps.fly import WindowPlace
from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.flying.flight import Flight, plan_flight
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.path_course import PathCourse
from orchestrator.plan.path_profiles import FittedMotion, make_profile
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

CONSTANT, TURN = "constant speed through windows", "turn-around"
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
    if lines.line_count < 2:
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
    more = min(int(most_flown_s / line_s), FLIGHT_MOST_LINES, (most_points - rest_points) // lines.count)
    end = min(first + rest_points + max(0, more) * lines.count, lines.scan.point_count)
    axes = [fleet.axis(name) for name in lines.scan.axes]
    starts = [
        PathStart(name, axis, Fraction(0), 0, Fraction(0), 3) for name, axis in zip(lines.scan.axes, axes, strict=True)
    ]
    for use in USES:
        flight = plan_flight(lines, fleet, (first, end), use)
        if _make_course(flight.motion, starts, lines).has_chunks(most_s):
            return FlownPart(lines, first, end, flight, shows_switching)
    raise PlanError(f"lines of {lines.count} points of {lines.axis} are too short to be braked between two of them")


def choose_part(
    lines: FlownLines, fleet: Fleet, first: int, abilities: Mapping[str, ChunkAbility]
) -> tuple[FlownPart | None, str]:
    """The lines from a point on that are flown in one motion; None, and why, where they are flown one by one.
    abilities: by controller, of `list_members`."""
    reason = explain_single_lines(lines, fleet, abilities)
    if reason:
        return None, reason
    try:
        most_s = min(ability.most_s for ability in abilities.values())
        owners = [controller_of(output) for output in lines.scan.trigger_outputs]
        shows = bool(owners) and all(abilities[owner].shows for owner in owners)
        return plan_part(lines, fleet, first, most_s, shows_switching=shows), ""
    except PlanError as error:
        return None, str(error)


def plan_flight_step(
    step: FlightPath, starts: Sequence[PathStart], frames: Mapping[str, FrameSpec] | None = None
) -> PlannedPath:
    """Plan a flight whose axes stand at its start. Raises `Refusal`."""
    unit, part = find_unit(starts), step.part
    require_start(step, starts, frames or {})
    shift = np.array([float(start.offset) for start in starts])
    motion = part.flight.motion._replace(positions=part.flight.motion.positions - shift)
    course = _make_course(motion, starts, part.lines)
    exact = {
        start.name: (Fraction(end), axis.end_counts)
        for start, axis, end in zip(starts, course.axes, motion.positions[-1].tolist(), strict=True)
    }
    profiles = {
        course.axes[column].name: make_profile(motion, column, course.axes[column]) for column in course.columns
    }
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
        # In the windows one axis moves: what sets members apart in time takes none off its line.
        times_s=np.array([0.0, course.duration_s]),
        speeds={start.name: np.zeros(2) for start in starts},
        course=course,
    )


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
    if 2 * len(lines) + 1 > MAX_STRETCHES:
        return [PathStretch(from_s=0.0, to_s=last, binds=f"{CONSTANT}, and {TURN}s")]
    stretches, at_s = list[PathStretch](), 0.0
    for line in lines:
        between_words = TURN if stretches else "run-up"
        stretches.append(PathStretch(from_s=at_s, to_s=line.begin_s, binds=between_words))
        stretches.append(PathStretch(from_s=line.begin_s, to_s=line.end_s, binds=CONSTANT))
        at_s = line.end_s
    return [*stretches, PathStretch(from_s=at_s, to_s=last, binds="run-down")]
