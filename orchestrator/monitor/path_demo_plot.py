"""A picture of a path that was run: the plan, what the controllers sampled by themselves, and how far they were off."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from orchestrator.model.report import PathBound

Array = NDArray[np.float64]

PLAN, TRUTH, BOUND, PROVEN = "#9ca3af", "#111827", "#dc2626", "#ea580c"
COLOURS = ("#1d4ed8", "#16a34a", "#9333ea", "#db2777")
UM = 1000.0
SHOWN = 4  # of so many samples one is drawn


@dataclass(frozen=True, slots=True)
class SampledPath:
    """What is drawn. axes: of the path. times_s, planned: (instants, axes), of the plan. samples: by axis, instants and
    positions. truth_s, errors: when, and how far the axes truly were off the path, mm."""

    axes: Sequence[str]
    times_s: Array
    planned: Array
    samples: Mapping[str, tuple[Array, Array]]
    truth_s: Array
    errors: Array
    bound: PathBound


def plot_sampled_path(path: SampledPath, title: str) -> Figure:
    """Plot a path of two axes or more that was run, in mm."""
    mpl.rcParams["font.size"] = 9
    figure = Figure(figsize=(11.0, 4.6), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    grid = figure.add_gridspec(2, 2, width_ratios=(6, 5))
    _draw_course(figure.add_subplot(grid[:, 0]), path)
    axes_above = figure.add_subplot(grid[0, 1])
    axes_below = figure.add_subplot(grid[1, 1], sharex=axes_above)
    _draw_positions(axes_above, path)
    _draw_errors(axes_below, path)
    axes_above.tick_params(labelbottom=False)
    figure.align_ylabels([axes_above, axes_below])
    return figure


def _draw_course(axes: Axes, path: SampledPath) -> None:
    """The first two axes in their plane; the samples of the second one at the instants of those of the first."""
    first, second = path.axes[:2]
    axes.plot(path.planned[:, 0], path.planned[:, 1], color=PLAN, linewidth=1.6, label="planned")
    (times_s, x), (others_s, y_samples) = path.samples[first], path.samples[second]
    y = np.interp(times_s, others_s, y_samples)
    label = f"sampled by the controllers (1 of {SHOWN})"
    axes.plot(x[::SHOWN], y[::SHOWN], "o", color=COLOURS[0], markersize=3.2, fillstyle="none", label=label)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(f"{first}, mm")
    axes.set_ylabel(f"{second}, mm")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)


def _draw_positions(axes: Axes, path: SampledPath) -> None:
    for number, name in enumerate(path.axes):
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(path.times_s, path.planned[:, number], color=colour, linewidth=1.0, alpha=0.45)
        times_s, positions = path.samples[name]
        axes.plot(times_s[::SHOWN], positions[::SHOWN], "o", color=colour, markersize=2.6, fillstyle="none", label=name)
    axes.set_ylabel("position, mm")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(path.axes), frameon=False, markerscale=1.5)


def _draw_errors(axes: Axes, path: SampledPath) -> None:
    bound = path.bound
    axes.plot(path.truth_s, UM * path.errors, color=TRUTH, linewidth=0.9, label="true distance from the path")
    axes.axhline(UM * bound.predicted, color=BOUND, linewidth=1.2, label="bound, before it ran")
    if bound.proven is not None:
        axes.axhline(UM * bound.proven, color=PROVEN, linewidth=1.2, linestyle="--", label="proven afterwards")
    axes.set_ylim(0.0, UM * bound.predicted * 1.45)
    axes.set_xlabel("s after T0")
    axes.set_ylabel("off the path, um")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", ncols=2, frameon=False)
