"""A plot of a step's planned and sampled positions."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orchestrator.model.report import AxisRecording, StepRecording

MARGIN_SHARE = 0.3  # of the move's duration, shown before and after it
PLAN_POINTS = 1000
WIDTH, HEIGHT, DPI = 9.0, 2.6, 120
COLOUR_PLAN, COLOUR_SEEN = "#7a8ca5", "#c2410c"


def plot_step(recording: StepRecording, title: str, path: Path) -> None:
    """Write a plot of all axes of a step: planned and polled positions above, their difference below.

    The difference contains the following error, and the motion within one poll's round trip: a poll does not report
    the instant at which the controller sampled the position.
    """
    mpl.rcParams["font.size"] = 9
    axes = list(recording.axes.items())
    figure = Figure(figsize=(WIDTH, 0.7 + HEIGHT * len(axes)), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    rows = figure.subplots(len(axes), 2, squeeze=False, sharex=True, width_ratios=(3, 2))
    for (name, axis), (above, difference) in zip(axes, rows, strict=True):
        planned_s, planned = _planned_curve(axis)
        seen_s, seen, off = _polled_points(recording, axis)
        above.plot(planned_s, planned, color=COLOUR_PLAN, linewidth=2.5, label="planned", zorder=1)
        above.plot(seen_s, seen, ".", color=COLOUR_SEEN, markersize=5, label="polled", zorder=2)
        above.set_ylabel(f"{name}, {axis.unit}")
        above.grid(alpha=0.3)
        difference.axhline(0, color=COLOUR_PLAN, linewidth=1)
        difference.plot(seen_s, off, ".-", color=COLOUR_SEEN, markersize=4, linewidth=0.8)
        difference.set_ylabel(f"polled - planned, {axis.unit}")
        difference.grid(alpha=0.3)
    rows[0][0].legend(loc="best", frameon=False)
    longest_s = max(axis.profile.duration_s for axis in recording.axes.values())
    for column in rows[-1]:
        column.set_xlabel("s after T0")
        # A long arming phase would leave no room for the move.
        column.set_xlim(-MARGIN_SHARE * longest_s, (1 + MARGIN_SHARE) * longest_s)
    figure.savefig(path)


def _planned_curve(axis: AxisRecording) -> tuple[list[float], list[float]]:
    """Return the plan in the axis's unit (motor position), over its whole time."""
    at, end_s = axis.profile.make_evaluator(), axis.profile.duration_s
    times = [end_s * k / PLAN_POINTS for k in range(PLAN_POINTS + 1)]
    return times, [(axis.profile.start_counts + at(t).position) / axis.counts_per_unit for t in times]


def _polled_points(recording: StepRecording, axis: AxisRecording) -> tuple[list[float], list[float], list[float]]:
    """Return instants (s after T0), positions, and distances to the plan, in the axis's unit."""
    at, start = axis.profile.make_evaluator(), axis.profile.start_counts
    times = [(at_ns - recording.t0_fleet_ns) * 1e-9 for at_ns, _ in axis.sampled]
    seen = [counts / axis.counts_per_unit for _, counts in axis.sampled]
    plan = [(start + at(t).position) / axis.counts_per_unit for t in times]
    return times, seen, [each - meant for each, meant in zip(seen, plan, strict=True)]
