"""A plot of start skew distributions, one row per start method."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

WIDTH, ROW, DPI = 9.0, 0.36, 120
COLOUR_OLD, COLOUR_NEW = "#9aa5b1", "#c2410c"
MIN_SHOWN_MS = 0.005  # smaller values are drawn at the edge


def plot_skews(skews_ms: Mapping[str, list[float]], path: Path) -> None:
    """Write a plot: one row per start method, its trials from the first to the last percentile, with the median
    marked.

    skews_ms: by `fleet: method`; methods that begin with `old` are drawn as baselines.
    """
    mpl.rcParams["font.size"] = 9
    figure = Figure(figsize=(WIDTH, 1.0 + ROW * len(skews_ms)), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for row, (name, values) in enumerate(reversed(list(skews_ms.items()))):
        ordered_values = sorted(max(value, MIN_SHOWN_MS) for value in values)
        low, middle, high = (
            ordered_values[min(len(ordered_values) - 1, int(share * len(ordered_values)))]
            for share in (0.01, 0.5, 0.99)
        )
        colour = COLOUR_OLD if ": old" in name else COLOUR_NEW
        axes.plot([low, high], [row, row], color=colour, linewidth=5, solid_capstyle="round")
        axes.plot([middle], [row], "|", color="black", markersize=11)
        words = f"{high:.2g} ms" if high < 100 else f"{high:.0f} ms"
        axes.annotate(words, (high, row), xytext=(7, -3), textcoords="offset points", fontsize=8)
    axes.set_yticks(range(len(skews_ms)), [*reversed(list(skews_ms))])
    axes.set_xscale("log")
    axes.set_xlabel("start skew, ms: first to 99th percentile, the mark is the median (baseline methods grey)")
    axes.grid(axis="x", which="both", alpha=0.3)
    axes.margins(x=0.15)
    figure.savefig(path)
