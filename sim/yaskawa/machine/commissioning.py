"""The set-up of simulated Yaskawa controllers for a fleet file."""

from collections.abc import Mapping, Sequence
from typing import Any

from orchestrator.model.fleet import Controller
from sim.core.commissioning import search_distance
from sim.yaskawa.language.arguments import LETTERS, canonical_axis


def make_options(config: Controller, sizes: Sequence[int]) -> Mapping[str, Any]:
    """The number of axes, a home switch and an index pulse within reach of every axis, and the names of the fleet file.
    sizes: of the models."""
    motors = {canonical_axis(motor): (motor, axis) for axis in config.axes.values() for motor in axis.motors}
    least_size = max(LETTERS.index(letter) for letter in motors) + 1
    edges = {letter: -search_distance(axis) for letter, (_, axis) in motors.items()}
    return {
        "axes": next((size for size in sizes if size >= least_size), sizes[-1]),
        "home_edge": edges,
        "names": {letter: motor for letter, (motor, _) in motors.items()},
        # The edge is halfway between two pulses: at one of them, the next one would be found now and then.
        "index_every": {letter: max(4, round(-edge / 9.5)) for letter, edge in edges.items()},
    }
