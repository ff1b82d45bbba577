"""A timeline as a picture: a row for the coordinator and for each axis, and beside it the same about T0."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.state import TimeInterval
from orchestrator.monitor.timeline.stages import StepTimeline, TimelineAxis, TimelineStage, settled_ns

WIDTH, ROW, DPI = 11.0, 0.32, 120
BAR = 0.56  # height of a bar, of a row
ZOOM_MARGIN = 0.25  # of the width of all start intervals
MIN_ZOOM_NS = 20_000
US_BELOW_NS = 1_000_000  # a narrower zoom is in microseconds
# Each stage has one colour, in the coordinator and in the adapters; makes may name stages of their own.
COLOURS = {
    "plan": "#64748b",
    "align": "#cbd5e1",
    "arm": "#2563eb",
    "commit": "#7c3aed",
    "decide": "#db2777",
    "go": "#ea580c",
    "start": "#ea580c",
    "fire": "#e2e8f0",
    "run": "#86b89a",
    "prepare": "#93c5fd",
    "check": "#38bdf8",
    "wire": "#0369a1",
    "verify": "#14b8a6",
    "settle": "#d9c27a",
}
COLOUR_OTHER, COLOUR_EVIDENCE, COLOUR_T0 = "#a3a3a3", "#111827", "#c2410c"
INTERVAL, T0 = "start or end, as interval", "T0"

Row = tuple[str, Sequence[TimelineStage], TimelineAxis | None]


def draw_step(step: StepTimeline, title: str) -> Figure:
    """Draw the stages as bars, starts and ends as intervals, T0 as a line; beside it the start intervals."""
    mpl.rcParams["font.size"] = 9
    rows = _list_rows(step)
    starts = [axis.modelled or axis.start for _, _, axis in rows if axis is not None]
    figure = Figure(figsize=(WIDTH, 1.5 + ROW * len(rows)), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    if starts:
        main, zoom = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
        _draw_zoom(zoom, rows, starts)
    else:
        main = figure.subplots()
    _draw_main(main, rows)
    handle_by_label = dict(zip(*reversed(main.get_legend_handles_labels()), strict=True))
    labels = sorted(handle_by_label, key=lambda name: [*COLOURS, name, INTERVAL, T0].index(name))
    handles = [handle_by_label[name] for name in labels]
    figure.legend(handles, labels, loc="outside lower center", ncols=8, frameon=False, fontsize=8)
    return figure


def _list_rows(step: StepTimeline) -> list[Row]:
    """The coordinator, then a row for each axis; the first one of a member has the stages of its arming."""
    rows: list[Row] = [("coordinator", step.coordinator, None)]
    for name, member in step.members.items():
        axes = list(member.axes.items()) or [("", None)]
        for number, (axis, went) in enumerate(axes):
            rows.append((f"{name}.{axis}".rstrip("."), member.stages if number == 0 else (), went))
    return rows


def _draw_main(axes: Axes, rows: Sequence[Row]) -> None:
    names = set[str]()
    for row, (_, stages, went) in enumerate(rows):
        for stage in stages:
            _draw_bar(axes, row, (stage.begin_ns, stage.end_ns), stage.name, names)
        if went is None:
            continue
        start = went.modelled or went.start
        if went.end is not None:
            _draw_bar(axes, row, (start.earliest_ns, went.end.latest_ns), "run", names)
            _draw_interval(axes, row, went.end, 1 / NS_PER_MS, names)
            end_ns = settled_ns(went)
            if end_ns is not None:
                _draw_bar(axes, row, (went.end.latest_ns, end_ns), "settle", names)
        _draw_interval(axes, row, start, 1 / NS_PER_MS, names)
    axes.axvline(0, color=COLOUR_T0, linewidth=1, label=T0)
    axes.use_sticky_edges = False
    axes.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlabel("ms after T0")
    axes.grid(axis="x", alpha=0.3)
    axes.set_axisbelow(True)


def _draw_zoom(axes: Axes, rows: Sequence[Row], starts: Sequence[TimeInterval]) -> None:
    """The start intervals; a thin line is the evidence alone, where the promise makes it narrower."""
    low_ns, high_ns = min(start.earliest_ns for start in starts), max(start.latest_ns for start in starts)
    low_ns, high_ns = min(low_ns, 0), max(high_ns, 0)
    margin_ns = max(ZOOM_MARGIN * (high_ns - low_ns), MIN_ZOOM_NS)
    unit, name = (1e-3, "µs") if high_ns - low_ns < US_BELOW_NS else (1 / NS_PER_MS, "ms")
    for row, (_, _, went) in enumerate(rows):
        if went is None:
            continue
        if went.modelled is not None:
            axes.plot(
                [went.start.earliest_ns * unit, went.start.latest_ns * unit],
                [row, row],
                color=COLOUR_EVIDENCE,
                linewidth=0.8,
                alpha=0.5,
                zorder=2,
            )
        _draw_interval(axes, row, went.modelled or went.start, unit, {INTERVAL})
    axes.axvline(0, color=COLOUR_T0, linewidth=1)
    axes.set_xlim((low_ns - margin_ns) * unit, (high_ns + margin_ns) * unit)
    axes.set_xlabel(f"starts: {name} after T0")
    axes.grid(axis="x", alpha=0.3)


def _draw_bar(axes: Axes, row: int, span_ns: tuple[int, int], name: str, named: set[str]) -> None:
    begin_ns, end_ns = span_ns
    axes.barh(
        row,
        (end_ns - begin_ns) / NS_PER_MS,
        left=begin_ns / NS_PER_MS,
        height=BAR,
        color=COLOURS.get(name, COLOUR_OTHER),
        label=None if name in named else name,
        zorder=1,
    )
    named.add(name)


def _draw_interval(axes: Axes, row: int, interval: TimeInterval, unit: float, named: set[str]) -> None:
    middle_ns, half_ns = (
        (interval.earliest_ns + interval.latest_ns) / 2,
        (interval.latest_ns - interval.earliest_ns) / 2,
    )
    axes.errorbar(
        [middle_ns * unit],
        [row],
        xerr=[half_ns * unit],
        fmt="none",
        ecolor=COLOUR_EVIDENCE,
        elinewidth=1.6,
        capsize=3,
        label=None if INTERVAL in named else INTERVAL,
        zorder=3,
    )
    named.add(INTERVAL)
