"""Keep-out zones as a picture: from above, from the front, from the side, and in space."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

import math
from collections.abc import Iterator
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from orchestrator.model.operation.zone_state import BodyOutline, ZoneState
from orchestrator.monitor.job_plot import DPI

Array = npt.NDArray[np.float64]
WIDTH, HEIGHT = 10.0, 8.2
ROW = 0.2  # of the figure's height, inches, of a rule below the drawings
TURN, TILT = math.radians(-35.0), math.radians(28.0)
BODY, REGION, BROKEN = "#64748b", "#9ca3af", "#b91c1c"
ROUND = 48
"""Corners of the outline of a sphere."""


class View(NamedTuple):
    """A direction to look in. right, up: of the drawing, in the machine's frame."""

    name: str
    across: str
    upwards: str
    right: tuple[float, float, float]
    up: tuple[float, float, float]


def _look_from(turn: float, tilt: float) -> View:
    right = (math.cos(turn), math.sin(turn), 0.0)
    up = (-math.sin(turn) * math.sin(tilt), math.cos(turn) * math.sin(tilt), math.cos(tilt))
    return View("in space", "", "", right, up)


VIEWS = (
    View("from above", "x, mm", "y, mm", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    _look_from(TURN, TILT),
    View("from the front", "x, mm", "z, mm", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    View("from the side", "y, mm", "z, mm", (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
)


def plot_zones(state: ZoneState, title: str) -> Figure:
    """Draw the bodies and regions of a state, what is nearer than allowed in red, and what each rule says."""
    mpl.rcParams["font.size"] = 9
    height = HEIGHT + ROW * len(state.rules)
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    parts = figure.add_gridspec(3, 2, height_ratios=(HEIGHT / 2, HEIGHT / 2, 0.3 + ROW * len(state.rules)))
    for number, view in enumerate(VIEWS):
        _draw_view(figure.add_subplot(parts[number // 2, number % 2]), view, state)
    texts = figure.add_subplot(parts[2, :])
    texts.axis("off")
    for number, (text, colour) in enumerate(_describe_rules(state)):
        height = 1.0 - (number + 0.5) / (len(state.rules) + 1)
        texts.text(0.0, height, text, color=colour, va="center", family="monospace", transform=texts.transAxes)
    return figure


def _describe_rules(state: ZoneState) -> Iterator[tuple[str, str]]:
    width = max((len(rule.rule) for rule in state.rules), default=0)
    for rule in state.rules:
        yield f"{rule.rule:<{width}}  {rule.verdict:<9}  {rule.text}", BROKEN if rule.holds is False else "#111827"
    yield "Zones are software, no safety function.", BODY


def _draw_view(axes: Axes, view: View, state: ZoneState) -> None:
    broken_names = {name for rule in state.rules if rule.holds is False for name in (*rule.bodies, rule.rule)}
    parts = [(name, outline, True) for name, outline in state.regions.items()]
    parts += [(name, outline, False) for name, outline in state.bodies.items()]
    depth = np.cross(view.right, view.up)
    parts.sort(key=lambda part: float(np.mean(np.asarray(part[1].corners) @ depth)))
    for name, outline, is_region in parts:
        colour = BROKEN if name in broken_names else REGION if is_region else BODY
        _draw_outline(axes, view, outline, (name, colour), is_region=is_region)
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.set_title(view.name, fontsize=9)
    axes.set_xlabel(view.across)
    axes.set_ylabel(view.upwards)
    if not view.across:
        axes.set_xticks([])
        axes.set_yticks([])


def _draw_outline(axes: Axes, view: View, outline: BodyOutline, label: tuple[str, str], *, is_region: bool) -> None:
    name, colour = label
    corners = np.asarray(outline.corners, dtype=float)
    spots: Array = np.stack([corners @ np.asarray(view.right), corners @ np.asarray(view.up)], axis=1)
    if outline.radius > 0:
        angles = np.linspace(0.0, 2 * np.pi, ROUND, endpoint=False)
        spots = spots[0] + outline.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    hull = find_hull(spots)
    style = "--" if is_region or not outline.certain else "-"
    axes.add_patch(Polygon(hull, facecolor=colour, alpha=0.12 if is_region else 0.25, edgecolor="none"))
    axes.add_patch(Polygon(hull, fill=False, edgecolor=colour, linestyle=style, linewidth=1.0))
    if not outline.radius and not view.across:
        lines = [(spots[first], spots[second]) for first, second in outline.edges]
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=0.5, linestyles=style), autolim=True)
    label_text = axes.annotate(name, hull.mean(axis=0), color=colour, fontsize=8, ha="center", va="center", zorder=5)
    label_text.set_path_effects([withStroke(linewidth=2.5, foreground="white", alpha=0.8)])


def find_hull(spots: Array) -> Array:
    """The corners of the convex hull of points of a plane, counterclockwise (Andrew's monotone chain, 1979)."""
    sorted_spots = sorted({(float(x), float(y)) for x, y in spots})
    if len(sorted_spots) < 3:
        return np.asarray(sorted_spots)

    def walk(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for x, y in points:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                chain.pop()
            chain.append((x, y))
        return chain[:-1]

    return np.asarray(walk(sorted_spots) + walk(sorted_spots[::-1]))
