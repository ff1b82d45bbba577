"""The recorded points of a scan as a picture of planned and measured positions."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal
from orchestrator.model.report import PointRecord
from orchestrator.model.steps.points import MAX_SCAN_AXES
from orchestrator.monitor.job_plot import COLOUR_PLAN, COLOUR_SEEN, COLOURS_TIMING, DPI

WIDTH, HEIGHT = 9.0, 4.6
MAX_JOINED = 300  # points with lines between their differences
MAX_MARKED = 2000  # points with a circle for each planned position


def plot_points(records: Sequence[PointRecord], title: str, path: Path | None = None) -> Figure:
    """Plot planned and measured points: of the first two axes of a scan against each other, of a single axis over the
    points; and on the right the differences of all axes, and the start skew of each point as an interval.

    records: of one scan or live job, at least one. path: also write the plot there. Raises `Refusal`, code
    `no-recording`, for points without positions.
    """
    mpl.rcParams["font.size"] = 9
    records, axes = _find_placed(records)
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    skews = [(float(record.point), record.start_skew) for record in records if record.start_skew is not None]
    parts = [*axes, "start skew"] if skews else axes
    axes_left, *differences = figure.subplot_mosaic([["map", part] for part in parts], width_ratios=(3, 2)).values()
    planned_targets = _make_columns([record.target for record in records], axes)
    positions = _make_columns([record.measured for record in records], axes)
    numbers = [float(record.point) for record in records]
    across, up = (axes[0], axes[1]) if len(axes) > 1 else (None, axes[0])
    x_planned = numbers if across is None else planned_targets[across]
    x_measured = numbers if across is None else positions[across]
    # Without lines between: the path there is that of each axis on its own limits.
    axes_left.plot(x_planned, planned_targets[up], color=COLOUR_PLAN, linewidth=0.6, alpha=0.6, zorder=1)
    if len(records) <= MAX_MARKED:
        axes_left.plot(
            x_planned,
            planned_targets[up],
            "o",
            markersize=7,
            fillstyle="none",
            color=COLOUR_PLAN,
            zorder=2,
            label="planned",
        )
    axes_left.plot(x_measured, positions[up], ".", markersize=5, color=COLOUR_SEEN, zorder=3, label="measured")
    axes_left.set_xlabel("point" if across is None else across)
    axes_left.set_ylabel(up)
    axes_left.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    axes_left.grid(alpha=0.3)
    # Lines between many points would hide them.
    line = ".-" if len(records) <= MAX_JOINED else "."
    for axis, difference in zip(axes, differences, strict=False):
        off = [position - target for position, target in zip(positions[axis], planned_targets[axis], strict=True)]
        difference.axhline(0, color=COLOUR_PLAN, linewidth=1)
        difference.plot(numbers, off, line, color=COLOUR_SEEN, markersize=4, linewidth=0.6)
        difference.set_ylabel(f"{axis}: off plan")
        difference.grid(alpha=0.3)
    if skews:
        least = [skew.at_least_ns / NS_PER_MS for _, skew in skews]
        most = [skew.at_most_ns / NS_PER_MS for _, skew in skews]
        at, colour = [number for number, _ in skews], COLOURS_TIMING["start"]
        differences[-1].vlines(at, least, most, color=colour, linewidth=0.8, alpha=0.3)
        differences[-1].plot(at, most, ".", color=colour, markersize=3)
        differences[-1].set_ylabel("start skew, ms")
        differences[-1].grid(alpha=0.3)
    differences[-1].set_xlabel("point")
    figure.align_ylabels(differences)
    if path is not None:
        figure.savefig(path)
    return figure


def _find_placed(records: Sequence[PointRecord]) -> tuple[list[PointRecord], list[str]]:
    """The points with positions, and their axes: a live job moves other ones from point to point, or none. Raises
    `Refusal`."""
    placed_records = [record for record in records if record.target]
    axes = list(dict.fromkeys(axis for record in placed_records for axis in record.target))[:MAX_SCAN_AXES]
    if not axes:
        raise Refusal("no-recording", "no axis was sent to a position", "plot a job that moves axes to positions")
    return placed_records, axes


def _make_columns(rows: Sequence[Mapping[str, float | None]], axes: Sequence[str]) -> dict[str, list[float]]:
    """The values of each axis, NaN where a row has none."""
    return {axis: [_or_nan(row.get(axis)) for row in rows] for axis in axes}


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value
