"""The case of a make for the contract suite, from its own example of a fleet file."""

from collections.abc import Mapping
from typing import Any

from adapters.contract import validate_options
from adapters.host.makes import find_make
from orchestrator.clock.queue import EventQueue
from orchestrator.conformance.worlds import Case
from orchestrator.model.fleet import Controller
from orchestrator.runtime.example_fleet import load_example
from sim.core.vectors import find_simulator

# Of the time that an axis takes at its highest speed.
USUAL_S = 0.3
BASE_S = 0.25
SHORT_S = 0.0125


def make_case(make: str, config: Controller | None = None) -> Case:
    """Return the case of a make: one controller of its example, or `config`, and the simulator that fits it.

    Raises `UnknownPlugin`, `PluginError`.
    """
    if config is None:
        config = load_example(make)
    simulator = find_simulator(make)
    options = validate_options(find_make(make).options_model, config)
    option_values = {name: getattr(options, name) for name in type(options).model_fields}
    plain = config.to_plain()
    # The checks know one of each, by this name.
    for kind, points in (("inputs", config.inputs), ("outputs", config.outputs)):
        plain[kind] = dict(zip(["line"], (point.to_plain() for point in points.values()), strict=False))
    speeds = [axis.limits.velocity * float(axis.scale) for axis in config.axes.values()]
    slowest = min(speeds)
    simulate = {**simulator.make_options(config, option_values), **config.simulate.options}
    return Case(
        plain,
        simulate,
        port=_find_port(config.link.kind, make, simulate),
        targets=tuple(round(speed * USUAL_S * (1 if number % 2 == 0 else -0.5)) for number, speed in enumerate(speeds)),
        base_counts=round(slowest * BASE_S),
        short_counts=max(10, round(slowest * SHORT_S)),
        jogs_together=False,
        forgives_late_lines=True,
    )


def _find_port(kind: str, make: str, simulate: Mapping[str, Any]) -> str:
    """Return the port of the simulated controller that a link leads to: that of the link's kind, or its first one,
    which is behind a bridge."""
    ports = find_simulator(make).build_controller(EventQueue(), simulate).port_names
    return kind if kind in ports else ports[0]
