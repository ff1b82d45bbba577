"""A plot of planned and sampled positions: of one step, or of all moves of a job."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orchestrator.model.report import AxisRecording, StepRecording

MARGIN_SHARE = 0.3  # of one move's duration, shown before and after it
JOB_MARGIN_SHARE = 0.03  # of a job's duration
PLAN_POINTS = 1000
WIDTH, HEIGHT, DPI = 9.0, 2.6, 120
COLOUR_PLAN, COLOUR_SEEN = "#7a8ca5", "#c2410c"


def plot_recordings(recordings: Sequence[StepRecording], title: str, path: Path | None = None) -> Figure:
    """Plot all axes of one or more moves: planned and polled positions on the left, their difference on the right.

    recordings: at least one. path: also write the plot there. The difference contains the following error, and the
    motion within one poll: a poll does not report the instant at which the controller sampled the position.
    """
    mpl.rcParams["font.size"] = 9
    names = list(dict.fromkeys(chain.from_iterable(each.axes for each in recordings)))
    first_ns = recordings[0].t0_fleet_ns
    figure = Figure(figsize=(WIDTH, 0.7 + HEIGHT * len(names)), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    rows = figure.subplots(len(names), 2, squeeze=False, sharex=True, width_ratios=(3, 2))
    for name, (above, difference) in zip(names, rows, strict=True):
        unit = next(each.axes[name].unit for each in recordings if name in each.axes)
        rest: tuple[float, float] | None = None
        difference.axhline(0, color=COLOUR_PLAN, linewidth=1)
        for number, recording in enumerate(each for each in recordings if name in each.axes):
            axis, offset_s = recording.axes[name], (recording.t0_fleet_ns - first_ns) * 1e-9
            planned_s, planned = _planned_curve(axis, offset_s)
            seen_s, seen, off = _polled_points(recording, axis, offset_s)
            if rest:  # between two moves
                above.plot([rest[0], planned_s[0]], [rest[1], planned[0]], color=COLOUR_PLAN, linewidth=1, zorder=1)
            rest = planned_s[-1], planned[-1]
            labels = ("planned", "polled") if number == 0 else (None, None)
            above.plot(planned_s, planned, color=COLOUR_PLAN, linewidth=2.5, label=labels[0], zorder=1)
            above.plot(seen_s, seen, ".", color=COLOUR_SEEN, markersize=5, label=labels[1], zorder=2)
            difference.plot(seen_s, off, ".-", color=COLOUR_SEEN, markersize=4, linewidth=0.8)
        above.set_ylabel(f"{name}, {unit}")
        difference.set_ylabel(f"polled - planned, {unit}")
        for each in (above, difference):
            each.grid(alpha=0.3)
    # Above the plot: inside, there is no place that every move leaves free.
    rows[0][0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    # A long arming phase would leave no room for the move.
    end_s = max((each.t0_fleet_ns - first_ns) * 1e-9 + _longest_s(each) for each in recordings)
    margin_s = MARGIN_SHARE * end_s if len(recordings) == 1 else JOB_MARGIN_SHARE * end_s
    for column in rows[-1]:
        column.set_xlabel("s after T0" if len(recordings) == 1 else "s after the first T0")
        column.set_xlim(-margin_s, end_s + margin_s)
    if path is not None:
        figure.savefig(path)
    return figure


def _longest_s(recording: StepRecording) -> float:
    return max(axis.profile.duration_s for axis in recording.axes.values())


def _planned_curve(axis: AxisRecording, offset_s: float) -> tuple[list[float], list[float]]:
    """Return the plan in the axis's unit (motor position), over its whole time."""
    at, end_s = axis.profile.make_evaluator(), axis.profile.duration_s
    times = [end_s * k / PLAN_POINTS for k in range(PLAN_POINTS + 1)]
    positions = [(axis.profile.start_counts + at(t).position) / axis.counts_per_unit for t in times]
    return [offset_s + t for t in times], positions


def _polled_points(
    recording: StepRecording, axis: AxisRecording, offset_s: float
) -> tuple[list[float], list[float], list[float]]:
    """Return instants (s after the first T0), positions, and distances to the plan, in the axis's unit."""
    at, start = axis.profile.make_evaluator(), axis.profile.start_counts
    times = [(at_ns - recording.t0_fleet_ns) * 1e-9 for at_ns, _ in axis.sampled]
    seen = [counts / axis.counts_per_unit for _, counts in axis.sampled]
    plan = [(start + at(t).position) / axis.counts_per_unit for t in times]
    return [offset_s + t for t in times], seen, [each - meant for each, meant in zip(seen, plan, strict=True)]
