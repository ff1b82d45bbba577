"""Pictures of points: of a live job each may have axes of its own."""

import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.report import PointRecord
from orchestrator.monitor.scan_points import plot_points


def point(number: int, **target: float) -> PointRecord:
    axes = {name.replace("_", "."): position for name, position in target.items()}
    return PointRecord(step=0, point=number, state="done", verdict="green", target=axes, measured=dict(axes))


def test_points_of_different_axes_are_drawn() -> None:
    points = [point(1, gantry_x=1.0), point(2, gantry_x=2.0, stage_u=1.0), point(3), point(4, stage_u=2.0)]
    figure = plot_points(points, "live")
    labels = {axes.get_ylabel() for axes in figure.axes}
    assert {"stage.u", "gantry.x: off plan", "stage.u: off plan"} <= labels


def test_points_without_positions_are_refused() -> None:
    with pytest.raises(Refusal, match="no axis was sent"):
        plot_points([point(1), point(2)], "live")
