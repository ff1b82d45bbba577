"""A plot of a path before it runs: where it goes, how fast, and what limits it where."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from orchestrator.model.fleet import Axis
from orchestrator.model.frame import FrameSpec
from orchestrator.plan.path_profiles import Array
from orchestrator.plan.path_step import PlannedPath

POINTS = 4000
WIDTH, DPI = 12.0, 120
ROW, LEAST_HEIGHT = 1.7, 5.6
COLOURS: tuple[str, ...] = ("#1d4ed8", "#ea580c", "#16a34a", "#9333ea", "#eab308", "#06b6d4", "#db2777", "#84532b")
COLOUR_OTHER, COLOUR_LIMIT = "#7a8ca5", "#9ca3af"
STYLES = {"velocity": "#111827", "acceleration": "#64748b", "jerk": "#b6c2d1"}  # greys: the colours say what limits
NOTHING = "nothing else"
STILL = 1e-9  # in the unit of the path: rounding


@dataclass(frozen=True, slots=True)
class AxisCourse:
    """One axis over time as its profile has it: user positions, and its derivatives as parts of their limits, by name;
    a jerk without limit is left out."""

    positions: Array
    parts: Mapping[str, Array]


@dataclass(frozen=True, slots=True)
class PathAxes:
    """The axes of a path, in its order. offsets: user minus motor position, by axis. frame: of its coordinates."""

    axes: Mapping[str, Axis]
    offsets: Mapping[str, float]
    frame: FrameSpec | None = None

    def make_lines(self, courses: Mapping[str, AxisCourse]) -> dict[str, Array]:
        """The courses of the coordinates, by name; those of the axes without a frame."""
        positions = {name: course.positions for name, course in courses.items()}
        if self.frame is None:
            return positions
        rows = np.stack(list(positions.values()), axis=1)
        units = [axis.unit for axis in self.axes.values()]
        return dict(zip(self.frame.coordinates, self.frame.find_coordinates(rows, units).T, strict=True))


def plot_path(path: PlannedPath, shown: PathAxes, title: str) -> Figure:
    """Plot a planned path: its course, the speed along it, and what each axis uses of its limits."""
    axes = shown.axes
    mpl.rcParams["font.size"] = 9
    times_s = np.linspace(0.0, path.plan.duration_s, POINTS)
    courses = {name: _make_course(path, name, axis, shown.offsets[name], times_s) for name, axis in axes.items()}
    binding, colours = _colour_bindings(path, times_s)
    rows = 1 + len(axes)
    figure = Figure(figsize=(WIDTH, max(LEAST_HEIGHT, 0.9 + ROW * rows)), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    grid = figure.add_gridspec(rows, 2, width_ratios=(5, 6))
    _draw_course(figure.add_subplot(grid[:, 0]), path, shown.make_lines(courses), binding)
    speed = figure.add_subplot(grid[0, 1])
    _draw_coloured(speed, times_s, _find_speed(courses, axes), binding, 2.0)
    speed.set_ylim(bottom=0.0)
    speed.set_ylabel(f"along, {path.report.unit}/s")
    axes_below = [figure.add_subplot(grid[k + 1, 1], sharex=speed) for k in range(len(axes))]
    for row, (name, course) in zip(axes_below, courses.items(), strict=True):
        _draw_parts(row, name, course, times_s)
    for part in (speed, *axes_below[:-1]):
        part.tick_params(labelbottom=False)
    axes_below[-1].set_xlabel("s after T0")
    handles = [Line2D([], [], color=colour, linewidth=2.5, label=binds) for binds, colour in colours.items()]
    if handles:
        figure.legend(
            handles=handles,
            loc="outside lower left",
            ncols=4,
            frameon=False,
            title="speed limited by",
            alignment="left",
        )
    kinds = dict.fromkeys(kind for course in courses.values() for kind in course.parts)
    styles = [Line2D([], [], color=STYLES[kind], label=kind) for kind in kinds]
    axes_below[0].legend(handles=styles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
    figure.align_ylabels([speed, *axes_below])
    return figure


def _make_course(path: PlannedPath, name: str, axis: Axis, offset: float, times_s: Array) -> AxisCourse:
    scale, start = float(axis.counts_per_unit), next(move.start_counts for move in path.moves if move.axis == name)
    profile = path.plan.profiles.get(name)
    if profile is None:
        zeros = np.zeros(len(times_s))
        return AxisCourse(zeros + start / scale + offset, {"velocity": zeros, "acceleration": zeros})
    at = profile.make_evaluator()
    position, velocity, acceleration = np.array([at(t) for t in times_s.tolist()]).T / scale
    limits = axis.limits
    parts = {"velocity": velocity / limits.velocity, "acceleration": acceleration / limits.acceleration}
    if limits.jerk is not None:
        begins = np.array([segment.start_s for segment in profile.segments])
        jerks = np.array([segment.jerk for segment in profile.segments]) / scale
        parts["jerk"] = jerks[np.searchsorted(begins, times_s, side="right") - 1] / limits.jerk
    return AxisCourse(start / scale + position + offset, parts)


def _colour_bindings(path: PlannedPath, times_s: Array) -> tuple[list[str], dict[str, str]]:
    """The colour of each instant, and by what limits the path there the colour of that; the most frequent have one."""
    stretches = path.report.stretches
    ends = np.array([stretch.to_s for stretch in stretches])
    if not stretches:
        return [COLOUR_OTHER] * len(times_s), {}
    index = np.minimum(np.searchsorted(ends, times_s), len(stretches) - 1)
    words = [stretches[k].binds for k in map(int, index)]
    often = sorted(dict.fromkeys(words), key=lambda binds: -words.count(binds))
    colours = dict(zip(often, COLOURS, strict=False))
    if len(often) > len(COLOURS):
        colours[NOTHING] = COLOUR_OTHER
    return [colours.get(binds, COLOUR_OTHER) for binds in words], colours


def _draw_coloured(axes: Axes, x: Array, y: Array, colours: Sequence[str], width: float) -> None:
    points = np.stack([x, y], axis=1)[:, None]
    ends: Array = np.concatenate([points[:-1], points[1:]], axis=1)
    lines = LineCollection(list(ends), colors=list(colours[:-1]), linewidths=width)
    lines.set_capstyle("round")
    axes.add_collection(lines)
    axes.autoscale_view()
    axes.grid(alpha=0.3)


def _draw_course(axes: Axes, path: PlannedPath, lines: Mapping[str, Array], colours: Sequence[str]) -> None:
    """The path in the plane of its first two coordinates that change; of one coordinate over time."""
    moving_axes = [name for name, line in lines.items() if float(np.ptp(line)) > STILL] or list(lines)[:1]
    y = moving_axes[-1] if len(moving_axes) < 2 else moving_axes[1]
    x = lines[moving_axes[0]]
    if len(moving_axes) < 2:
        x = np.linspace(0.0, path.plan.duration_s, POINTS)
    else:
        axes.set_aspect("equal", adjustable="datalim")
    _draw_coloured(axes, x, lines[y], colours, 2.0)
    axes.plot(x[0], lines[y][0], "o", color="black", markersize=6, fillstyle="none")
    axes.plot(x[-1], lines[y][-1], "s", color="black", markersize=4)
    axes.set_xlabel(f"{moving_axes[0]}, {path.report.unit}" if len(moving_axes) > 1 else "s after T0")
    axes.set_ylabel(f"{y}, {path.report.unit}")
    more = f"; not shown: {', '.join(moving_axes[2:])}" if len(moving_axes) > 2 else ""
    axes.set_title(f"from ○ to ■{more}", loc="left", fontsize=9)


def _find_speed(courses: Mapping[str, AxisCourse], axes: Mapping[str, Axis]) -> Array:
    """The speed of all axes together, in their unit per s."""
    squares = [(course.parts["velocity"] * axes[name].limits.velocity) ** 2 for name, course in courses.items()]
    return np.sqrt(np.sum(squares, axis=0))


def _draw_parts(axes: Axes, name: str, course: AxisCourse, times_s: Array) -> None:
    for limit in (-1.0, 1.0):
        axes.axhline(limit, color=COLOUR_LIMIT, linewidth=1, linestyle="--")
    for kind, part in reversed(list(course.parts.items())):
        axes.plot(times_s, part, color=STYLES[kind], linewidth=0.9 if kind == "jerk" else 1.2)
    axes.set_ylim(-1.15, 1.15)
    axes.set_yticks([-1, 0, 1], ["-limit", "0", "limit"])
    axes.set_ylabel(name)
    axes.grid(alpha=0.3)
