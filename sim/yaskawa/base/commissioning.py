"""The set-up of simulated Yaskawa controllers for a fleet file."""

from collections.abc import Mapping, Sequence
from typing import Any

from orchestrator.model.fleet import Controller
from sim.core.commissioning import search_distance

_ALPHABETS = ("XYZW", "ABCDEFGH")


def make_options(config: Controller, sizes: Sequence[int]) -> Mapping[str, Any]:
    """The number of axes, and a home switch and an index pulse within reach of every axis. sizes: of the models."""
    places = {name: max(letters.find(axis.motors[0]) for letters in _ALPHABETS) for name, axis in config.axes.items()}
    needed = max(places.values()) + 1
    edges = {config.axes[name].motors[0]: -search_distance(config.axes[name]) for name in places}
    return {
        "axes": next((size for size in sizes if size >= needed), sizes[-1]),
        "home_edge": edges,
        "index_every": {letter: max(4, -edge // 10) for letter, edge in edges.items()},
    }
