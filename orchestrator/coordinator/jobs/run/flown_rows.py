"""The rows of a line that was flown: when its axes were in the window of each point, by plan and evidence.

In its windows an axis has one speed, and its run-up and run-down are alike: so its plan is at the middle of the line
in the middle of its time. Its controller's clock runs evenly between start and end, both of which are known as
intervals: so an instant of the plan is between the intervals in the proportion of its time. A profile that is off
its path by a distance is off in time by that divided by the speed. An instant of several axes is in the intervals of
all of them.
"""

from collections.abc import Callable, Sequence
from math import ceil, floor

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.names import controller_of
from orchestrator.model.report import PathReport, PointRecord, PointWindow, StepReport
from orchestrator.model.state import AxisEvidence, TimeInterval
from orchestrator.model.steps.order import StepPlace
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.straight import StraightLines

ROUNDING = 1e9  # parts of a unit to which positions are rounded, outwards: rows are many
OTHER_TIME = 0.005  # of a line: it was held, went at another rate, or its plan was made slower
_ERRORS = ("profile-fit", "execution", "clock")


def make_line_rows(place: StepPlace, report: StepReport, lines: FlownLines, begin: int) -> list[PointRecord]:
    """A row for each point of a line, in the order in which they were flown; for the first one alone if the line was
    not begun. report: of its path, or of the move to its beginning, if that was not done. begin: the first point
    without a row: those before it have theirs, from a flight that was interrupted."""
    first = place.point
    assert first is not None
    windows = _find_windows(report, lines, first)
    is_good = report.state == "done" and report.verdict != "red" and bool(windows)
    rows: list[PointRecord] = []
    count = lines.count if place.is_flown_path and report.t0_fleet_ns is not None else begin - first + 1
    for number in range(begin - first, count):
        target = lines.find_target(first + number)
        rows.append(
            PointRecord(
                step=place.first,
                point=first + number + 1,
                state=report.state,
                verdict=report.verdict if report.state == "done" else "none",
                t0_fleet_ns=report.t0_fleet_ns,
                took_s=lines.window_s if windows else None,
                target=target,
                measured=dict.fromkeys(target),
                window=windows[number] if windows else None,
                good=is_good,
            )
        )
    return rows


def _find_windows(report: StepReport, lines: FlownLines, first: int) -> list[PointWindow]:
    """The window of each point of the line of point `first`, from 0; none of a line that was not flown as planned, or
    whose evidence is not complete."""
    path = report.path
    is_broken = report.state != "done" or bool(report.feed_holds)
    if is_broken or path is None or path.stops or not isinstance(lines, StraightLines):
        return []
    planned_s = min((lines.line_s, lines.line_s - lines.ramp_s), key=lambda line_s: abs(line_s - path.duration_s))
    if abs(path.duration_s / planned_s - 1) > OTHER_TIME:
        return []
    window_s = lines.window_s * path.duration_s / planned_s
    error_s = find_error(path, lines) * window_s / lines.length
    finders = [_find_instants(report, axis.name, path.duration_s, error_s) for axis in lines.axes]
    complete_finders = [finder for finder in finders if finder is not None]
    if len(complete_finders) < len(finders):
        return []

    def find_instant(at_s: float) -> TimeInterval:
        return join_intervals([finder(at_s) for finder in complete_finders])

    first_s = path.duration_s / 2 - lines.count * window_s / 2
    # Axes that do not fly stand at their targets, with units of their own.
    find_positions = make_position_finder(lines, first, lines.count, None)
    windows: list[PointWindow] = []
    for number in range(lines.count):
        middle = find_instant(first_s + (number + 0.5) * window_s)
        windows.append(
            PointWindow(
                lower=find_instant(first_s + number * window_s),
                middle=middle,
                upper=find_instant(first_s + (number + 1) * window_s),
                positions=find_positions(number, middle),
            )
        )
    return windows


def make_position_finder(
    lines: FlownLines, first: int, count: int, error: float | None
) -> Callable[[int, TimeInterval], dict[str, tuple[float, float]]]:
    """A function that tells between which positions axes were at the centre of the interval in which they passed a
    point: one of the `count` of a line from `first` on, by its number among these. error: how far axes that do not fly
    may be off their places, in their unit; None: they are left out."""
    speeds, flown_axes = lines.list_top_speeds(first, count).tolist(), lines.scan.flown_axes

    def find_positions(number: int, middle: TimeInterval) -> dict[str, tuple[float, float]]:
        half_s = (middle.latest_ns - middle.earliest_ns) / 2 / NS_PER_S
        widths = {axis: speed * half_s for axis, speed in zip(flown_axes, speeds[number], strict=True)}
        return {
            axis: (floor((target - width) * ROUNDING) / ROUNDING, ceil((target + width) * ROUNDING) / ROUNDING)
            for axis, target in lines.find_target(first + number).items()
            if (width := widths.get(axis, error)) is not None
        }

    return find_positions


def join_intervals(intervals: Sequence[TimeInterval]) -> TimeInterval:
    """The interval with all of them: when each of several axes was at its place."""
    return TimeInterval(
        earliest_ns=min(interval.earliest_ns for interval in intervals),
        latest_ns=max(interval.latest_ns for interval in intervals),
    )


def _find_instants(report: StepReport, axis: str, duration_s: float, error_s: float) -> "_InstantFinder | None":
    """When an axis was where its plan has it; None without its evidence, or if it took another time. duration_s: of the
    plan."""
    name, member = axis.partition(".")[2], report.members.get(controller_of(axis))
    evidence = None if member is None else member.evidence.get(name)
    if member is None or evidence is None or evidence.end is None:
        return None
    # A controller may stay at rest until its period is over, and calls that the end.
    executed_s = member.lowered_s.get(name, duration_s)
    if not _fits(evidence, executed_s):
        return None
    return _InstantFinder(evidence.start_for_verdict, evidence.end, executed_s, error_s)


def _fits(evidence: AxisEvidence, duration_s: float) -> bool:
    """Whether a line took its time, as far as its start and end are known."""
    start, end = evidence.start_for_verdict, evidence.end
    assert end is not None
    least_s = (end.earliest_ns - start.latest_ns) / NS_PER_S
    most_s = (end.latest_ns - start.earliest_ns) / NS_PER_S
    return least_s <= duration_s * (1 + OTHER_TIME) and most_s >= duration_s * (1 - OTHER_TIME)


def find_error(path: PathReport, lines: FlownLines) -> float:
    """How far the axes may be off their plan, besides their start, in their unit; with a count of rounding."""
    terms = [] if path.bound is None else path.bound.terms
    return sum(term.size for term in terms if term.name in _ERRORS) + lines.coarsest


class _InstantFinder:
    """Finds instants of the plan, s from its start, between intervals of its start and its end."""

    def __init__(self, start: TimeInterval, end: TimeInterval, duration_s: float, error_s: float) -> None:
        self._start = start
        self._end = end
        self._duration_s = duration_s
        self._error_ns = error_s * NS_PER_S

    def __call__(self, at_s: float) -> TimeInterval:
        part, start, end = at_s / self._duration_s, self._start, self._end
        earliest_ns = start.earliest_ns + (end.earliest_ns - start.earliest_ns) * part - self._error_ns
        latest_ns = start.latest_ns + (end.latest_ns - start.latest_ns) * part + self._error_ns
        return TimeInterval(earliest_ns=floor(earliest_ns), latest_ns=ceil(latest_ns))
