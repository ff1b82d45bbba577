"""Draw the rows of `tutti bench scale --json` as a picture: how the work of a fleet grows with its controllers.

`tutti bench scale --json > scale.json && python tools/scale_picture.py scale.json docs/figures/scale.png`
"""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Rows = Sequence[dict[str, Any]]

FLEET = (
    ("messages of all hosts at rest, a second", "rest_messages", "hosts"),
    ("wake-ups of the coordinator at rest, a second", "rest_wakes", "hosts"),
    ("messages of all hosts for a step", "step_messages", "hosts"),
    ("wake-ups of the coordinator for a step", "step_wakes", "hosts"),
    ("processor time at rest, ms a second", "rest_cpu_ms", "controllers"),
    ("processor time of a step, ms", "step_cpu_ms", "controllers"),
)
"""Label, figure, and what the figure is of one of."""
TIMES = (
    ("a learned step: submission to T0, ms", "start_ms"),
    ("the first after a restart, ms", "first_start_ms"),
    ("e-stop to the last axis slowing down, ms", "estop_ms"),
    ("between true starts, µs", "skew_us"),
)


def find_slope(counts: Sequence[float], values: Sequence[float]) -> float:
    """The slope in log-log between the last two points: 1 is work in proportion to the controllers."""
    return math.log(values[-1] / values[-2]) / math.log(counts[-1] / counts[-2])


def draw(rows: Rows, target: Path) -> None:
    """Draw both pictures into one file."""
    counts = [row["controllers"] for row in rows]
    figure = Figure(figsize=(12, 5.2), layout="constrained")
    work, times = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for label, name, per in FLEET:
        values = [row[name] * row[per] for row in rows]
        work.loglog(counts, values, "o-", label=f"{label} (slope {find_slope(counts, values):.2f})")
    for label, name in TIMES:
        values = [row[name] for row in rows]
        times.loglog(counts, values, "o-", label=f"{label}: {values[-1]:.3g} with {counts[-1]:,}")
    _finish(work, "Work of the whole fleet", counts)
    _finish(times, "Times, whatever the number", counts)
    FigureCanvasAgg(figure).print_png(str(target))


def _finish(axes: Axes, title: str, counts: Sequence[int]) -> None:
    axes.set(title=title, xlabel="controllers")
    axes.set_xticks(counts, [f"{count:,}" for count in counts])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * (high / low) ** 0.45)  # room for the legend above the lines
    axes.legend(fontsize=8, loc="upper left")


if __name__ == "__main__":
    draw(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["rows"], Path(sys.argv[2]))
