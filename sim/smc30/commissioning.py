"""The set-up of a simulated SMC30 for a fleet file: its DIP switches, and ends of travel that a search can find."""

from collections.abc import Mapping
from typing import Any

from orchestrator.model.fleet import Controller
from sim.core.commissioning import search_distance, span_counts

_FASTEST_SEARCH = 2000  # steps/s: H runs at the start rate (L2083, L2260)


def make_options(config: Controller, expected: Mapping[str, Any]) -> Mapping[str, Any]:
    """expected: the adapter's options; its `checksum` is the switch CHS."""
    (axis,) = config.axes.values()
    near_end = min(search_distance(axis), _FASTEST_SEARCH)
    far_end = near_end + 2 * span_counts(axis)
    options: dict[str, Any] = {"travel_steps": [-near_end, far_end] if axis.homing_sign < 0 else [-far_end, near_end]}
    if expected.get("checksum"):
        options["checksum"] = True
    return options
