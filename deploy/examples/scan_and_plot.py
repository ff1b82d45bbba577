"""Scan 4 by 3 points on a simulated fleet, and plot what was planned against what was polled: scan_and_plot.py [PNG].

Nothing needs to run: the fleet exists in virtual time, in this process.
"""

import sys
from pathlib import Path

from tutti import Dwell, Job, Move
from tutti.testing import virtual_fleet

FLEET = Path(__file__).with_name("demo.fleet.yaml")
COLUMNS = (0, 10, 20, 30)  # mm

steps = []
for row in range(3):
    # To and fro, so that no way is gone twice.
    for column in COLUMNS if row % 2 == 0 else reversed(COLUMNS):
        steps.append(Move(to={"gantry.x": column, "stage.u": f"{500 * row} um"}))
        steps.append(Dwell(duration="50 ms"))

with virtual_fleet(FLEET) as fleet:
    fleet.tutti.enable("gantry", "stage")
    fleet.tutti.home()
    report = fleet.tutti.run(Job("scan", steps))
    print(report)
    report.plot(sys.argv[1] if len(sys.argv) > 1 else "scan.png")
