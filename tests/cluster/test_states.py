"""Positions with the interval in which they were read: in states, and in the report of a move."""

import pytest
from cluster.worlds import EXAMPLES

from tutti import Move
from tutti.testing import virtual_fleet


def test_x() -> None:
    with virtual_fleet(EXAMPLES / "demo.fleet.yaml") as fleet:
        fleet.tutti.enable()
        fleet.tutti.home()
        report = fleet.tutti.move({"gantry.x": 20, "stage.u": 2})
        print(report.steps[0].positions)
        report = fleet.tutti.move({"gantry.x": 20, "stage.u": 2})
        print(report.steps[0].reason, report.steps[0].positions)
