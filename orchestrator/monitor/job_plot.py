"""A plot of planned and polled positions, with starts and ends: of one step, or of all moves of a job."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.names import split_name
from orchestrator.model.report import AxisRecording, StepRecording, StepReport
from orchestrator.model.steps.numbers import number_step

MARGIN_SHARE = 0.3  # of one move's duration, shown before and after it
JOB_MARGIN_SHARE = 0.03  # of a job's duration
PLAN_POINTS, MIN_PLAN_POINTS = 3000, 60  # of all moves of an axis together, and of each
WIDTH, DPI = 9.0, 120
TIMING_WIDTH = 3.0  # of the column of starts and ends
ROW, LOW_ROW, MANY_AXES = 2.6, 1.7, 4  # heights of the rows of few axes, and of more
FEW_STEPS = 3
MAX_NUMBERED = 24  # steps that are marked, with their number above the plot
COLOUR_PLAN, COLOUR_SEEN = "#7a8ca5", "#c2410c"
COLOURS_TIMING = {"start": "#1d4ed8", "end": "#15803d"}


class TimingInterval(NamedTuple):
    """A start after T0, or an end after the planned one, by evidence. at_s: when, after the first T0."""

    at_s: float
    earliest_ms: float
    latest_ms: float


def plot_recordings(
    recordings: Sequence[StepRecording], title: str, path: Path | None = None, steps: Sequence[StepReport] = ()
) -> Figure:
    """Plot all axes of one or more moves: planned and polled positions on the left, then their difference, and with
    the reports of the steps how far starts and ends were off the plan, as intervals.

    recordings: at least one. path: also write the plot there. The difference contains the following error, and the
    motion within one poll: a poll does not report the instant at which the controller sampled the position.
    """
    mpl.rcParams["font.size"] = 9
    names = list(dict.fromkeys(chain.from_iterable(recording.axes for recording in recordings)))
    timings = {name: list(_find_timings(name, recordings, steps)) for name in names}
    has_timings = any(timings.values())
    height = ROW if len(names) < MANY_AXES else LOW_ROW
    size = (WIDTH + TIMING_WIDTH * has_timings, 0.9 + height * len(names))
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    columns = (3, 2, 2)[: 2 + has_timings]
    grid = figure.subplots(len(names), len(columns), squeeze=False, sharex=True, width_ratios=columns)
    rows: list[list[Axes]] = [list(row) for row in grid]
    for name, row in zip(names, rows, strict=True):
        own_recordings = [recording for recording in recordings if name in recording.axes]
        _draw_positions(row[0], row[1], name, own_recordings, recordings[0].t0_fleet_ns)
        if has_timings:
            _draw_timings(row[2], timings[name])
        for axes in row:
            axes.grid(alpha=0.3)
    if has_timings:
        _align_timings([row[2] for row in rows])
    _finish_plot(rows, recordings)
    figure.align_ylabels()
    if path is not None:
        figure.savefig(path)
    return figure


def _draw_positions(
    above: Axes, difference: Axes, name: str, recordings: Sequence[StepRecording], first_ns: int
) -> None:
    unit = recordings[0].axes[name].unit
    points = max(MIN_PLAN_POINTS, PLAN_POINTS // (2 + len(recordings)))
    rest_point: tuple[float, float] | None = None
    difference.axhline(0, color=COLOUR_PLAN, linewidth=1)
    # Dots that touch would hide the plan.
    size = 5 if len(recordings) <= FEW_STEPS else 2.5 if len(recordings) <= MAX_NUMBERED else 1.8
    for number, recording in enumerate(recordings):
        axis, offset_s = recording.axes[name], (recording.t0_fleet_ns - first_ns) / NS_PER_S
        planned_s, plan = _planned_curve(axis, offset_s, points)
        seen_s, sampled_positions, off = _polled_points(recording, axis, offset_s)
        if rest_point:  # between two moves
            above.plot(
                [rest_point[0], planned_s[0]], [rest_point[1], plan[0]], color=COLOUR_PLAN, linewidth=1, zorder=1
            )
        rest_point = planned_s[-1], plan[-1]
        labels = ("planned", "polled") if number == 0 else (None, None)
        above.plot(planned_s, plan, color=COLOUR_PLAN, linewidth=size / 2, label=labels[0], zorder=1)
        above.plot(seen_s, sampled_positions, ".", color=COLOUR_SEEN, markersize=size, label=labels[1], zorder=2)
        difference.plot(seen_s, off, ".-", color=COLOUR_SEEN, markersize=size - 1, linewidth=size / 6)
    above.set_ylabel(f"{name}, {unit}")
    difference.set_ylabel(f"off plan, {unit}")


def _draw_timings(axes: Axes, timings: Sequence[tuple[Literal["start", "end"], TimingInterval]]) -> None:
    axes.axhline(0, color=COLOUR_PLAN, linewidth=1)
    for kind, colour in COLOURS_TIMING.items():
        intervals = [interval for its_kind, interval in timings if its_kind == kind]
        if not intervals:
            continue
        middles = [(interval.earliest_ms + interval.latest_ms) / 2 for interval in intervals]
        halves = [(interval.latest_ms - interval.earliest_ms) / 2 for interval in intervals]
        times = [interval.at_s for interval in intervals]
        axes.errorbar(times, middles, yerr=halves, fmt="none", ecolor=colour, elinewidth=1.2, capsize=2.5, label=kind)
    axes.set_ylabel("off plan, ms")


def _align_timings(column: Sequence[Axes]) -> None:
    """One scale for all, so that controllers can be compared."""
    limits = [axes.get_ylim() for axes in column if axes.containers]
    for axes in column:
        axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))


def _finish_plot(rows: Sequence[Sequence[Axes]], recordings: Sequence[StepRecording]) -> None:
    """Titles, legends, numbers of the steps, and the times that are shown."""
    first_ns, is_single = recordings[0].t0_fleet_ns, len(recordings) == 1
    # Above the plot: inside, there is no place that every move leaves free.
    for column in (0, 2)[: len(rows[0]) - 1]:
        rows[0][column].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, borderaxespad=1.2)
    for column, words in zip(rows[0], ("", "polled - planned", "starts, ends"), strict=False):
        column.set_title(words, loc="left", fontsize=9)
    begins_s = [(recording.t0_fleet_ns - first_ns) / NS_PER_S for recording in recordings]
    if 1 < len(recordings) <= MAX_NUMBERED:
        for begin_s, recording in zip(begins_s, recordings, strict=True):
            for row in rows:
                row[0].axvline(begin_s, color=COLOUR_PLAN, linewidth=0.5, alpha=0.5, zorder=0)
            top = rows[0][0].get_xaxis_transform()
            rows[0][0].text(begin_s, 1.01, str(number_step(recording.step)), transform=top, fontsize=7)
    # A long arming phase would leave no room for the move.
    end_s = max(begin_s + _longest_s(recording) for begin_s, recording in zip(begins_s, recordings, strict=True))
    margin_s = (MARGIN_SHARE if is_single else JOB_MARGIN_SHARE) * end_s
    for column in rows[-1]:
        column.set_xlabel("s after T0" if is_single else "s after the first T0")
        column.set_xlim(-margin_s, end_s + margin_s)


def _find_timings(
    name: str, recordings: Sequence[StepRecording], steps: Sequence[StepReport]
) -> Iterator[tuple[Literal["start", "end"], TimingInterval]]:
    """Starts and ends of an axis by the evidence in the reports."""
    controller, axis = split_name(name)
    first_ns = recordings[0].t0_fleet_ns
    axis_by_step = {recording.step: recording.axes[name] for recording in recordings if name in recording.axes}
    for step in steps:
        member = step.members.get(controller)
        evidence = None if member is None else member.evidence.get(axis)
        if evidence is None or step.t0_fleet_ns is None or step.index not in axis_by_step:
            continue
        start, end, t0_ns = evidence.start_for_verdict, evidence.end, step.t0_fleet_ns
        yield "start", _off_plan(start.earliest_ns, start.latest_ns, t0_ns, first_ns)
        if end is not None and step.state == "done":
            planned_ns = t0_ns + round(axis_by_step[step.index].profile.duration_s * NS_PER_S)
            yield "end", _off_plan(end.earliest_ns, end.latest_ns, planned_ns, first_ns)


def _off_plan(earliest_ns: int, latest_ns: int, planned_ns: int, first_ns: int) -> TimingInterval:
    at_s = (planned_ns - first_ns) / NS_PER_S
    return TimingInterval(at_s, (earliest_ns - planned_ns) / NS_PER_MS, (latest_ns - planned_ns) / NS_PER_MS)


def _longest_s(recording: StepRecording) -> float:
    return max(axis.profile.duration_s for axis in recording.axes.values())


def _planned_curve(axis: AxisRecording, offset_s: float, points: int) -> tuple[list[float], list[float]]:
    """Return the plan in the axis's unit (motor position), over its whole time."""
    at, end_s = axis.profile.make_evaluator(), axis.profile.duration_s
    times = [end_s * k / points for k in range(points + 1)]
    positions = [(axis.profile.start_counts + at(t).position) / axis.counts_per_unit for t in times]
    return [offset_s + t for t in times], positions


def _polled_points(
    recording: StepRecording, axis: AxisRecording, offset_s: float
) -> tuple[list[float], list[float], list[float]]:
    """Return instants (s after the first T0), positions, and distances to the plan, in the axis's unit."""
    at, start = axis.profile.make_evaluator(), axis.profile.start_counts
    times = [(at_ns - recording.t0_fleet_ns) * 1e-9 for at_ns, _ in axis.sampled]
    positions = [counts / axis.counts_per_unit for _, counts in axis.sampled]
    plan = [(start + at(t).position) / axis.counts_per_unit for t in times]
    return (
        [offset_s + t for t in times],
        positions,
        [position - target for position, target in zip(positions, plan, strict=True)],
    )
