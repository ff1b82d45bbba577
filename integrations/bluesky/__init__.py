"""Axes of a fleet as ophyd-async devices, and scans that fly as a flyer, for plans of Bluesky.

    with init_devices():
        lab = TuttiConnection("tcp/127.0.0.1:7447")
        x, y = TuttiAxis(lab, "gantry.x"), TuttiAxis(lab, "gantry.y")

    RE(bp.grid_scan([], x, 0, 10, 11, y, 0, 10, 11))

ophyd-async 0.21 (`StandardMovable`, `StandardFlyable`, `FlyableLogic`), bluesky 1.15. A stop by a plan is a software
stop, and no safety function.
"""

from integrations.bluesky.axis import TuttiAxis
from integrations.bluesky.connection import TuttiConnection
from integrations.bluesky.devices import make_devices
from integrations.bluesky.flyer import FlightInfo, TuttiFlyer

__all__ = ["FlightInfo", "TuttiAxis", "TuttiConnection", "TuttiFlyer", "make_devices"]
