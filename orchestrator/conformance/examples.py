"""The case of a make for the contract suite, from its own example of a fleet file."""

from typing import Any

import yaml

from adapters.contract import ExamplePlace, validate_options
from adapters.host.makes import apply_make_defaults, find_controller_problems, find_make
from orchestrator.conformance.worlds import Case
from orchestrator.model.fleet import Fleet
from orchestrator.model.plugins import PluginError
from sim.core.vectors import find_simulator

# Of the time that an axis takes at its highest speed.
USUAL_S = 0.3
BASE_S = 0.25
SHORT_S = 0.0125


def make_example_fleet_of(make: str) -> Fleet:
    """Return a fleet with one controller, named `it`, as the make's example describes it.

    Raises `PluginError` for an example that cannot be used.
    """
    text = find_make(make).fleet_example(ExamplePlace(0, 0))
    try:
        config: Any = yaml.safe_load(text)
        plain = {"schema": "tutti.fleet/1", "fleet": "check", "controllers": {"it": config}}
        fleet = apply_make_defaults(Fleet.model_validate(plain))
    except (yaml.YAMLError, ValueError) as error:
        raise PluginError(f"fleet_example of {make} is no part of a fleet file: {error}", "correct it") from None
    problems = find_controller_problems("it", fleet.controllers["it"])
    if problems:
        text = "; ".join(each.text for each in problems)
        raise PluginError(f"fleet_example of {make} does not pass check_config: {text}", "correct one of them")
    return fleet


def make_case(make: str) -> Case:
    """Return the case of a make: one controller of its example, and the simulator that fits it.

    Raises `UnknownPlugin`, `PluginError`.
    """
    config = make_example_fleet_of(make).controllers["it"]
    simulator = find_simulator(make)
    options = validate_options(find_make(make).options_model, config)
    expected = {name: getattr(options, name) for name in type(options).model_fields}
    plain = config.to_plain()
    # The checks know one of each, by this name.
    plain["inputs"] = {"line": each.to_plain() for each in list(config.inputs.values())[:1]}
    plain["outputs"] = {"line": each.to_plain() for each in list(config.outputs.values())[:1]}
    speeds = [axis.limits.velocity * float(axis.scale) for axis in config.axes.values()]
    slowest = min(speeds)
    simulate = {**simulator.make_options(config, expected), **config.simulate.options}
    return Case(
        plain,
        simulate,
        port=_find_port(config.link.kind, make),
        targets=tuple(round(speed * USUAL_S * (1 if number % 2 == 0 else -0.5)) for number, speed in enumerate(speeds)),
        base_counts=round(slowest * BASE_S),
        short_counts=max(10, round(slowest * SHORT_S)),
        jogs_together=False,
    )


def _find_port(kind: str, make: str) -> str:
    """Return the port of the simulated controller that a link leads to: that of the link's kind, or its first one,
    which is behind a bridge."""
    from orchestrator.clock.queue import EventQueue

    ports = find_simulator(make).vector_bench(EventQueue(), {}).controller.port_names
    return kind if kind in ports else ports[0]
