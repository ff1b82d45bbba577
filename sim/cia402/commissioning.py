"""The set-up of a simulated CiA 402 drive for a fleet file: bit rate, gearing, a home switch within reach."""

from collections.abc import Mapping
from typing import Any

from orchestrator.model.fleet import CanBusLink, Controller
from sim.core.commissioning import search_distance, span_counts

_GEARING = {"encoder": ("608F:1", "608F:2"), "gear": ("6091:1", "6091:2"), "feed": ("6092:1", "6092:2")}


def make_options(config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
    """expected: the adapter's options; what it compares with the drive (encoder, gear, feed) is stored in the drive."""
    (axis,) = config.axes.values()
    options: dict[str, Any] = {}
    if isinstance(config.link, CanBusLink):
        options["bitrate"] = config.link.bitrate
    objects: dict[str, int] = {}
    for name, (numerator, denominator) in _GEARING.items():
        ratio = expected.get(name)
        if ratio is not None:
            objects |= {numerator: ratio.numerator, denominator: ratio.denominator}
    if objects:
        options["objects"] = objects
    if axis.homing.method not in ("default", "37", "35"):
        near_end, far_end = search_distance(axis), search_distance(axis) + 2 * span_counts(axis)
        options |= {
            "home_switch": [-far_end, -near_end],
            "travel": [-2 * far_end, 2 * far_end],
            "index_every": max(4, near_end // 10),
        }
    return options
